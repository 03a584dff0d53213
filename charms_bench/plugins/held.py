"""Holds plugins to their word during a run: some of their questions are asked again.

The seed of a shard chooses the calls. Their answers must be the same at once, for some of the
vehicles in another order, for one vehicle or scene alone, after the last call of the shard, and
from another instance of the plugin. What a plugin is shown must be the same after the call.

A plugin that remembers its own answers, or changes other code of its process, can deceive this.
"""

from collections.abc import Callable
from copy import deepcopy
from typing import Any, Generic, TypeVar

import numpy as np
from numpy.typing import NDArray

from charms_bench.errors import PLUGIN_ERRORS, AgentError, BrokenWordError, raised
from charms_bench.plugins.event import Event
from charms_bench.plugins.scene_questions import (
    Answers,
    SceneQuestion,
    changed_array,
    copied,
)
from charms_bench.plugins.traffic import Traffic
from charms_bench.world.scene import Floats, Ints, Scene, Vehicles

P = TypeVar("P")
"""The kind of a plugin."""
CHOSEN = 2
"""About how many calls of a shard are asked again, besides the first."""
MORE_AT_THE_END = 9
"""How many more times the first question is asked after the last call."""
KEPT = 20
"""Most questions that are kept for the end."""
ASSIGNMENTS = 150
"""About how many episodes a shard has."""


class Held(Generic[P]):
    """A plugin of which some calls are asked again.

    Args:
        plugin: The plugin.
        other: Another instance of it, made in the same way.
        rng: Chooses the calls and the vehicles.
        calls: About how many calls a shard has; the first and about `CHOSEN` others are chosen.
    """

    def __init__(self, plugin: P, other: P, rng: np.random.Generator, calls: int) -> None:
        self.plugin, self._other = plugin, other
        self._rng, self._longest = rng, max(1, 2 * calls // CHOSEN)
        self._left = 0
        self._kept: list[Callable[[P, str], None]] = []

    def _is_chosen(self) -> bool:
        self._left -= 1
        if self._left >= 0:
            return False
        self._left = int(self._rng.integers(self._longest))
        return True

    def _keep(self, check: Callable[[P, str], None]) -> None:
        """Keeps a question for the end; a long simulation keeps only the latest ones.

        `check` asks a plugin, the one or the other, in a way that it is told in words.
        """
        self._kept = [*self._kept[1 - KEPT :], check]

    def finish(self, whose: str) -> None:
        """Asks the chosen questions again, after all others.

        Raises:
            AgentError: An answer differs; the message begins with `whose`.
        """
        kept, self._kept = self._kept, []
        try:
            for check in reversed(kept):
                check(self._other, "another instance of it is asked")
                check(self.plugin, AT_THE_END)
            for check in kept[:1] * MORE_AT_THE_END:
                check(self.plugin, AT_THE_END)
        except BrokenWordError as error:
            raise AgentError(f"{whose}: {error}") from error
        except PLUGIN_ERRORS as error:
            raise AgentError(f"{whose}: {raised(error)}") from error


class HeldTraffic(Held[Traffic], Traffic):
    """A traffic of a plugin."""

    def __init__(self, traffic: Traffic, other: Traffic, rng: np.random.Generator) -> None:
        super().__init__(traffic, other, rng, ASSIGNMENTS)
        self.agents = tuple(traffic.agents)

    def assign(self, rng: np.random.Generator, scenes: int, vehicles: int) -> NDArray[np.str_]:
        if not self._is_chosen():
            return self.plugin.assign(rng, scenes, vehicles)
        before = deepcopy(rng)
        said = np.array(self.plugin.assign(rng, scenes, vehicles))

        def check(traffic: Traffic, how: str) -> None:
            again = np.asarray(traffic.assign(deepcopy(before), scenes, vehicles))
            if not np.array_equal(said, again):
                raise BrokenWordError(f"assign returned other agents when {how}")

        check(self.plugin, "asked again with the same random numbers")
        self._keep(check)
        return said


class HeldEvent(Held[Event], Event):
    """An event of a plugin."""

    def __init__(self, event: Event, rng: np.random.Generator, calls: int) -> None:
        super().__init__(event, event, rng, calls)
        self.definition = event.definition
        self.includes_failure = event.includes_failure  # type: ignore[misc]  # the event's

    def level(self, scene: Scene, rows: Ints) -> Floats:
        if not self._is_chosen():
            return self.plugin.level(scene, rows)
        before, egos = copied(scene), (rows.copy(), scene.ego[rows])
        levels = np.array(self.plugin.level(scene, rows), dtype=np.float64)
        check_scene("level", scene, before, (rows,), (egos[0],))
        if levels.shape == rows.shape:  # else the simulation says it

            def ask(scene: Scene, vehicles: Vehicles) -> Answers:
                return (np.array(self.plugin.level(scene, vehicles[0]), dtype=np.float64),)

            part = SceneQuestion("level", before, egos, (levels,)).check_order(ask, self._rng)
            self._keep(lambda _, how: part.check(ask, how))
        return levels


AT_THE_END = "asked again after the last call"


def check_scene(
    name: str,
    scene: Scene,
    before: Scene,
    vehicles: Vehicles,
    asked: Vehicles,
    timers: Vehicles | None = None,
) -> None:
    """Checks that a plugin has changed nothing but the timers of the vehicles `timers`."""
    if array := changed_array(scene, before, timers):
        raise BrokenWordError(f"{name} changed scene.{array}")
    if not all(map(equal, vehicles, asked)):
        raise BrokenWordError(f"{name} changed the indices that it was given")


def equal(one: NDArray[Any], other: NDArray[Any]) -> bool:
    """Whether two arrays are equal; NaN equals NaN."""
    return bool(np.array_equal(one, other) or np.array_equal(one, other, equal_nan=True))
