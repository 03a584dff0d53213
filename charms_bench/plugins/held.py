"""Holds plugins to their word during a run: some of their questions are asked again.

The seed of a shard chooses the calls. Their answers must be the same at once, for some of the
vehicles in another order, for one vehicle or scene alone, after the last call of the shard, and
from another instance of the plugin. What a plugin is shown must be the same after the call.

A plugin that remembers its own answers, or changes other code of its process, can deceive this.
"""

from collections.abc import Callable
from copy import deepcopy
from typing import Any

import numpy as np
from numpy.typing import NDArray

from charms_bench.errors import PLUGIN_ERRORS, AgentError, BrokenWordError, raised
from charms_bench.plugins.agent import Agent, DriverModel, Policy
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

ROWS = 64
"""Most vehicles that are asked about again in another order."""
KEPT = 20
"""Most questions that are kept for the end."""
ASSIGNMENTS = 50
"""Every how many episodes a traffic is asked again, about."""
NETWORK_ROUNDING = 1e-4
"""Largest difference of a network's values between two sizes of a batch, relative to the largest
value. onnxruntime adds in another order; the networks in the package differ by at most 2e-6."""
NEARBY = 1e-6
"""Relative changes of an observation that move a network's values about as much as rounding."""


class Held:
    """A plugin of which some calls are asked again.

    Args:
        rng: Chooses the calls and the vehicles.
        calls: About how many calls a shard has; the first and about two others are chosen.
    """

    def __init__(self, rng: np.random.Generator, calls: int) -> None:
        self._rng, self._calls = rng, max(1, calls)
        self._left = 0
        self._kept: list[Callable[[], None]] = []

    def _is_chosen(self) -> bool:
        self._left -= 1
        if self._left >= 0:
            return False
        self._left = int(self._rng.integers(self._calls))
        return True

    def _keep(self, ask_again: Callable[[], None]) -> None:
        """Keeps a question for the end; a long simulation keeps only the latest ones."""
        self._kept = [*self._kept[-KEPT:], ask_again]

    def finish(self, whose: str) -> None:
        """Asks the chosen questions again, after all others.

        Raises:
            AgentError: An answer differs; the message begins with `whose`.
        """
        kept, self._kept = self._kept, []
        for ask_again in reversed(kept):
            try:
                ask_again()
            except BrokenWordError as error:
                raise AgentError(f"{whose}: {error}") from error
            except PLUGIN_ERRORS as error:
                raise AgentError(f"{whose}: {raised(error)}") from error


def hold(agent: Agent, other: Agent, settings: SceneSettings, rng: np.random.Generator) -> Any:
    """An agent that is asked again now and then, as a `Held` of the same kind.

    Args:
        agent: The agent.
        other: Another instance of it, made in the same way.
        settings: The scene, which decides how often it is called.
        rng: Chooses the calls.
    """
    steps = settings.decisions * settings.steps_per_decision
    if isinstance(agent, DriverModel):
        return HeldModel(agent, other, rng, steps)
    decisions = settings.decisions
    if type(agent) is OnnxPolicy:
        return HeldNetwork(agent, rng, decisions)
    return HeldPolicy(agent, other, rng, decisions)


class HeldPolicy(Held, Policy):
    """A policy of a plugin."""

    def __init__(self, policy: Policy, other: Agent, rng: np.random.Generator, calls: int) -> None:
        super().__init__(rng, calls)
        assert isinstance(other, Policy)
        self._policy, self._other = policy, other
        self.observation = _held_observation(policy.observation, rng, calls)
        self.decision_hz = policy.decision_hz

    def decide(self, observations: Observations) -> Actions:
        if not self._is_chosen():
            return self._policy.decide(observations)
        before = observations.copy()
        answer = np.array(self._policy.decide(observations))
        if not _equal(observations, before):
            raise BrokenWordError("decide changed its observations")
        if answer.shape != (len(before),):
            return answer  # the simulation says what is wrong
        some = self._rng.permutation(len(before))[:ROWS]
        one = some[:1]
        check_actions(self._policy, before, answer, "asked again")
        check_actions(self._policy, before[some], answer[some], _among(len(some)), some)
        check_actions(self._policy, before[one], answer[one], "about this vehicle alone", one)
        mine, said = before[some], answer[some]
        self._keep(lambda: check_actions(self._other, mine, said, _BY_ANOTHER))
        self._keep(lambda: check_actions(self._policy, mine, said, _AT_THE_END))
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
    again = np.array(policy.decide(observations.copy()))
    if again.shape != expected.shape:
        raise BrokenWordError(f"decide returned shape {again.shape} when {how}")
    differing = np.nonzero(again != expected)[0]
    if not differing.size:
        return
    at = int(differing[0])
    if differing.size == 1 and _is_between(policy, observations[at], expected[at], again[at]):
        return
    raise BrokenWordError(
        f"decide returned {expected[at]}, and {again[at]} when {how}",
        at if rows is None else int(rows[at]),
    )


def _is_between(policy: Policy, observation: Observations, one: int, other: int) -> bool:
    """Whether observations that hardly differ from this one get both actions."""
    noise = np.random.default_rng(0).uniform(-NEARBY, NEARBY, (ROWS, *observation.shape))
    nearby = (observation * (1 + noise)).astype(observation.dtype)
    return {int(one), int(other)} <= set(np.asarray(policy.decide(nearby)).tolist())


class HeldNetwork(Held, Policy):
    """A network in an ONNX file, which has neither state nor random numbers.

    It could still calculate across its batch, so its values are compared.
    """

    def __init__(self, network: OnnxPolicy, rng: np.random.Generator, calls: int) -> None:
        super().__init__(rng, calls)
        self._network = network
        self.observation, self.decision_hz = network.observation, network.decision_hz

    def decide(self, observations: Observations) -> Actions:
        if not self._is_chosen():
            return self._network.decide(observations)
        values = self._network.values(observations)
        some = self._rng.permutation(len(observations))[:ROWS]
        check_values(self._network, observations[some], values[some], some)
        check_values(self._network, observations[some[:1]], values[some[:1]], some[:1])
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
            f"the network's values differ by {difference[at]:.2g} when {_among(len(rows))}; a "
            "vehicle's values must not depend on the other vehicles in the batch",
            int(rows[at]),
        )


class HeldModel(Held, DriverModel):
    """A driver model of a plugin."""

    def __init__(
        self, model: DriverModel, other: Agent, rng: np.random.Generator, calls: int
    ) -> None:
        super().__init__(rng, calls)
        assert isinstance(other, DriverModel)
        self._model, self._other = model, other
        self.highway_env_class = model.highway_env_class  # type: ignore[misc]  # the model's

    def drive(self, scene: Scene, vehicles: Vehicles) -> tuple[Floats, Ints]:
        if not self._is_chosen():
            return self._model.drive(scene, vehicles)
        before, asked = copied(scene), tuple(map(np.copy, vehicles))
        answer = self._model.drive(scene, vehicles)
        acceleration, lane, timers = np.array(answer[0]), np.array(answer[1]), scene.timer_s.copy()
        _check_scene("drive", scene, before, vehicles, asked)
        if acceleration.shape == lane.shape == asked[0].shape:  # else the simulation says it
            question = SceneQuestion("drive", before, asked, (acceleration, lane, timers[asked]))
            part = question.check_order(_driving(self._model), self._rng)
            self._keep(lambda: part.check(_driving(self._other), _BY_ANOTHER))
            self._keep(lambda: part.check(_driving(self._model), _AT_THE_END))
        return acceleration, lane


def _driving(model: DriverModel) -> Ask:
    """Asks a driver model for accelerations and lanes, and for the timers that it leaves."""

    def ask(scene: Scene, vehicles: Vehicles) -> Answers:
        answer = model.drive(scene, vehicles)
        return np.array(answer[0]), np.array(answer[1]), scene.timer_s[vehicles]

    return ask


class _HeldObservation(Held):
    """An observation of a plugin."""

    def __init__(self, observation: Any, rng: np.random.Generator, calls: int) -> None:
        super().__init__(rng, calls)
        self._observation, self.shape = observation, observation.shape

    def __call__(self, scene: Scene, vehicles: Vehicles) -> Observations:
        if not self._is_chosen():
            return np.asarray(self._observation(scene, vehicles))
        before, asked = copied(scene), tuple(map(np.copy, vehicles))
        seen = np.array(self._observation(scene, vehicles))
        _check_scene("the observation", scene, before, vehicles, asked)

        def ask(scene: Scene, vehicles: Vehicles) -> Answers:
            return (np.array(self._observation(scene, vehicles)),)

        if len(seen) == asked[0].size:  # else the policy cannot answer
            question = SceneQuestion("the observation", before, asked, (seen,))
            question.check_order(ask, self._rng)
        return seen


def _held_observation(like: ObservationLike, rng: np.random.Generator, calls: int) -> Any:
    is_ours = not callable(like) or type(like) in (Neighbours, Kinematics)
    return like if is_ours else _HeldObservation(like, rng, calls)


class HeldTraffic(Held, Traffic):
    """A traffic of a plugin."""

    def __init__(self, traffic: Traffic, other: Traffic, rng: np.random.Generator) -> None:
        super().__init__(rng, ASSIGNMENTS)
        self._traffic, self._other, self.agents = traffic, other, traffic.agents

    def assign(self, rng: np.random.Generator, scenes: int, vehicles: int) -> NDArray[np.str_]:
        if not self._is_chosen():
            return self._traffic.assign(rng, scenes, vehicles)
        before = deepcopy(rng)
        said = np.array(self._traffic.assign(rng, scenes, vehicles))

        def check(traffic: Traffic, how: str) -> None:
            again = np.asarray(traffic.assign(deepcopy(before), scenes, vehicles))
            if not np.array_equal(said, again):
                raise BrokenWordError(f"assign returned other agents when {how}")

        check(self._traffic, "asked again with the same random numbers")
        self._keep(lambda: check(self._other, _BY_ANOTHER))
        self._keep(lambda: check(self._traffic, _AT_THE_END))
        return said


_AT_THE_END = "asked again after the last call"
_BY_ANOTHER = "another instance of it is asked"


def _among(vehicles: int) -> str:
    return f"asked about {vehicles} vehicles in another order"


def _check_scene(
    name: str, scene: Scene, before: Scene, vehicles: Vehicles, asked: Vehicles
) -> None:
    """Checks that a plugin has changed nothing but the timers of its vehicles."""
    if array := changed_array(scene, before, asked):
        raise BrokenWordError(f"{name} changed scene.{array}")
    if not all(map(_equal, vehicles, asked)):
        raise BrokenWordError(f"{name} changed the indices of its vehicles")


def _equal(one: NDArray[Any], other: NDArray[Any]) -> bool:
    return np.array_equal(one, other, equal_nan=one.dtype.kind == "f")
