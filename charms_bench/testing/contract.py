"""The contract of agents and traffic models as tests, for plugin authors and `charms-bench check`.

In a plugin's own tests:

    from charms_bench.testing import agent_rules

    @pytest.mark.parametrize("rule", agent_rules(MyPolicy()), ids=lambda rule: rule.__name__)
    def test_contract(rule):
        rule()

A rule raises AssertionError with what was found and what was expected.
"""

import pickle
import time
from collections.abc import Callable, Collection
from contextlib import suppress
from functools import partial, update_wrapper
from typing import Any

import numpy as np
from numpy.typing import NDArray

from charms_bench.engine.rollouts import Futures
from charms_bench.engine.simulation import Simulation
from charms_bench.errors import BrokenWordError, InputError
from charms_bench.plugins.agent import ACCELERATION_LIMIT_MPS2, Agent, DriverModel, Policy
from charms_bench.plugins.consistency import Call, PolicyCall, SceneCall, called, copied, driving
from charms_bench.plugins.deciding import (
    Asked,
    Question,
    answer_of,
    check_declared,
    decide,
    kept_width,
    part_of,
    question_of,
)
from charms_bench.plugins.traffic import Traffic, assigned
from charms_bench.world.actions import ACTIONS, problem_of
from charms_bench.world.highway_env_observation import HighwayEnv, any_observations
from charms_bench.world.observations import observation_of
from charms_bench.world.scene import Ints, Scene, SceneSettings, Vehicles

Rule = Callable[[], None]
_SCENES = 16
SLOW_MS = 3.0
"""Longest time per decision of a vehicle, among many; networks of 256-256 units take 0.002."""


class _Nobody(Traffic):
    """Drives no vehicle; the agent `example` is known, but drives none either."""

    def __init__(self, agents: Collection[str]) -> None:
        self.agents = ("", *agents)

    def assign(self, rng: np.random.Generator, scenes: int, vehicles: int) -> NDArray[np.str_]:
        return np.full((scenes, vehicles), "")


def example(seed: int = 0, model: DriverModel | None = None) -> Simulation:
    """16 scenes of 21 vehicles in motion; some vehicles are changing lanes, a few have crashed.

    All vehicles have drawn parameters of the model.
    """
    known = {} if model is None else {"example": model}
    simulation = Simulation(SceneSettings(density=2.0), _SCENES, None, _Nobody(known), known)
    simulation.reset(np.arange(_SCENES, dtype=np.uint64) + np.uint64(seed))
    rng, engine = np.random.default_rng(seed), simulation.engine
    everyone = _everyone(engine.scene)
    for _ in range(4):
        engine.command(everyone, rng.integers(0, len(ACTIONS), everyone[0].size))
        for _ in range(5):
            engine.advance()
    if model is not None and model.parameters:
        low, high = np.array([*model.parameters.values()]).T
        engine.scene.parameters[:] = rng.uniform(low, high, engine.scene.parameters.shape)
    return simulation


def example_scene(seed: int = 0, model: DriverModel | None = None) -> Scene:
    """The scenes of `example`."""
    return example(seed, model).scene


def agent_rules(agent: Agent) -> list[Rule]:
    """Every rule that an agent has to keep, ready to be called."""
    own: tuple[Callable[..., None], ...] = (
        model_returns_one_acceleration_and_lane_per_vehicle,
        model_drives_each_scene_independently,
        model_does_not_change_the_scene,
    )
    if isinstance(agent, Policy):
        own = (
            policy_names_an_observation_and_a_rate,
            policy_returns_one_action_per_vehicle,
            policy_decides_for_each_vehicle_independently,
            policy_does_not_change_its_observations,
        )
    rules = (
        *own,
        agent_is_deterministic,
        agent_answers_the_same_in_another_process,
        agent_answers_in_time,
    )
    return [_bound(rule, agent) for rule in rules]


def traffic_rules(traffic: Traffic) -> list[Rule]:
    """Every rule that a traffic model has to keep, ready to be called."""
    return [_bound(traffic_assigns_its_agents, traffic), _bound(traffic_follows_its_rng, traffic)]


def _bound(rule: Callable[..., None], subject: Any) -> Rule:
    return update_wrapper(partial(rule, subject), rule)


def policy_names_an_observation_and_a_rate(policy: Policy) -> None:
    """Its `observation`, its kind of `actions` and its widths are possible, its rate positive."""
    try:
        check_declared(policy)
    except InputError as error:
        raise AssertionError(str(error)) from error
    _require(policy.decision_hz > 0, f"decision_hz is {policy.decision_hz}")


def policy_returns_one_action_per_vehicle(policy: Policy) -> None:
    """`decide` returns one action of its kind per row, for many rows and for one.

    A meta-action is an index into `actions`, a continuous action two floats from -1 to 1. With
    memory, it also returns the new memory, which is finite.
    """
    asked = _question(policy)
    for rows in (np.arange(len(asked[0])), np.array([0])):
        part = part_of(asked, rows)
        actions, _ = _kept(answer_of, policy, part, policy.decide(*part))
        what, row = problem_of(actions, policy.actions, rows.size)
        _require(not what, f"for row {row} of {rows.size}, decide returned {what}")


def policy_decides_for_each_vehicle_independently(policy: Policy) -> None:
    """A vehicle's answer does not depend on the other vehicles, their number or their order.

    Continuous actions and memory may differ by rounding.
    """
    call, everyone = _call(policy)
    order = np.random.default_rng(0).permutation(everyone)
    for size in (1, 7, order.size):
        for start in range(0, order.size, size):
            how = f"asked in batches of {size} in another order"
            _kept(call.check, policy, order[start : start + size], how)


def policy_does_not_change_its_observations(policy: Policy) -> None:
    """`decide` does not write to its observations."""
    asked = _question(policy)
    shown = part_of(asked, np.arange(len(asked[0])))
    policy.decide(*shown)
    _require(np.array_equal(asked[0], shown[0]), "decide changed its observations")


def model_returns_one_acceleration_and_lane_per_vehicle(model: DriverModel) -> None:
    """`drive` returns possible accelerations and lanes of the road, one of each per vehicle."""
    scene = example_scene(model=model).read_only()
    for vehicles in (_everyone(scene), (np.array([0]), np.array([3]))):
        acceleration, lane = map(np.asarray, model.drive(scene, vehicles))
        shapes = (acceleration.shape, lane.shape)
        _require(shapes == (vehicles[0].shape,) * 2, f"shapes {shapes} for {vehicles[0].shape}")
        wrong = acceleration[~(np.abs(acceleration) <= ACCELERATION_LIMIT_MPS2)]
        expected = f"expected at most {ACCELERATION_LIMIT_MPS2:g} m/s² either way"
        if wrong.size:
            raise AssertionError(f"acceleration {wrong[0]}; {expected}")
        lanes = scene.road.lanes
        _require(np.issubdtype(lane.dtype, np.integer), f"lanes are {lane.dtype}")
        for value in (lane.min(), lane.max()):
            _require(0 <= value < lanes, f"lane {value}; expected 0 to {lanes - 1}")


def model_drives_each_scene_independently(model: DriverModel) -> None:
    """What happens in one scene does not depend on the others, their number or their order."""
    call, scenes = _call(model)
    order = np.random.default_rng(0).permutation(scenes)
    for size in (1, 5, _SCENES):
        how = f"shown {size} of {_SCENES} scenes in another order"
        _kept(call.check, model, order[:size], how)


def model_does_not_change_the_scene(model: DriverModel) -> None:
    """`drive` writes to `timer_s` and `memory` only."""
    scene = example_scene(model=model).read_only()
    try:
        _kept(called, "drive", driving, model, scene, _everyone(scene), True)
    except ValueError as error:
        raise AssertionError(f"drive changed the scene: {error}") from error


def agent_is_deterministic(agent: Agent) -> None:
    """Asked again about the same observations or scenes, after others, it answers the same."""
    (call, everyone), (other, others) = _call(agent), _call(agent, seed=1)
    _kept(call.check, agent, everyone, "asked again", True)
    for _ in range(20):
        _kept(other.check, agent, others, "asked again", True)
    _kept(call.check, agent, everyone, "asked again after 20 other calls", True)


def agent_answers_the_same_in_another_process(agent: Agent) -> None:
    """The agent can be pickled, and the copy answers the same."""
    try:
        copy = pickle.loads(pickle.dumps(agent))
    except Exception as error:  # whatever a class does wrong
        raise AssertionError(f"cannot be pickled: {type(error).__name__}: {error}") from error
    call, everyone = _call(agent)
    _kept(call.check, copy, everyone, "asked after pickling", True)


def agent_answers_in_time(agent: Agent) -> None:
    """Asked about many vehicles, it takes at most 3 ms per vehicle, the best of five times."""
    call, everyone = _call(agent)
    vehicles, took_ms = example_scene().x.size, np.inf
    for _ in range(5):
        if took_ms <= SLOW_MS:
            return
        start = time.perf_counter()
        with suppress(BrokenWordError):  # another rule says it
            call.check(agent, everyone, "asked again", True)
        took_ms = min(took_ms, (time.perf_counter() - start) * 1e3 / vehicles)
    _require(took_ms <= SLOW_MS, f"takes {took_ms:z.1f} ms per vehicle; expected <= {SLOW_MS} ms")


def traffic_assigns_its_agents(traffic: Traffic) -> None:
    """`assign` returns names from `agents`, one per vehicle of each scene."""
    _kept(assigned, traffic, np.random.default_rng(0), 50, 20)


def traffic_follows_its_rng(traffic: Traffic) -> None:
    """The same generator gives the same assignment."""
    first, second = (traffic.assign(np.random.default_rng(1), 50, 20) for _ in range(2))
    same = (np.asarray(first) == np.asarray(second)).all()
    _require(same, "two generators with the same seed give different assignments")


def _require(is_kept: object, problem: str) -> None:
    """Raises the error of a broken rule; Python drops `assert` when it optimises."""
    if not is_kept:
        raise AssertionError(problem)


def _kept(check: Callable[..., Any], *arguments: Any) -> Any:
    """Checks a rule that runs check, too."""
    try:
        return check(*arguments)
    except BrokenWordError as error:
        raise AssertionError(str(error)) from error


def _question(policy: Policy, seed: int = 0) -> Question:
    """What a policy is asked about every vehicle of the example, with memory of one decision."""
    simulation, like = example(seed), observation_of(policy.observation)
    everyone = _everyone(simulation.scene)
    vehicles = everyone[0].size
    asked = Asked(
        any_observations(like.shape, vehicles, seed)
        if isinstance(like, HighwayEnv)
        else like(simulation.scene, everyone),
        np.zeros((vehicles, kept_width(policy))),
        np.random.default_rng(seed).random((vehicles, policy.noise_draws)),
        Futures(simulation, policy).of(everyone) if policy.rollouts_with else None,
    )
    _, kept = _kept(decide, policy, asked) if kept_width(policy) else (None, asked.kept)
    return question_of(policy, asked._replace(kept=kept))


def _call(agent: Agent, seed: int = 0) -> tuple[Call, Ints]:
    """A call about every vehicle of the example scenes, and the rows that it can be checked by."""
    if isinstance(agent, Policy):
        asked = _question(agent, seed)
        everyone = np.arange(len(asked[0]))
        actions, memory = answer_of(agent, asked, agent.decide(*part_of(asked, everyone)))
        return PolicyCall(asked, np.array(actions), np.array(memory)), everyone
    scene = example_scene(seed, agent)
    said = map(np.array, driving(agent, copied(scene).read_only(), _everyone(scene)))
    return SceneCall("drive", driving, scene, _everyone(scene), [*said]), np.arange(_SCENES)


def _everyone(scene: Scene) -> Vehicles:
    rows, places = np.nonzero(np.ones(scene.x.shape, dtype=np.bool_))
    return rows, places
