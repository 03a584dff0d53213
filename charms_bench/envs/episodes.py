"""What every environment asks of its episodes, whatever road they are on."""

from collections.abc import Sequence
from typing import Any, NamedTuple, Protocol

import gymnasium
import numpy as np
from numpy.typing import NDArray

from charms_bench.envs.rendering import Frame
from charms_bench.errors import InputError
from charms_bench.foundation.arrays import Bools, Floats, Ints

Spaces = tuple[gymnasium.Space[Any], gymnasium.Space[Any]]
"""Of observations and of actions."""
Seeds = Sequence[int | None]
"""The seeds of R scenes; where there is none, the scene's random generator continues."""
NO_SCENES: Ints = np.zeros(0, dtype=np.int64)
FIRST_SCENE: Ints = np.zeros(1, dtype=np.int64)


class Decided(NamedTuple):
    """What a decision led to, in N environments."""

    observations: Any
    """An array (N, ...), or a dictionary or a tuple of arrays."""
    rewards: Floats
    terminated: Bools
    truncated: Bools


class Episodes(Protocol):
    """Episodes in B scenes, which are N environments: one a scene, or one for each learner of it.

    In arrays (N,), the learners of the first scene come first.
    """

    title: str
    """The environment's name, for messages."""
    scenes: int
    environments: int
    decision_hz: float
    spaces: Spaces
    """Of one environment."""

    def check_started(self, what: str) -> None:
        """Raises a `ResetNeeded` before the first reset."""

    def reseed(self, rows: Ints, seeds: Seeds) -> None:
        """Seeds the random generators of the scenes `rows`, before a reset starts them."""

    def start(self, rows: Ints, seeds: Seeds) -> None:
        """Starts an episode in each of the scenes `rows`."""

    def observe(self) -> Any:
        """The present observations of all environments."""

    def begin(self, observations: Any, rows: Ints) -> None:
        """Puts the observations of the scenes `rows`, which have just started, among others."""

    def decide(self, actions: Any, due: Ints = NO_SCENES) -> Decided:
        """Carries out actions (N, ...) until the next decision; nothing counts in scenes `due`."""

    def over(self, ended: Bools) -> Bools:
        """(B,) the scenes that nobody drives any more, if these environments (N,) have ended."""

    def of_scenes(self, rows: Ints) -> Ints:
        """The environments of scenes."""

    def scenes_of(self, mask: Any) -> Any:
        """The mask (B,) of scenes from one (N,) of environments, or None."""

    def facts(self, known: Bools) -> dict[str, Any]:
        """Infos (N, ...) about the last decision, of the environments `known`."""

    def final(self, ended: Bools) -> dict[str, Any]:
        """Infos (N, ...) about the episodes that have `ended`, beside `facts`."""

    def first(self) -> dict[str, Any]:
        """Infos (N, ...) about the episodes that have just started."""

    def always(self) -> dict[str, Any]:
        """Infos (N, ...) of every step and reset."""

    def masks(self) -> Any:
        """The action masks (N, A) of the next decision."""

    def frame(self, row: int) -> Frame:
        """The picture of a scene."""

    def saved(self, next_seed: int | None) -> Any:
        """The state of all scenes, with a seed that `load` returns."""

    def load(self, state: Any) -> int | None:
        """Continues from what `saved` returned; returns the seed."""

    def state(self) -> Any:
        """The state of all scenes, from which other environments may start."""

    def restore(self, state: Any) -> None:
        """Starts all scenes in a state."""

    def decide_one(self, action: Any) -> Decided:
        """As `decide`, where there is one environment."""

    def result(self, decided: Decided, action: Any) -> Any:
        """What `step` of one environment returns."""

    def first_info(self) -> dict[str, Any]:
        """What `reset` of one environment returns as its info."""


class AgentEpisodes(Episodes, Protocol):
    """Episodes in one scene, whose L learners are asked one by one."""

    numbers: Sequence[int]
    """Those of their vehicles."""
    action_names: Sequence[str]
    idle: int
    """The action of learners that have left."""

    def spaces_of_agents(self) -> list[Spaces]:
        """The spaces of each agent."""

    def driving(self) -> Bools:
        """(L,) who drives."""

    def decide_each(self, chosen: Ints) -> tuple[list[float], list[bool], list[bool]]:
        """Carries out actions (L,); returns rewards, terminations and truncations of L."""

    def seen_by(self, which: Ints) -> Any:
        """The observations of some of the learners."""

    def infos_of(self, which: Ints, *, starts: bool = False) -> list[dict[str, Any]]:
        """The infos of some of the learners after a decision, or as an episode starts."""


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
