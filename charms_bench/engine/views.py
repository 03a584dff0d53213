"""What each vehicle sees of its scene along its own way, where vehicles drive different ways."""

from typing import Any, Protocol

from charms_bench.foundation.compiled import compiled
from charms_bench.world.candidate_lanes import LEFT, OWN, RIGHT
from charms_bench.world.scene import Bools, Ints, Scene, Vehicles
from charms_bench.world.scene_arrays import SceneArrays


class Views(Protocol):
    """The views of all vehicles of an engine with B scenes of N places, from now on.

    `follow` has to be called after every simulation step, and `judge` after it where vehicles have
    collided.
    """

    collision: Ints
    """[B, N] how each vehicle has collided, as indices into `collision_kinds.COLLISIONS`."""
    at_fault: Bools
    """[B, N] whether it is at fault for that; false while that is undecided."""
    turned: Bools
    """[B, N] whether it has come to another road since `own` was last asked for."""

    def follow(self) -> None:
        """Notes how far each vehicle has come along its way."""

    def judge(self) -> None:
        """Notes how the vehicles have collided that have just done so."""

    @property
    def own(self) -> Scene:
        """[B, N] each vehicle as it sees itself; its neighbours are not found."""

    def see(self, vehicles: Vehicles, seen: Any) -> None:
        """Fills in where all vehicles are in the views of M vehicles, with `note_view`.

        Args:
            vehicles: The vehicles, scene after scene.
            seen: [M, N] records.
        """


@compiled
def note_view(scene: SceneArrays, v: int, now: Any) -> None:
    """Fills records [N] in from scene v, which is what a vehicle sees."""
    leaders, followers = scene.leaders, scene.followers
    for j in range(now.size):
        other = now[j]
        other.x, other.y, other.heading = scene.x[v, j], scene.y[v, j], scene.heading[v, j]
        other.direction_x, other.direction_y = scene.direction_x[v, j], scene.direction_y[v, j]
        other.lane, other.target_lane = scene.lane[v, j], scene.target_lane[v, j]
        other.leader, other.follower = leaders[v, j, OWN], followers[v, j, OWN]
        other.left_leader, other.left_follower = leaders[v, j, LEFT], followers[v, j, LEFT]
        other.right_leader, other.right_follower = leaders[v, j, RIGHT], followers[v, j, RIGHT]
