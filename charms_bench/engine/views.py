"""What each vehicle sees of its scene along its own way, where vehicles drive different ways."""

from typing import Any, Protocol

from charms_bench.world.scene import Bools, Ints, Scene, Vehicles


class Views(Protocol):
    """The views of all vehicles of an engine with B scenes of N places, from now on.

    `follow` has to be called after every simulation step, and `judge` after it where vehicles have
    collided.
    """

    own: Scene
    """[B, N] each vehicle as it saw itself at the last `look`; its neighbours are not found.

    Of the traffic, only what has not passed the end of its road is present."""
    collision: Ints
    """[B, N] how each vehicle has collided, as indices into `collision_kinds.COLLISIONS`."""
    at_fault: Bools
    """[B, N] whether it is at fault for that; false while that is undecided."""
    turned: Bools
    """[B, N] whether it has come to another road between the last two calls of `look`."""

    def follow(self) -> None:
        """Notes how far each vehicle has come along its way."""

    def judge(self) -> None:
        """Notes how the vehicles have collided that have just done so."""

    def look(self, scenes: Ints) -> None:
        """Fills in `own` of some scenes (S,)."""

    def see(self, vehicles: Vehicles, after: Ints, seen: Any) -> None:
        """Fills in what M vehicles see, scene after scene, after `look`.

        `after` (M,) is the place after their rows in `seen`, `recording.primitives.SEEN`, which lie
        one after the other.
        """
