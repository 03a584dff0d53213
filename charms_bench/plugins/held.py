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
from charms_bench.plugins.agent import Agent, DriverModel, Policy
from charms_bench.plugins.event import Event
from charms_bench.plugins.onnx_policy import OnnxPolicy
from charms_bench.plugins.scene_questions import (
    Answers,
    Ask,
    SceneQuestion,
    changed_array,
    copied,
)
from charms_bench.plugins.traffic import Traffic
from charms_bench.world.actions import Actions
from charms_bench.world.kinematics_observation import Kinematics
from charms_bench.world.observations import Neighbours, ObservationLike
from charms_bench.world.scene import Floats, Ints, Observations, Scene, SceneSettings, Vehicles

P = TypeVar("P")
"""The kind of a plugin."""
ROWS = 64
"""Most vehicles that are asked about again in another order."""
ALONE = 3
"""Most vehicles that are asked about alone."""
CHOSEN = 2
"""About how many calls of a shard are asked again, besides the first."""
MORE_AT_THE_END = 9
"""How many more times the first question is asked after the last call."""
KEPT = 20
"""Most questions that are kept for the end."""
ASSIGNMENTS = 150
"""About how many episodes a shard has."""
NETWORK_ROUNDING = 1e-4
"""Largest difference of a network's values between two sizes of a batch, relative to the largest
value: float32 rounds by 6e-8, and a sum of a thousand products may be added in another order. With
batches of 1, 7, 64 and 300, the 21 networks in the package gave the same bits for 168,000
observations from seeds above 900,000,000."""
NEARBY = 1e-6
"""Relative changes of an observation that move a network's values about as much as rounding."""


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
                check(self.plugin, _AT_THE_END)
            for check in kept[:1] * MORE_AT_THE_END:
                check(self.plugin, _AT_THE_END)
        except BrokenWordError as error:
            raise AgentError(f"{whose}: {error}") from error
        except PLUGIN_ERRORS as error:
            raise AgentError(f"{whose}: {raised(error)}") from error


def hold(
    agent: Agent, other: Agent, settings: SceneSettings, rng: np.random.Generator
) -> "HeldPolicy | HeldNetwork | HeldModel":
    """An agent that is asked again now and then.

    Args:
        agent: The agent.
        other: Another instance of it, made in the same way.
        settings: The scene, which decides how often it is called.
        rng: Chooses the calls.
    """
    if isinstance(agent, DriverModel):
        assert isinstance(other, DriverModel)
        return HeldModel(agent, other, rng, settings.decisions * settings.steps_per_decision)
    if type(agent) is OnnxPolicy:
        return HeldNetwork(agent, rng, settings.decisions)
    assert isinstance(other, Policy)
    return HeldPolicy(agent, other, rng, settings.decisions)


class HeldPolicy(Held[Policy], Policy):
    """A policy of a plugin."""

    def __init__(self, policy: Policy, other: Policy, rng: np.random.Generator, calls: int) -> None:
        super().__init__(policy, other, rng, calls)
        self.observation = _held_observation(policy.observation, rng, calls)
        self.decision_hz = policy.decision_hz

    def decide(self, observations: Observations) -> Actions:
        if not self._is_chosen():
            return self.plugin.decide(observations)
        before = observations.copy()
        answer = np.asarray(self.plugin.decide(observations))
        if not _equal(observations, before):
            raise BrokenWordError("decide changed its observations")
        if answer.shape != (len(before),):
            return answer  # the simulation says what is wrong
        answer = answer.copy()
        some = _some(len(before), self._rng)
        check_actions(self.plugin, before, answer, "asked again")
        check_actions(self.plugin, before[some], answer[some], _among(len(some)), some)
        for one in some[:ALONE, None]:
            check_actions(self.plugin, before[one], answer[one], _ALONE, one)
        mine, said = before[some], answer[some]
        self._keep(lambda policy, how: check_actions(policy, mine, said, how))
        return answer


def check_actions(
    policy: Policy, observations: Observations, expected: Actions, how: str, rows: Any = None
) -> None:
    """Asks a policy and compares its actions; one action may differ if rounding explains it.

    Args:
        policy: The policy.
        observations: (M, ...) what to ask.
        expected: (M,) the actions.
        how: In words, how it is asked.
        rows: (M,) the vehicles' indices in the call; by default 0 to M - 1.

    Raises:
        BrokenWordError: An action differs.
    """
    again = np.asarray(policy.decide(observations.copy()))
    if again.shape != expected.shape:
        raise BrokenWordError(f"decide returned shape {again.shape} when {how}")
    differing = np.nonzero(again != expected)[0]
    if not differing.size:
        return
    at = int(differing[0])
    if differing.size == 1 and is_between(policy, observations[at], expected[at], again[at]):
        return
    raise BrokenWordError(
        f"decide returned {expected[at]}, and {again[at]} when {how}",
        at if rows is None else int(rows[at]),
    )


def is_between(policy: Policy, observation: Observations, *actions: int) -> bool:
    """Whether rounding explains that an observation gets one action or another.

    It does if observations that hardly differ from this one get all of these actions, each alone: a
    policy that standardises its batch tells any observations apart.
    """
    noise = np.random.default_rng(0).uniform(-NEARBY, NEARBY, (ROWS, *observation.shape))
    nearby = (observation * (1 + noise)).astype(observation.dtype)
    found = {int(np.asarray(policy.decide(one))[0]) for one in nearby[:, None]}
    return {*map(int, actions)} <= found


class HeldNetwork(Held[OnnxPolicy], Policy):
    """A network in an ONNX file, which has neither state nor random numbers.

    It could still calculate across its batch, so its values are compared.
    """

    def __init__(self, network: OnnxPolicy, rng: np.random.Generator, calls: int) -> None:
        super().__init__(network, network, rng, calls)
        self.observation, self.decision_hz = network.observation, network.decision_hz

    def decide(self, observations: Observations) -> Actions:
        if not self._is_chosen():
            return self.plugin.decide(observations)
        values = self.plugin.values(observations)
        some = _some(len(observations), self._rng)
        for rows in (some, *some[:ALONE, None]):
            check_values(self.plugin, observations[rows], values[rows], rows)
        return np.asarray(np.argmax(values, axis=1))


def check_values(
    network: OnnxPolicy, observations: Observations, expected: NDArray[np.float32], rows: Ints
) -> None:
    """Compares the values (M, 5) of a network with those for another batch.

    Raises:
        BrokenWordError: They differ by more than `NETWORK_ROUNDING` explains.
    """
    again = network.values(observations)
    same = again == expected
    with np.errstate(invalid="ignore"):
        difference = np.where(same, 0.0, np.abs(again - expected)).max(axis=1)
    too_large = ~(difference <= NETWORK_ROUNDING * np.abs(expected).max(axis=1))
    if too_large.any():
        at = int(too_large.argmax())
        raise BrokenWordError(
            f"the network's values differ by {difference[at]:.2g} in a batch of {len(rows)}; a "
            "vehicle's values must not depend on the other vehicles in the batch",
            int(rows[at]),
        )


class HeldModel(Held[DriverModel], DriverModel):
    """A driver model of a plugin."""

    def __init__(
        self, model: DriverModel, other: DriverModel, rng: np.random.Generator, calls: int
    ) -> None:
        super().__init__(model, other, rng, calls)
        self.highway_env_class = model.highway_env_class  # type: ignore[misc]  # the model's

    def drive(self, scene: Scene, vehicles: Vehicles) -> tuple[Floats, Ints]:
        if not self._is_chosen():
            return self.plugin.drive(scene, vehicles)
        before, asked = copied(scene), tuple(map(np.copy, vehicles))
        answer = self.plugin.drive(scene, vehicles)
        acceleration, lane, timers = np.asarray(answer[0]), np.asarray(answer[1]), scene.timer_s
        _check_scene("drive", scene, before, vehicles, asked, asked)
        if acceleration.shape == lane.shape == asked[0].shape:  # else the simulation says it
            acceleration, lane = acceleration.copy(), lane.copy()
            question = SceneQuestion("drive", before, asked, (acceleration, lane, timers[asked]))
            part = question.check_order(driving(self.plugin), self._rng)
            self._keep(lambda model, how: part.check(driving(model), how))
        return acceleration, lane


def driving(model: DriverModel) -> Ask:
    """Asks a driver model for accelerations and lanes, and for the timers that it leaves."""

    def ask(scene: Scene, vehicles: Vehicles) -> Answers:
        answer = model.drive(scene, vehicles)
        return np.asarray(answer[0]), np.asarray(answer[1]), scene.timer_s[vehicles]

    return ask


class _HeldObservation(Held[Any]):
    """An observation of a plugin."""

    def __init__(self, observation: Any, rng: np.random.Generator, calls: int) -> None:
        super().__init__(observation, observation, rng, calls)
        self.shape = observation.shape

    def __call__(self, scene: Scene, vehicles: Vehicles) -> Observations:
        if not self._is_chosen():
            return np.asarray(self.plugin(scene, vehicles))
        before, asked = copied(scene), tuple(map(np.copy, vehicles))
        seen = np.array(self.plugin(scene, vehicles))
        _check_scene("the observation", scene, before, vehicles, asked)

        def ask(scene: Scene, vehicles: Vehicles) -> Answers:
            return (np.array(self.plugin(scene, vehicles)),)

        if len(seen) == asked[0].size:  # else the policy cannot answer
            question = SceneQuestion("the observation", before, asked, (seen,))
            question.check_order(ask, self._rng)
        return seen


def _held_observation(like: ObservationLike, rng: np.random.Generator, calls: int) -> Any:
    is_ours = not callable(like) or type(like) in (Neighbours, Kinematics)
    return like if is_ours else _HeldObservation(like, rng, calls)


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
        _check_scene("level", scene, before, (rows,), (egos[0],))
        if levels.shape == rows.shape:  # else the simulation says it

            def ask(scene: Scene, vehicles: Vehicles) -> Answers:
                return (np.array(self.plugin.level(scene, vehicles[0]), dtype=np.float64),)

            part = SceneQuestion("level", before, egos, (levels,)).check_order(ask, self._rng)
            self._keep(lambda _, how: part.check(ask, how))
        return levels


_AT_THE_END = "asked again after the last call"
_ALONE = "asked about this vehicle alone"


def _among(vehicles: int) -> str:
    return f"asked about {vehicles} vehicles in another order"


def _some(vehicles: int, rng: np.random.Generator) -> Ints:
    """Half of the vehicles, or `ROWS` of them, in another order."""
    return rng.permutation(vehicles)[: max(1, min(ROWS, vehicles // 2))]


def _check_scene(
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
    if not all(map(_equal, vehicles, asked)):
        raise BrokenWordError(f"{name} changed the indices that it was given")


def _equal(one: NDArray[Any], other: NDArray[Any]) -> bool:
    return bool(np.array_equal(one, other) or np.array_equal(one, other, equal_nan=True))
