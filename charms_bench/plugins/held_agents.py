"""Holds agents to their word during a run; see `plugins.held`."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from charms_bench.errors import BrokenWordError
from charms_bench.plugins.agent import Agent, DriverModel, Policy
from charms_bench.plugins.held import Held, check_scene, equal
from charms_bench.plugins.onnx_policy import OnnxPolicy
from charms_bench.plugins.scene_questions import Answers, Ask, SceneQuestion, copied
from charms_bench.world.actions import Actions, problem_of
from charms_bench.world.kinematics_observation import Kinematics
from charms_bench.world.observations import Neighbours, ObservationLike
from charms_bench.world.scene import (
    Bools,
    Floats,
    Ints,
    Observations,
    Scene,
    SceneSettings,
    Vehicles,
)

ROWS = 64
"""Most vehicles that are asked about again in another order."""
ALONE = 3
"""Most vehicles that are asked about alone."""
NETWORK_ROUNDING = 1e-4
"""Largest difference of a network's values between two sizes of a batch, relative to the largest
value: float32 rounds by 6e-8, and a sum of a thousand products may be added in another order. With
batches of 1, 7, 64 and 300, the 21 networks in the package gave the same bits for 168,000
observations from seeds above 900,000,000."""
ACTION_ROUNDING = 1e-4
"""Largest difference of a continuous action, likewise."""
NEARBY = 1e-6
"""Relative changes of an observation that move a network's values about as much as rounding."""


_ALONE = "asked about this vehicle alone"


def hold(
    agent: Agent, other: Agent, settings: SceneSettings, rng: np.random.Generator
) -> "HeldPolicy | HeldNetwork | HeldModel":
    """An agent that is asked again now and then.

    Args:
        agent: The agent.
        other: Another instance of it, made in the same way.
        settings: The scene, which decides how often it is called.
        rng: Chooses the calls.

    Raises:
        BrokenWordError: One is a policy and the other is a driver model.
    """
    if isinstance(agent, DriverModel) and isinstance(other, DriverModel):
        return HeldModel(agent, other, rng, settings.decisions * settings.steps_per_decision)
    if type(agent) is OnnxPolicy:
        return HeldNetwork(agent, rng, settings.decisions)
    if isinstance(agent, Policy) and isinstance(other, Policy):
        return HeldPolicy(agent, other, rng, settings.decisions)
    kinds = f"a {type(agent).__name__} and then a {type(other).__name__}"
    raise BrokenWordError(f"the plugin made {kinds}; expected the same kind of agent each time")


class HeldPolicy(Held[Policy], Policy):
    """A policy of a plugin."""

    def __init__(self, policy: Policy, other: Policy, rng: np.random.Generator, calls: int) -> None:
        super().__init__(policy, other, rng, calls)
        self.observation = _held_observation(policy.observation, rng, calls)
        self.decision_hz, self.actions = policy.decision_hz, policy.actions

    def decide(self, observations: Observations) -> Actions:
        if not self._is_chosen():
            return self.plugin.decide(observations)
        before = observations.copy()
        answer = np.asarray(self.plugin.decide(observations))
        if not equal(observations, before):
            raise BrokenWordError("decide changed its observations")
        if problem_of(answer, self.actions, len(before))[0]:
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
    """Asks a policy and compares its actions.

    One meta-action, and all continuous actions, may differ as far as rounding explains it.

    Args:
        policy: The policy.
        observations: (M, ...) what to ask.
        expected: The actions, (M,) or (M, 2).
        how: In words, how it is asked.
        rows: (M,) the vehicles' indices in the call; by default 0 to M - 1.

    Raises:
        BrokenWordError: An action differs.
    """
    again = np.asarray(policy.decide(observations.copy()))
    if again.shape != expected.shape:
        raise BrokenWordError(f"decide returned shape {again.shape} when {how}")
    differing = np.nonzero(are_different(expected, again))[0]
    if not differing.size:
        return
    at = int(differing[0])
    is_one = differing.size == 1 and expected.ndim == 1
    if is_one and is_between(policy, observations[at], expected[at], again[at]):
        return
    raise BrokenWordError(
        f"decide returned {expected[at]}, and {again[at]} when {how}",
        at if rows is None else int(rows[at]),
    )


def are_different(expected: Actions, again: Actions) -> Bools:
    """(M,) whether two answers differ; continuous ones, by more than rounding explains."""
    if expected.ndim == 1:
        return np.asarray(again != expected)
    return np.asarray(~(np.abs(again - expected) <= ACTION_ROUNDING).all(axis=1))


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
        self.actions = network.actions

    def decide(self, observations: Observations) -> Actions:
        if not self._is_chosen():
            return self.plugin.decide(observations)
        values = self.plugin.values(observations)
        some = _some(len(observations), self._rng)
        for rows in (some, *some[:ALONE, None]):
            check_values(self.plugin, observations[rows], values[rows], rows)
        return self.plugin.actions_of(values)


def check_values(
    network: OnnxPolicy, observations: Observations, expected: NDArray[np.float32], rows: Ints
) -> None:
    """Compares the values (M, outputs) of a network with those for another batch.

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
        self.parameters = model.parameters

    def drive(self, scene: Scene, vehicles: Vehicles) -> tuple[Floats, Ints]:
        if not self._is_chosen():
            return self.plugin.drive(scene, vehicles)
        before, asked = copied(scene), tuple(map(np.copy, vehicles))
        answer = self.plugin.drive(scene, vehicles)
        acceleration, lane, timers = np.asarray(answer[0]), np.asarray(answer[1]), scene.timer_s
        check_scene("drive", scene, before, vehicles, asked, asked)
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
        check_scene("the observation", scene, before, vehicles, asked)

        def ask(scene: Scene, vehicles: Vehicles) -> Answers:
            return (np.array(self.plugin(scene, vehicles)),)

        if len(seen) == asked[0].size:  # else the policy cannot answer
            question = SceneQuestion("the observation", before, asked, (seen,))
            question.check_order(ask, self._rng)
        return seen


def _held_observation(like: ObservationLike, rng: np.random.Generator, calls: int) -> Any:
    is_ours = not callable(like) or type(like) in (Neighbours, Kinematics)
    return like if is_ours else _HeldObservation(like, rng, calls)


def _among(vehicles: int) -> str:
    return f"asked about {vehicles} vehicles in another order"


def _some(vehicles: int, rng: np.random.Generator) -> Ints:
    """Half of the vehicles, or `ROWS` of them, in another order."""
    return rng.permutation(vehicles)[: max(1, min(ROWS, vehicles // 2))]
