"""What every environment asks of its episodes, whatever road they are on."""

from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import Any, NamedTuple

import gymnasium
import numpy as np
from numpy.typing import NDArray

from charms_bench.envs.rendering import Frame
from charms_bench.errors import InputError
from charms_bench.foundation.arrays import Bools, Floats, Ints

Spaces = tuple[gymnasium.Space[Any], gymnasium.Space[Any]]
"""Of observations and of actions."""
Seeds = Sequence[int | None]
"""The seeds of R scenes; without a seed, a scene's random generator continues."""
NO_SCENES: Ints = np.zeros(0, dtype=np.int64)
FIRST_SCENE: Ints = np.zeros(1, dtype=np.int64)


class Decided(NamedTuple):
    """What a decision led to, in N environments."""

    observations: Any
    """An array (N, ...), or a dictionary or a tuple of arrays."""
    rewards: Floats
    terminated: Bools
    truncated: Bools


class Episodes(ABC):
    """Episodes in B scenes, which are N environments: one a scene, or one for each learner of it.

    In arrays (N,), the learners of the first scene come first. Where there is one scene, its L
    learners can be asked one by one, as agents.
    """

    title: str
    """The environment's name, for messages."""
    scenes: int
    environments: int
    decision_hz: float
    spaces: Spaces
    """Of one environment."""
    numbers: Sequence[int]
    """Of the agents' vehicles."""
    action_names: Sequence[str]
    idle = 0
    """The action of agents that have left."""

    @abstractmethod
    def check_started(self, what: str) -> None:
        """Raises a `ResetNeeded` before the first reset."""

    @abstractmethod
    def reseed(self, rows: Ints, seeds: Seeds) -> None:
        """Seeds the random generators of the scenes `rows`, before a reset starts them."""

    @abstractmethod
    def start(self, rows: Ints, seeds: Seeds) -> None:
        """Starts an episode in each of the scenes `rows`."""

    @abstractmethod
    def observe(self) -> Any:
        """The present observations of all environments."""

    @abstractmethod
    def begin(self, observations: Any, rows: Ints) -> None:
        """Puts the observations of the scenes `rows`, which have just started, among others."""

    @abstractmethod
    def decide(self, actions: Any, due: Ints = NO_SCENES) -> Decided:
        """Carries out actions (N, ...) until the next decision; nothing counts in scenes `due`."""

    def over(self, ended: Bools) -> Bools:
        """(B,) the scenes without a running environment, if these environments (N,) have ended."""
        return ended.copy()

    def of_scenes(self, rows: Ints) -> Ints:
        """The environments of scenes."""
        return rows

    def scenes_of(self, mask: Any) -> Any:
        """The mask (B,) of scenes from one (N,) of environments, or None."""
        return mask

    def facts(self, known: Bools) -> dict[str, Any]:
        """Infos (N, ...) about the last decision, of the environments `known`."""
        return {}

    def final(self, ended: Bools) -> dict[str, Any]:
        """Infos (N, ...) about the episodes that have `ended`, added to `facts`."""
        return {}

    def first(self) -> dict[str, Any]:
        """Infos (N, ...) about the episodes that have just started."""
        return {}

    def always(self) -> dict[str, Any]:
        """Infos (N, ...) of every step and reset."""
        return {}

    @abstractmethod
    def masks(self) -> Any:
        """The action masks (N, A) of the next decision; where actions are tuples, (N, L, A)."""

    @abstractmethod
    def frame(self, row: int) -> Frame:
        """The picture of a scene."""

    @abstractmethod
    def saved(self, next_seed: int | None) -> Any:
        """The state of all scenes, with a seed that `load` returns."""

    @abstractmethod
    def load(self, state: Any) -> int | None:
        """Continues from what `saved` returned; returns the seed."""

    @abstractmethod
    def state(self) -> Any:
        """The state of all scenes, from which other environments may start."""

    @abstractmethod
    def restore(self, state: Any) -> None:
        """Starts all scenes in a state."""

    @abstractmethod
    def decide_one(self, action: Any) -> Decided:
        """As `decide`, where there is one environment."""

    @abstractmethod
    def result(self, decided: Decided, action: Any) -> Any:
        """What `step` of one environment returns."""

    @abstractmethod
    def first_info(self) -> dict[str, Any]:
        """What `reset` of one environment returns as its info."""

    @abstractmethod
    def spaces_of_agents(self) -> list[Spaces]:
        """The spaces of each agent."""

    @abstractmethod
    def driving(self) -> Bools:
        """(L,) which agents drive."""

    @abstractmethod
    def decide_each(self, chosen: Ints) -> tuple[list[float], list[bool], list[bool]]:
        """Carries out actions (L,); returns rewards, terminations and truncations of L agents."""

    @abstractmethod
    def seen_by(self, which: Ints) -> Any:
        """The observations of some of the agents."""

    @abstractmethod
    def infos_of(self, which: Ints, *, starts: bool = False) -> list[dict[str, Any]]:
        """The infos of some of the agents after a decision, or as an episode starts."""


def checked_options(options: Any, *known: str) -> dict[str, Any]:
    """The options of `reset`, by default none.

    Raises:
        InputError: They are not a dictionary, or there is another one than the `known`.
    """
    if not isinstance(options or {}, dict):
        raise InputError(f"reset: options is {options!r:.80}; expected a dictionary")
    if other := ", ".join(str(name) for name in options or () if name not in known):
        names = " and ".join(map(repr, known))
        raise InputError(f"reset takes the option{'s' * (len(known) > 1)} {names}, got {other}")
    return dict(options or {})


def row_of(observations: Any, row: Any) -> Any:
    """A copy of one of several observations."""
    if isinstance(observations, tuple):
        return tuple(row_of(each, row) for each in observations)
    if isinstance(observations, dict):
        return {name: each[row].copy() for name, each in observations.items()}
    return observations[row].copy()


def put(observations: Any, rows: Ints, others: Any) -> None:
    """Replaces some of several observations."""
    if isinstance(observations, tuple):
        for each, other in zip(observations, others, strict=True):
            put(each, rows, other)
    elif isinstance(observations, dict):
        for name, values in observations.items():
            values[rows] = others[name]
    else:
        observations[rows] = others


def masked(infos: dict[str, Any], known: Bools) -> dict[str, Any]:
    """Infos with the masks (N,) beside them that Gymnasium expects."""
    return {**infos, **{f"_{name}": known for name in infos}}


def spread(values: NDArray[Any], alive: Bools, fill: int) -> NDArray[Any]:
    """Values (M, ...) of the M learners that are `alive` (N,), as (N, ...)."""
    if len(values) == alive.size:
        return values
    found = np.full((alive.size, *values.shape[1:]), fill, dtype=values.dtype)
    found[alive] = values
    return found
