"""What each vehicle sees of its scene along its own way, where vehicles drive different ways."""

from typing import Protocol

from charms_bench.world.scene import Bools, Ints, Scene, Vehicles


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

    def seen_by(self, vehicles: Vehicles) -> Scene:
        """[M, N] the scenes as M vehicles see them, until this is called again."""
