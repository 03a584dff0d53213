"""Holds plugins to their word during a run: one of their questions is asked again.

The seed of a shard chooses the call. After the last call of the shard, another instance of the
plugin is asked about half of the same vehicles in another order, then about half of these, and so
on; its answers must be the same. So a plugin is found out that keeps state, draws its own random
numbers or calculates across its batch. What a plugin is shown in this call must be the same after
it.

A plugin that remembers its own answers, or changes other code of its process, can deceive this.
"""

from collections.abc import Callable
from copy import deepcopy
from functools import partial
from typing import Generic, TypeVar

import numpy as np
from numpy.typing import NDArray

from charms_bench.errors import PLUGIN_ERRORS, AgentError, BrokenWordError, raised
from charms_bench.plugins.event import Event
from charms_bench.plugins.scene_questions import (
    Answers,
    SceneQuestion,
    check_scene,
    copied,
    some_of,
)
from charms_bench.plugins.traffic import Traffic
from charms_bench.world.scene import Floats, Ints, Scene, Vehicles

P = TypeVar("P")
TIMES = 10
"""How often the other instance is asked: some state is only seen after several calls."""
ASSIGNMENTS = 150
"""About how many episodes a shard has."""
AGAIN = "another instance was asked about some of the vehicles in another order"


class Held(Generic[P]):
    """A plugin of which one call is asked again; `again` says how.

    Args:
        other: Another instance of the plugin, made in the same way.
        rng: Chooses the call and the vehicles.
        calls: About how many calls a shard has. If there are fewer, the first one is asked again.
    """

    again = AGAIN

    def __init__(self, plugin: P, other: P, rng: np.random.Generator, calls: int) -> None:
        self.plugin, self._other, self._rng = plugin, other, rng
        self._calls, self._chosen = 0, int(rng.integers(max(calls, 1)))
        self._question: Callable[[P, int], None] | None = None
        """Asks a plugin about half of the vehicles, halved so many times."""

    def _is_chosen(self) -> bool:
        self._calls += 1
        return self._calls - 1 in (0, self._chosen)

    def _answers(
        self,
        name: str,
        ask: Callable[[P, Scene, Vehicles], Answers],
        scene: Scene,
        vehicles: Vehicles,
        writes: bool = False,
    ) -> Answers:
        """What the plugin answers about M vehicles in a chosen call, (M, ...)."""
        before, asked = copied(scene), tuple(map(np.copy, vehicles))
        said = tuple(map(np.array, ask(self.plugin, scene, vehicles)))
        check_scene(name, scene, before, vehicles, asked, writes)
        if all(each.shape[:1] == asked[0].shape for each in said):  # else the simulation says it
            some = some_of(np.unique(asked[0]), self._rng)
            part = SceneQuestion(name, before, asked, said).part(some)
            self._question = lambda it, k: part.halved(k).check(partial(ask, it), self.again)
        return said

    def finish(self, whose: str) -> None:
        """Asks the other instance after all calls; raises an `AgentError` if an answer differs."""
        try:
            for halvings in range(TIMES):
                if self._question is not None:
                    self._question(self._other, halvings)
        except BrokenWordError as error:
            raise AgentError(f"{whose}: {error}") from error
        except PLUGIN_ERRORS as error:
            raise AgentError(f"{whose}: {raised(error)}") from error


class HeldTraffic(Held[Traffic], Traffic):
    """A traffic of a plugin."""

    def __init__(self, traffic: Traffic, other: Traffic, rng: np.random.Generator) -> None:
        super().__init__(traffic, other, rng, ASSIGNMENTS)
        self.agents = tuple(traffic.agents)
        self.after_deviation = traffic.after_deviation

    def assign(self, rng: np.random.Generator, scenes: int, vehicles: int) -> NDArray[np.str_]:
        if not self._is_chosen():
            return self.plugin.assign(rng, scenes, vehicles)
        before = deepcopy(rng)
        said = np.array(self.plugin.assign(rng, scenes, vehicles))

        def question(traffic: Traffic, _: int) -> None:
            again = np.asarray(traffic.assign(deepcopy(before), scenes, vehicles))
            if not np.array_equal(said, again):
                what = "assign returned other agents when asked again with the same random numbers"
                raise BrokenWordError(what)

        self._question = question
        return said


class HeldEvent(Held[Event], Event):
    """An event of a plugin."""

    def __init__(self, event: Event, other: Event, rng: np.random.Generator, calls: int) -> None:
        super().__init__(event, other, rng, calls)
        self.definition = event.definition
        self.includes_failure = event.includes_failure  # type: ignore[misc]  # the event's

    def level(self, scene: Scene, rows: Ints) -> Floats:
        if not self._is_chosen():
            return self.plugin.level(scene, rows)

        def ask(event: Event, scene: Scene, egos: Vehicles) -> Answers:
            return (np.asarray(event.level(scene, egos[0]), dtype=np.float64),)

        return self._answers("level", ask, scene, (rows, scene.ego[rows]))[0]
