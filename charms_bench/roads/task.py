"""What is particular to one of highway-env's environments: its scenes, rewards and endings."""

from abc import ABC, abstractmethod
from collections.abc import Mapping
from typing import Any, ClassVar

import numpy as np

from charms_bench.foundation.arrays import Bools, Floats, Ints
from charms_bench.roads.scenes import Scenes

LaneName = tuple[str, str, int]
"""highway-env's name of a lane: the nodes at its start and its end, and its number [`LaneIndex`]."""


class Task(ABC):
    """The rules of an environment with a configuration; methods take the scenes `rows` (R,)."""

    terms: ClassVar[tuple[str, ...]]
    """The terms of the reward, in highway-env's order, which the configuration weights by name."""
    vehicles: int
    """The most vehicles of a scene, with the ego."""

    def __init__(self, config: Mapping[str, Any], lanes: Mapping[LaneName, int]) -> None:
        """Reads a configuration; `lanes` has the indices of the road's lanes by their names."""
        self.weights = np.array([float(config.get(term, 0)) for term in self.terms])
        """What the terms are multiplied by."""

    @abstractmethod
    def start(self, scenes: Scenes, rows: Ints) -> None:
        """Places the vehicles of new episodes by the scenes' random generators."""

    @abstractmethod
    def judge(self, scenes: Scenes, rows: Ints, actions: Ints, rewards: Floats) -> None:
        """Writes the rewards after the actions (B,), and their terms, into `rewards` (B, 1 + K)."""

    @abstractmethod
    def is_terminated(self, scenes: Scenes) -> Bools:
        """Whether each scene (B,) is over; `truncated` says whether its time is."""

    def is_truncated(self, scenes: Scenes) -> Bools:
        """Whether the time of each scene (B,) is over."""
        return np.zeros(len(scenes.time), dtype=np.bool_)
