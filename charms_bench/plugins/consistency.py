"""Checks that what a plugin answers depends only on what it is asked.

`charms-bench check` asks the questions of this module about example scenes, and every shard of a
run asks one of its own questions again. The seed of the shard chooses the call. After the last call
of the shard, another instance of the plugin is asked about half of the same vehicles in another
order, then about half of these, and so on; its answers must be the same. So a plugin is found that
keeps state, draws its own random numbers or calculates across its batch. A plugin must not change
what it is shown, either.

A plugin that remembers its own answers, or changes other code of its process, can deceive this; a
new simulation in another process shows the difference (`charms-bench audit`).
"""

from collections.abc import Callable, Sequence
from copy import deepcopy
from dataclasses import dataclass
from typing import Any, Generic, Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

from charms_bench.errors import PLUGIN_ERRORS, AgentError, BrokenWordError, raised
from charms_bench.plugins.agent import Agent, DriverModel, Policy
from charms_bench.plugins.deciding import Question, answer_of, part_of
from charms_bench.plugins.event import Event
from charms_bench.plugins.traffic import Traffic
from charms_bench.world.actions import Actions, problem_of
from charms_bench.world.observations import OBSERVATIONS, ObservationLike
from charms_bench.world.scene import (
    ARRAYS,
    WRITABLE,
    Bools,
    Floats,
    Ints,
    Observations,
    Scene,
    SceneSettings,
    Vehicles,
)

P = TypeVar("P")
Answers = Sequence[NDArray[Any]]
"""Arrays (M, ...)."""
TIMES = 10
"""How often the other instance is asked: some state is only seen after several calls."""
ASSIGNMENTS = 150
"""About how many episodes a shard has."""
AGAIN = "another instance was asked about some of the vehicles in another order"
SCENE_ROUNDING = 1e-9
"""Largest relative difference of two answers about scenes, for plugins whose libraries add in
another order when there are fewer vehicles."""
ROUNDING = 1e-4
"""Largest difference of a continuous action or of what a policy remembers between two sizes of a
batch: float32 rounds by 6e-8, and a sum of a thousand products may be added in another order."""
NEARBY, VARIANTS = 1e-6, 64
"""Relative changes of an observation that move a network's values about as much as rounding, and
how many are tried."""


class Call(Protocol):
    """A call to a plugin, with what it answered."""

    def check(self, plugin: Any, rows: Ints, how: str, exactly: bool = False) -> None:
        """Asks about some of the scenes or vehicles of the call, in the order of `rows`.

        Answers may differ as far as rounding explains it, unless they must be `exactly` the same.
        Raises a `BrokenWordError` if an answer differs; it says `how` the plugin was asked.
        """


@dataclass(frozen=True)
class PolicyCall:
    """A call of `Policy.decide` about M vehicles."""

    asked: Question
    actions: Actions
    """(M,) or (M, 2)."""
    memory: Floats
    """(M, Q) the new memory."""

    def check(self, plugin: Policy, rows: Ints, how: str, exactly: bool = False) -> None:
        """See `Call.check`; the rows are vehicles.

        Rounding can explain one meta-action, and all continuous actions and memory.
        """
        rounding = 0.0 if exactly else ROUNDING
        actions, memory = self.actions[rows], self.memory[rows]
        part = part_of(self.asked, rows)
        again, kept = answer_of(plugin, part, plugin.decide(*part))
        if again.shape != actions.shape:
            raise BrokenWordError(f"decide returned shape {again.shape} when {how}")
        is_meta = actions.ndim == 1
        same = again == actions if is_meta else (np.abs(again - actions) <= rounding).all(axis=1)
        differing = np.flatnonzero(~same)
        if differing.size:
            at = int(differing[0])
            one = part_of(self.asked, rows[[at]])
            is_one = differing.size == 1 and is_meta and not exactly
            if not (is_one and is_between(plugin, one, actions[at], again[at])):
                what = f"decide returned {actions[at]}, and {again[at]} when {how}"
                raise BrokenWordError(what, int(rows[at]))
        if plugin.memory_width:
            same = np.isclose(kept, memory, rounding, rounding).all(axis=1)
            if not same.all():
                what = f"decide returned other memory when {how}"
                raise BrokenWordError(what, int(rows[same.argmin()]))


def is_between(policy: Policy, one: Question, *actions: int) -> bool:
    """Whether rounding explains that a question about one vehicle gets one action or another.

    It does if the same observation always gets the same action, and observations that hardly differ
    from it get all of these actions, each alone: a policy that standardises its batch tells any
    observations apart.
    """
    again = (answer_of(policy, one, policy.decide(*one))[0] for _ in range(TIMES))
    if len({int(action[0]) for action in again}) > 1:
        return False
    noise = np.random.default_rng(0).uniform(-NEARBY, NEARBY, (VARIANTS, *one[0].shape))
    nearby = (one[0] * (1 + noise)).astype(one[0].dtype)
    answers = (answer_of(policy, one, policy.decide(each, *one[1:])) for each in nearby)
    found = {int(action[0]) for action, _ in answers}
    return {*map(int, actions)} <= found


@dataclass(frozen=True)
class SceneCall:
    """A call of a plugin that was shown scenes."""

    name: str
    """What was called, for messages."""
    ask: Callable[[Any, Scene, Vehicles], Answers]
    """Calls a plugin."""
    scene: Scene
    """A copy of the scenes from before the call."""
    vehicles: Vehicles
    """M vehicles."""
    said: Answers
    """The answers; those for crashed vehicles do not matter."""

    def check(self, plugin: Any, rows: Ints, how: str, exactly: bool = False) -> None:
        """See `Call.check`; the rows are scenes."""
        rounding = 0.0 if exactly else SCENE_ROUNDING
        arrays = {name: getattr(self.scene, name)[rows] for name in ARRAYS}
        for name, array in arrays.items():
            array.flags.writeable = name in WRITABLE
        place = np.full(len(self.scene.active), -1)
        place[rows] = np.arange(rows.size)
        shown = place[self.vehicles[0]]
        index = np.argsort(shown, kind="stable")[np.count_nonzero(shown < 0) :]
        scene = self.scene._replace(**arrays)
        vehicles = shown[index].astype(self.vehicles[0].dtype), self.vehicles[1][index]
        if self.scene.junctions is not None:  # which know the scenes by their numbers
            scene = copied(self.scene)
            vehicles = self.vehicles[0][index], self.vehicles[1][index]
        again = self.ask(plugin, scene, tuple(map(np.copy, vehicles)))
        for then, now in zip((each[index] for each in self.said), again, strict=True):
            if now.shape != then.shape:
                raise BrokenWordError(f"{self.name} returned shape {now.shape} when {how}")
            wrong = ~scene.crashed[vehicles] & ~_close(then, now, rounding)
            if wrong.any():
                at = int(wrong.argmax())
                values = f"{then[at]}, and {now[at]}" if now.ndim == 1 else "other values"
                raise BrokenWordError(f"{self.name} returned {values} when {how}", at)


def _close(one: NDArray[Any], other: NDArray[Any], rounding: float) -> Bools:
    """(M,) whether answers (M, ...) are equal but for rounding."""
    are_numbers = one.dtype.kind in "fiu" and other.dtype.kind in "fiu"
    how = rounding, rounding, True
    same = np.isclose(one, other, *how) if are_numbers else np.asarray(one == other)
    return np.asarray(same.reshape(len(one), -1).all(axis=1))


def called(
    name: str,
    ask: Callable[[Any, Scene, Vehicles], Answers],
    plugin: Any,
    scene: Scene,
    vehicles: Vehicles,
    writes: bool = False,
) -> SceneCall:
    """Calls a plugin, which must change nothing of what it is shown.

    If it `writes`, it may change the arrays `WRITABLE` of its vehicles. Raises a `BrokenWordError`
    if it has changed something else.
    """
    before, asked = copied(scene), tuple(map(np.copy, vehicles))
    said = tuple(map(np.array, ask(plugin, scene, vehicles)))
    for array in ARRAYS:
        now, then = getattr(scene, array), getattr(before, array)
        if writes and array in WRITABLE:
            now, then = now.copy(), then.copy()
            now[asked] = then[asked] = 0.0
        if not np.array_equal(now, then, equal_nan=now.dtype.kind == "f"):
            raise BrokenWordError(f"{name} changed scene.{array}")
    if not all(map(np.array_equal, vehicles, asked)):
        raise BrokenWordError(f"{name} changed the indices that it was given")
    return SceneCall(name, ask, before, asked, said)


def copied(scene: Scene) -> Scene:
    """A copy of all arrays."""
    return scene._replace(**{name: getattr(scene, name).copy() for name in ARRAYS})


def driving(model: DriverModel, scene: Scene, vehicles: Vehicles) -> Answers:
    """The accelerations and lanes that a driver model returns, and what it writes."""
    own = tuple(map(np.copy, vehicles))  # which the model could change
    acceleration, lane = model.drive(scene, vehicles)
    written = (getattr(scene, name)[own] for name in WRITABLE)
    return np.asarray(acceleration), np.asarray(lane), *written


class Checked(Generic[P]):
    """A plugin of which one call is asked again.

    Args:
        other: Another instance of the plugin, made in the same way.
        rng: Chooses the call and the vehicles.
        calls: About how many calls a shard has. If there are fewer, the first one is asked again.
    """

    def __init__(self, plugin: P, other: P, rng: np.random.Generator, calls: int) -> None:
        self.plugin, self._other, self._rng = plugin, other, rng
        self._calls, self._chosen = 0, int(rng.integers(max(calls, 1)))
        self._noted: tuple[Call, Ints] | None = None
        """The call, and half of its scenes or vehicles in another order."""

    def _is_chosen(self) -> bool:
        self._calls += 1
        return self._calls - 1 in (0, self._chosen)

    def _note(self, call: Call, rows: Ints) -> None:
        self._noted = call, self._rng.permutation(rows)[: max(1, rows.size // 2)]

    def _shown(self, call: SceneCall) -> Answers:
        """The answers of a call about scenes, which is noted."""
        if all(each.shape[:1] == call.vehicles[0].shape for each in call.said):
            self._note(call, np.unique(call.vehicles[0]))
            if call.scene.junctions is not None:  # which describe the present moment only
                self._ask_again(self._other, TIMES, AGAIN)
                self._noted = None
        return call.said  # with another shape, the simulation says what is wrong

    def _ask_again(self, plugin: P, times: int, how: str) -> None:
        """Asks about the noted vehicles, then about half of them, and never one alone twice."""
        if self._noted is not None:
            call, rows = self._noted
            for k in range(times):
                part = (np.arange(max(1, rows.size >> k)) + k) % rows.size
                call.check(plugin, rows[part], how)

    def finish(self, whose: str) -> None:
        """Asks the other instance after all calls; raises an `AgentError` if an answer differs."""
        try:
            self._ask_again(self._other, TIMES, AGAIN)
        except BrokenWordError as error:
            raise AgentError(f"{whose}: {error}") from error
        except PLUGIN_ERRORS as error:
            raise AgentError(f"{whose}: {raised(error)}") from error


def checked(
    agent: Agent, other: Agent, settings: SceneSettings, rng: np.random.Generator
) -> "CheckedPolicy | CheckedModel":
    """An agent of which one call is asked again; see `Checked`.

    Raises a `BrokenWordError` if one is a policy and the other is a driver model.
    """
    if isinstance(agent, DriverModel) and isinstance(other, DriverModel):
        return CheckedModel(agent, other, rng, settings.decisions * settings.steps_per_decision)
    if isinstance(agent, Policy) and isinstance(other, Policy):
        return CheckedPolicy(agent, other, rng, settings.decisions)
    kinds = f"a {type(agent).__name__} and then a {type(other).__name__}"
    raise BrokenWordError(f"the plugin made {kinds}; expected the same kind of agent each time")


class CheckedPolicy(Checked[Policy], Policy):
    """A policy of a plugin, or a network."""

    def __init__(self, policy: Policy, other: Policy, rng: np.random.Generator, calls: int) -> None:
        super().__init__(policy, other, rng, calls)
        self.observation = _checked_observation(policy.observation, rng, calls)
        self.actions, self.decision_hz = policy.actions, policy.decision_hz
        self.history_length, self.memory_width = policy.history_length, policy.memory_width
        self.noise_draws, self.rollouts_with = policy.noise_draws, policy.rollouts_with

    def decide(self, observations: Observations, *given: Any) -> Any:
        if not self._is_chosen():
            return self.plugin.decide(observations, *given)
        names, asked = ("observations", "memory", "noise"), (observations, *given)
        before = [np.array(each) for each in asked[: len(names)]]
        answer = self.plugin.decide(observations, *given)
        for name, was, now in zip(names, before, asked, strict=False):
            if not np.array_equal(was, now, equal_nan=True):
                raise BrokenWordError(f"decide changed its {name}")
        actions, memory = answer_of(self, asked, answer)
        if problem_of(actions, self.actions, len(observations))[0]:
            return answer  # the simulation says what is wrong
        said = np.array(actions), np.array(memory)
        self._note(PolicyCall((*before, *asked[len(names) :]), *said), np.arange(len(observations)))
        if self.rollouts_with:  # now: a planner looks ahead from the scene as it is
            self._ask_again(self._other, 1, AGAIN)
            self._noted = None
        return answer


class CheckedModel(Checked[DriverModel], DriverModel):
    """A driver model of a plugin."""

    def __init__(
        self, model: DriverModel, other: DriverModel, rng: np.random.Generator, calls: int
    ) -> None:
        super().__init__(model, other, rng, calls)
        self.highway_env_class = model.highway_env_class  # type: ignore[misc]  # the model's
        self.parameters, self.memory_width = model.parameters, model.memory_width
        self.follows_recording = model.follows_recording

    def drive(self, scene: Scene, vehicles: Vehicles) -> tuple[Floats, Ints]:
        if not self._is_chosen():
            return self.plugin.drive(scene, vehicles)
        call = called("drive", driving, self.plugin, scene, vehicles, writes=True)
        acceleration, lane, *_ = self._shown(call)
        return acceleration, lane


class CheckedTraffic(Checked[Traffic], Traffic):
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
        self._noted = _Assignment(before, scenes, vehicles, said), np.arange(1)
        return said


@dataclass(frozen=True)
class _Assignment:
    """A call of `Traffic.assign`, which is always asked again as a whole."""

    rng: np.random.Generator
    scenes: int
    vehicles: int
    said: NDArray[np.str_]

    def check(self, plugin: Traffic, rows: Ints, how: str, exactly: bool = True) -> None:
        again = np.asarray(plugin.assign(deepcopy(self.rng), self.scenes, self.vehicles))
        if not np.array_equal(self.said, again):
            what = "assign returned other agents when asked again with the same random numbers"
            raise BrokenWordError(what)


class CheckedEvent(Checked[Event], Event):
    """An event of a plugin."""

    def __init__(self, event: Event, other: Event, rng: np.random.Generator, calls: int) -> None:
        super().__init__(event, other, rng, calls)
        self.definition = event.definition
        self.includes_failure = event.includes_failure  # type: ignore[misc]  # the event's
        self.sees_network = event.sees_network  # type: ignore[misc]

    def level(self, scene: Scene, rows: Ints) -> Floats:
        if not self._is_chosen():
            return self.plugin.level(scene, rows)

        def ask(event: Event, scene: Scene, egos: Vehicles) -> Answers:
            return (np.asarray(event.level(scene, egos[0]), dtype=np.float64),)

        egos = rows, scene.ego[rows]
        return self._shown(called("level", ask, self.plugin, scene, egos))[0]


class _CheckedObservation(Checked[Any]):
    """An observation of a plugin, which is asked again at once."""

    def __init__(self, observation: Any, rng: np.random.Generator, calls: int) -> None:
        super().__init__(observation, observation, rng, calls)
        self.shape = observation.shape

    def __call__(self, scene: Scene, vehicles: Vehicles) -> Observations:
        if not self._is_chosen():
            return np.asarray(self.plugin(scene, vehicles))
        ask = lambda it, *of: (np.asarray(it(*of)),)  # noqa: E731
        (seen,) = self._shown(called("the observation", ask, self.plugin, scene, vehicles))
        self._ask_again(self.plugin, 1, "asked in another order")
        return seen


def _checked_observation(like: ObservationLike, rng: np.random.Generator, calls: int) -> Any:
    is_ours = not callable(like) or type(like) in OBSERVATIONS.values()
    return like if is_ours else _CheckedObservation(like, rng, calls)
