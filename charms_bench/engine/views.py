"""What each vehicle sees of its scene along its own way, where vehicles drive different ways."""

from typing import Any, Protocol

from charms_bench.world.scene import Bools, Ints, Scene, Vehicles


class Views(Protocol):
    """The views of all vehicles of an engine with B scenes of N places, from now on.

    `follow` has to be called after every simulation step, and `judge` after it where vehicles have
    collided.
    """

    own: Scene
    """[B, N] each vehicle as it saw itself at the last `look`; its neighbours are not found."""
    collision: Ints
    """[B, N] how each vehicle has collided, as indices into `collision_kinds.COLLISIONS`."""
    at_fault: Bools
    """[B, N] whether it is at fault for that; false while that is undecided."""

    def follow(self) -> None:
        """Notes how far each vehicle has come along its way."""

    def judge(self) -> None:
        """Notes how the vehicles have collided that have just done so."""

    def look(self, scenes: Ints) -> None:
        """Fills in `own` of some scenes (S,)."""

    def see(self, vehicles: Vehicles, seen: Any) -> None:
        """Fills in what M vehicles see, after `look`.

        Args:
            vehicles: The vehicles, scene after scene.
            seen: [M, N] `recording.primitives.VEHICLE`, in which each vehicle is as it sees itself.
                Filled in are where all others are and their lanes; and of the vehicle that looks,
                its leaders, with their headings, and the follower on its lane.
        """
