"""The contract of agents and traffics as tests: for plugin authors and for `charms-bench check`.

In a plugin's own tests:

    from charms_bench.testing import agent_rules

    @pytest.mark.parametrize("rule", agent_rules(MyPolicy()), ids=lambda rule: rule.__name__)
    def test_contract(rule):
        rule()

A rule raises AssertionError with what was found and what was expected.
"""

import pickle
import time
from collections.abc import Callable
from dataclasses import replace
from functools import partial, update_wrapper
from typing import Any

import numpy as np
from numpy.typing import NDArray

from charms_bench.engine.batched import BatchedEngine
from charms_bench.errors import BrokenWordError, InputError
from charms_bench.plugins.agent import ACCELERATION_LIMIT_MPS2, Agent, DriverModel, Policy
from charms_bench.plugins.held_agents import are_different, check_values, driving, is_between
from charms_bench.plugins.onnx_policy import OnnxPolicy
from charms_bench.plugins.scene_questions import SceneQuestion, copied
from charms_bench.plugins.traffic import Traffic
from charms_bench.world.actions import ACTION_KINDS, ACTIONS, problem_of
from charms_bench.world.observations import observation_of
from charms_bench.world.scene import Observations, Scene, SceneSettings, Vehicles

Rule = Callable[[], None]
_SCENES = 16
_NOT_SEATED = 2
"""The index of an agent that drives no vehicle."""
_WRITABLE = {"timer_s"}
SLOW_MS = 3.0
"""Longest time per decision of a vehicle, among many; networks of 256-256 units take 0.002."""


def example_scene(seed: int = 0, model: DriverModel | None = None) -> Scene:
    """16 scenes of 21 vehicles in motion; some vehicles are changing lanes, a few have crashed.

    All vehicles have drawn parameters of the model.
    """
    settings = SceneSettings(density=2.0)
    engine = BatchedEngine(settings, _SCENES, {} if model is None else {_NOT_SEATED: model})
    rows = np.arange(_SCENES)
    traffic = np.ones((_SCENES, settings.traffic_vehicles), dtype=np.int64)
    engine.reset(rows, rows.astype(np.uint64) + np.uint64(seed), traffic)
    rng = np.random.default_rng(seed)
    everyone = _everyone(engine.scene)
    for _ in range(4):
        engine.command(everyone, rng.integers(0, len(ACTIONS), everyone[0].size))
        for _ in range(5):
            engine.advance()
    if model is not None and model.parameters:
        low, high = np.array([*model.parameters.values()]).T
        engine.scene.parameters[:] = rng.uniform(low, high, engine.scene.parameters.shape)
    return engine.scene


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
    """Every rule that a traffic has to keep, ready to be called."""
    return [_bound(traffic_assigns_its_agents, traffic), _bound(traffic_follows_its_rng, traffic)]


def _bound(rule: Callable[..., None], subject: Any) -> Rule:
    return update_wrapper(partial(rule, subject), rule)


def policy_names_an_observation_and_a_rate(policy: Policy) -> None:
    """Its `observation` and its kind of `actions` exist, and its `decision_hz` is positive."""
    try:
        observation_of(policy.observation)
    except InputError as error:
        raise AssertionError(str(error)) from error
    _require(policy.decision_hz > 0, f"decision_hz is {policy.decision_hz}")
    kinds = " or ".join(ACTION_KINDS)
    _require(policy.actions in ACTION_KINDS, f"actions is {policy.actions!r}; expected {kinds}")


def policy_returns_one_action_per_vehicle(policy: Policy) -> None:
    """`decide` returns one action of its kind per row, for many rows and for one.

    A meta-action is an integer 0..4, a continuous action two floats from -1 to 1.
    """
    observations = _observations(policy)
    for rows in (observations, observations[:1]):
        what, row = problem_of(np.asarray(policy.decide(rows)), policy.actions, len(rows))
        _require(not what, f"for row {row} of {len(rows)}, decide returned {what}")


def policy_decides_for_each_vehicle_independently(policy: Policy) -> None:
    """A vehicle's action does not depend on the other vehicles, their number or their order.

    Continuous actions may differ by rounding.
    """
    observations = _observations(policy)
    together = np.array(policy.decide(observations.copy()))
    order = np.random.default_rng(0).permutation(len(observations))
    for size in (1, 7, order.size):
        batches = [order[start : start + size] for start in range(0, order.size, size)]
        if type(policy) is OnnxPolicy:
            values = policy.values(observations)
            for rows in batches:
                _kept(check_values, policy, observations[rows], values[rows], rows)
            continue
        found = np.concatenate([policy.decide(observations[rows].copy()) for rows in batches])
        differ = are_different(together[order], found)
        at = order[differ]
        is_one = at.size == 1 and together.ndim == 1
        actions = (*together[at], *found[differ])
        explained = is_one and is_between(policy, observations[at[0]], *actions)
        what = f"{at.size} of {order.size} actions differ"
        _require(not at.size or explained, f"{what} in batches of {size} in another order")


def policy_does_not_change_its_observations(policy: Policy) -> None:
    """`decide` does not write to its observations."""
    observations = _observations(policy)
    before = observations.copy()
    policy.decide(observations)
    _require((observations == before).all(), "decide changed its observations")


def model_returns_one_acceleration_and_lane_per_vehicle(model: DriverModel) -> None:
    """`drive` returns possible accelerations and lanes of the road, one of each per vehicle."""
    scene = example_scene(model=model)
    for vehicles in (_everyone(scene), (np.array([0]), np.array([3]))):
        acceleration, lane = map(np.asarray, model.drive(scene, vehicles))
        shapes = (acceleration.shape, lane.shape)
        _require(shapes == (vehicles[0].shape,) * 2, f"shapes {shapes} for {vehicles[0].shape}")
        wrong = acceleration[~(np.abs(acceleration) <= ACCELERATION_LIMIT_MPS2)]
        expected = f"expected at most {ACCELERATION_LIMIT_MPS2:g} m/s² either way"
        if wrong.size:
            raise AssertionError(f"acceleration {wrong[0]}; {expected}")
        _check_integers("lane", lane, scene.constants.lanes)


def model_drives_each_scene_independently(model: DriverModel) -> None:
    """What happens in one scene does not depend on the others, their number or their order."""
    scene = example_scene(model=model)
    asked = SceneQuestion("drive", scene, _everyone(scene), ())
    said = driving(model)(asked.part(None)[0].scene.read_only(), asked.vehicles)
    order = np.random.default_rng(0).permutation(_SCENES)
    for size in (1, 5, _SCENES):
        rows, how = order[:size], f"shown {size} of {_SCENES} scenes in another order"
        _kept(replace(asked, said=said).check, driving(model), how, rows)


def model_does_not_change_the_scene(model: DriverModel) -> None:
    """`drive` writes to `timer_s` only."""
    scene, before = example_scene(model=model), example_scene(model=model)
    model.drive(scene, _everyone(scene))
    for name in set(Scene._fields) - _WRITABLE - {"constants"}:
        same = np.array_equal(getattr(scene, name), getattr(before, name))
        _require(same, f"drive changed scene.{name}")


def agent_is_deterministic(agent: Agent) -> None:
    """Asked again about the same observations or scenes, after others, it answers the same."""
    ask, others = _asked(agent), _asked(agent, seed=1)
    first = ask()
    differing = (ask() != first).sum()
    _require(not differing, f"{differing} answers differ between two calls")
    for _ in range(20):
        others()
    differing = (ask() != first).sum()
    _require(not differing, f"{differing} answers differ after 20 other calls")


def agent_answers_the_same_in_another_process(agent: Agent) -> None:
    """The agent can be pickled, and the copy answers the same."""
    try:
        copy = pickle.loads(pickle.dumps(agent))
    except Exception as error:  # whatever a class does wrong
        raise AssertionError(f"cannot be pickled: {type(error).__name__}: {error}") from error
    same = _asked(agent)() == _asked(copy)()
    _require(same.all(), f"{(~same).sum()} answers differ after pickling")


def agent_answers_in_time(agent: Agent) -> None:
    """Asked about many vehicles, it takes at most 3 ms per vehicle; the best of three times."""
    ask = _asked(agent)
    took = []
    for _ in range(3):
        start = time.perf_counter()
        answers = ask()
        took.append((time.perf_counter() - start) * 1e3 / answers.shape[-1])
    took_ms = min(took)
    _require(took_ms <= SLOW_MS, f"takes {took_ms:.1f} ms per vehicle; expected <= {SLOW_MS} ms")


def traffic_assigns_its_agents(traffic: Traffic) -> None:
    """`assign` returns names from `agents`, one per vehicle of each scene."""
    names = np.asarray(traffic.assign(np.random.default_rng(0), 50, 20))
    _require(names.shape == (50, 20), f"shape {names.shape}, expected (50, 20)")
    unknown = set(names.ravel().tolist()) - set(traffic.agents)
    _require(not unknown, f"assigned {sorted(unknown)}, which `agents` does not list")


def traffic_follows_its_rng(traffic: Traffic) -> None:
    """The same generator gives the same assignment."""
    first, second = (traffic.assign(np.random.default_rng(1), 50, 20) for _ in range(2))
    same = (np.asarray(first) == np.asarray(second)).all()
    _require(same, "two generators with the same seed give different assignments")


def _require(is_kept: object, problem: str) -> None:
    """Raises the error of a broken rule; Python drops `assert` when it optimises."""
    if not is_kept:
        raise AssertionError(problem)


def _check_integers(what: str, values: NDArray[Any], count: int) -> None:
    _require(np.issubdtype(values.dtype, np.integer), f"{what}s are {values.dtype}")
    for value in (values.min(), values.max()):
        _require(0 <= value < count, f"{what} {value}; expected 0 to {count - 1}")


def _kept(check: Callable[..., None], *arguments: Any) -> None:
    """Checks a rule that runs check, too."""
    try:
        check(*arguments)
    except BrokenWordError as error:
        raise AssertionError(str(error)) from error


def _observations(policy: Policy, seed: int = 0) -> Observations:
    scene = example_scene(seed)
    return observation_of(policy.observation)(scene, _everyone(scene))


def _asked(agent: Agent, seed: int = 0) -> Callable[[], NDArray[Any]]:
    """Asks an agent about every vehicle of the example scenes."""
    if isinstance(agent, Policy):
        observations = _observations(agent, seed)
        return lambda: np.array(agent.decide(observations.copy())).T
    scene = example_scene(seed, agent)
    return lambda: _answer(agent, copied(scene), _everyone(scene))


def _everyone(scene: Scene) -> Vehicles:
    rows, places = np.nonzero(np.ones(scene.x.shape, dtype=np.bool_))
    return rows, places


def _answer(model: DriverModel, scene: Scene, vehicles: Vehicles) -> NDArray[np.float64]:
    acceleration, lane = model.drive(scene, vehicles)
    driven = ~scene.crashed[vehicles]  # the answer for a wreck is ignored
    return np.where(driven, np.stack([acceleration, lane]), 0.0)
