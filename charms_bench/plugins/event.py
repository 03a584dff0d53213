"""The plugin contract of an event, whose probability `charms-bench rare` estimates.

An event is registered in the entry-point group `charms_bench.events`.
"""

from abc import ABC, abstractmethod
from typing import ClassVar

from charms_bench.world.scene import Floats, Ints, Scene


class Event(ABC):
    """Something that happens in few episodes, and how close an episode comes to it."""

    definition: str
    """What happens, in the words that the table of results shows."""

    includes_failure: ClassVar[bool] = False
    """Whether it also happens when the ego collides or leaves the road."""

    sees_network: ClassVar[bool] = False
    """Whether it is shown the vehicles of one of highway-env's roads as they are there, and not
    along the ego's way."""

    @abstractmethod
    def level(self, scene: Scene, rows: Ints) -> Floats:
        """How far scenes are from the event; at most 0 if it happens now, and never NaN.

        It is called after every simulation step, and the lowest level of an episode counts. The
        estimate needs few episodes if the lowest level falls steadily towards 0 as an episode comes
        closer to the event, and many if it is the same for most episodes, or jumps.

        Args:
            scene: All scenes; read only.
            rows: (R,) the scenes to look at.

        Returns:
            The levels, (R,).
        """
