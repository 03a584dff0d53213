"""Holds agents to their word during a run; see `plugins.held`."""

from typing import Any

import numpy as np

from charms_bench.errors import BrokenWordError
from charms_bench.plugins.agent import Agent, DriverModel, Policy
from charms_bench.plugins.deciding import Question, answer_of, part_of
from charms_bench.plugins.held import AGAIN, TIMES, Held
from charms_bench.plugins.scene_questions import Answers, halved, some_of
from charms_bench.world.actions import Actions, problem_of
from charms_bench.world.kinematics_observation import Kinematics
from charms_bench.world.observations import Neighbours, ObservationLike
from charms_bench.world.scene import (
    WRITABLE,
    Bools,
    Floats,
    Ints,
    Observations,
    Scene,
    SceneSettings,
    Vehicles,
)

ROUNDING = 1e-4
"""Largest difference of a continuous action or of what a policy remembers between two sizes of a
batch, and of a network's values relative to the largest: float32 rounds by 6e-8, and a sum of a
thousand products may be added in another order. With batches of 1, 7, 64 and 300, the 21 networks
in the package gave the same bits for 168,000 observations from seeds above 900,000,000."""
NEARBY = 1e-6
"""Relative changes of an observation that move a network's values about as much as rounding."""
_DECLARED = (
    "decision_hz", "actions", "history_length", "memory_width", "noise_draws", "rollouts_with",
)  # fmt: skip
VARIANTS = 64


def hold(
    agent: Agent, other: Agent, settings: SceneSettings, rng: np.random.Generator
) -> "HeldPolicy | HeldModel":
    """An agent of which one call is asked again; see `Held`.

    Raises a `BrokenWordError` if one is a policy and the other is a driver model.
    """
    if isinstance(agent, DriverModel) and isinstance(other, DriverModel):
        return HeldModel(agent, other, rng, settings.decisions * settings.steps_per_decision)
    if isinstance(agent, Policy) and isinstance(other, Policy):
        return HeldPolicy(agent, other, rng, settings.decisions)
    kinds = f"a {type(agent).__name__} and then a {type(other).__name__}"
    raise BrokenWordError(f"the plugin made {kinds}; expected the same kind of agent each time")


class HeldPolicy(Held[Policy], Policy):
    """A policy of a plugin, or a network."""

    def __init__(self, policy: Policy, other: Policy, rng: np.random.Generator, calls: int) -> None:
        super().__init__(policy, other, rng, calls)
        self.observation = _held_observation(policy.observation, rng, calls)
        for name in _DECLARED:
            setattr(self, name, getattr(policy, name))

    def decide(self, observations: Observations, *given: Any) -> Any:
        if not self._is_chosen():
            return self.plugin.decide(observations, *given)
        asked = (observations, *given)
        names = ("observations", "memory", "noise")
        before = [np.array(each) for each in asked[: len(names)]]
        answer = self.plugin.decide(observations, *given)
        for name, was, now in zip(names, before, asked, strict=False):
            if not np.array_equal(was, now, equal_nan=True):
                raise BrokenWordError(f"decide changed its {name}")
        actions, memory = answer_of(self, asked, answer)
        if problem_of(actions, self.actions, len(observations))[0]:
            return answer  # the simulation says what is wrong
        some = some_of(np.arange(len(observations)), self._rng)
        part, said = part_of(asked, some), (actions[some], memory[some])

        def question(policy: Policy, halvings: int) -> None:
            fewer = halved(some.size, halvings)
            expected = said[0][fewer], said[1][fewer]
            check_decisions(policy, part_of(part, fewer), expected, AGAIN, some[fewer])

        if self.rollouts_with:
            question(self._other, 0)  # now: a planner looks ahead from the scene as it is
        else:
            self._question = question
        return answer


def check_decisions(
    policy: Policy, asked: Question, expected: tuple[Actions, Floats], how: str, rows: Ints
) -> None:
    """Asks a policy and raises a `BrokenWordError` if an answer differs.

    One meta-action, and all continuous actions and memory, may differ as far as rounding explains
    it.

    Args:
        asked: What it is asked about M vehicles.
        expected: The actions, (M,) or (M, 2), and the memory (M, Q).
        how: In words, how it is asked.
        rows: (M,) the vehicles' indices in the call.
    """
    actions, memory = expected
    everyone = np.arange(len(actions))
    again, kept = answer_of(policy, asked, policy.decide(*part_of(asked, everyone)))
    if again.shape != actions.shape:
        raise BrokenWordError(f"decide returned shape {again.shape} when {how}")
    differing = np.nonzero(are_different(actions, again))[0]
    if differing.size:
        at = int(differing[0])
        one = part_of(asked, np.array([at]))
        is_one = differing.size == 1 and actions.ndim == 1
        if not (is_one and is_between(policy, one, actions[at], again[at])):
            what = f"decide returned {actions[at]}, and {again[at]} when {how}"
            raise BrokenWordError(what, int(rows[at]))
    if not policy.memory_width:
        return
    same = np.isclose(kept, memory, ROUNDING, ROUNDING).all(axis=1)
    if not same.all():
        raise BrokenWordError(f"decide returned other memory when {how}", int(rows[same.argmin()]))


def are_different(expected: Actions, again: Actions) -> Bools:
    """(M,) whether two answers differ; continuous ones, by more than rounding explains."""
    if expected.ndim == 1:
        return np.asarray(again != expected)
    return np.asarray(~(np.abs(again - expected) <= ROUNDING).all(axis=1))


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


class HeldModel(Held[DriverModel], DriverModel):
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
        acceleration, lane, *_ = self._answers("drive", driving, scene, vehicles, writes=True)
        return acceleration, lane


def driving(model: DriverModel, scene: Scene, vehicles: Vehicles) -> Answers:
    """The accelerations and lanes that a driver model returns, and what it writes."""
    own = tuple(map(np.copy, vehicles))  # which the model could change
    acceleration, lane = model.drive(scene, vehicles)
    written = (getattr(scene, name)[own] for name in WRITABLE)
    return np.asarray(acceleration), np.asarray(lane), *written


class _HeldObservation(Held[Any]):
    """An observation of a plugin, which is asked again at once."""

    again = "asked in another order"

    def __init__(self, observation: Any, rng: np.random.Generator, calls: int) -> None:
        super().__init__(observation, observation, rng, calls)
        self.shape = observation.shape

    def __call__(self, scene: Scene, vehicles: Vehicles) -> Observations:
        if not self._is_chosen():
            return np.asarray(self.plugin(scene, vehicles))
        (seen,) = self._answers("the observation", lambda it, *of: (it(*of),), scene, vehicles)
        if self._question is not None:
            self._question(self.plugin, 0)
        return seen


def _held_observation(like: ObservationLike, rng: np.random.Generator, calls: int) -> Any:
    is_ours = not callable(like) or type(like) in (Neighbours, Kinematics)
    return like if is_ours else _HeldObservation(like, rng, calls)
