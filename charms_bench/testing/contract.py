"""The contract of agents and traffics as tests: for plugin authors, and for `charms-bench check`.

In a plugin's own tests:

    from charms_bench.testing.contract import agent_rules

    @pytest.mark.parametrize("rule", agent_rules(MyPolicy()), ids=lambda rule: rule.__name__)
    def test_contract(rule):
        rule()

A rule raises AssertionError with what was found and what was expected.
"""

import pickle
import time
from collections.abc import Callable
from functools import partial, update_wrapper
from typing import Any

import numpy as np
from numpy.typing import NDArray

from charms_bench.engine.batched import BatchedEngine
from charms_bench.errors import InputError
from charms_bench.plugins.agent import Agent, DriverModel, Policy
from charms_bench.plugins.traffic import Traffic
from charms_bench.world.actions import ACTIONS
from charms_bench.world.observations import observation_of
from charms_bench.world.scene import Observations, Scene, SceneSettings, Vehicles

Rule = Callable[[], None]
_SCENES = 16
_WRITABLE = {"timer_s"}
SLOW_MS = 3.0
"""A vehicle's decision that takes longer, among many; networks of 256-256 units take 0.002."""


def example_scene(seed: int = 0) -> Scene:
    """16 scenes of 21 vehicles in motion, some of them changing lanes and a few crashed."""
    settings = SceneSettings(density=2.0)
    engine = BatchedEngine(settings, _SCENES, {})
    rows = np.arange(_SCENES)
    others = np.ones((_SCENES, settings.traffic_vehicles), dtype=np.int64)
    engine.reset(rows, rows.astype(np.uint64) + np.uint64(seed), others)
    rng = np.random.default_rng(seed)
    everyone = np.nonzero(engine.scene.x)
    for _ in range(4):
        engine.command(everyone, rng.integers(0, len(ACTIONS), everyone[0].size))
        for _ in range(5):
            engine.advance()
    return engine.scene


def agent_rules(agent: Agent) -> list[Rule]:
    """Every rule an agent has to keep, ready to be called."""
    if isinstance(agent, Policy):
        rules: list[Callable[..., None]] = [
            policy_names_an_observation_and_a_rate,
            policy_returns_an_action_a_vehicle,
            policy_decides_for_each_vehicle_alone,
            policy_decides_the_same_again,
            policy_leaves_its_observations_alone,
        ]
    else:
        rules = [
            model_returns_an_acceleration_and_a_lane_a_vehicle,
            model_drives_each_scene_alone,
            model_drives_the_same_again,
            model_leaves_the_scene_alone,
        ]
    rules += [agent_answers_the_same_in_another_process, agent_answers_in_time]
    return [_bound(rule, agent) for rule in rules]


def traffic_rules(traffic: Traffic) -> list[Rule]:
    """Every rule a traffic has to keep, ready to be called."""
    return [_bound(traffic_assigns_its_agents, traffic), _bound(traffic_follows_its_rng, traffic)]


def _bound(rule: Callable[..., None], subject: Any) -> Rule:
    return update_wrapper(partial(rule, subject), rule)


def policy_names_an_observation_and_a_rate(policy: Policy) -> None:
    """Its `observation` exists and its `decision_hz` is positive."""
    try:
        observation_of(policy.observation)
    except InputError as error:
        raise AssertionError(str(error)) from error
    assert policy.decision_hz > 0, f"decision_hz is {policy.decision_hz}"


def policy_returns_an_action_a_vehicle(policy: Policy) -> None:
    """`decide` returns integers 0..4, one a row, for many rows and for one."""
    observations = _observations(policy)
    for rows in (observations, observations[:1]):
        actions = np.asarray(policy.decide(rows))
        assert actions.shape == (len(rows),), f"shape {actions.shape} for {len(rows)} vehicles"
        assert np.issubdtype(actions.dtype, np.integer), f"actions are {actions.dtype}"
        found = (actions.min(), actions.max())
        assert found[0] >= 0, f"action {found[0]}"
        assert found[1] < len(ACTIONS), f"action {found[1]}"


def policy_decides_for_each_vehicle_alone(policy: Policy) -> None:
    """A vehicle's action does not depend on who else is in the batch."""
    observations = _observations(policy)
    together = np.asarray(policy.decide(observations))
    alone = [int(np.asarray(policy.decide(row[None]))[0]) for row in observations]
    differing = int((together != alone).sum())
    assert not differing, f"{differing} of {len(alone)} vehicles decide otherwise when alone"


def policy_decides_the_same_again(policy: Policy) -> None:
    """Two calls with the same observations give the same actions."""
    observations = _observations(policy)
    first, second = (np.array(policy.decide(observations.copy())) for _ in range(2))
    assert (first == second).all(), f"{(first != second).sum()} actions changed"


def policy_leaves_its_observations_alone(policy: Policy) -> None:
    """`decide` does not write to what it is given."""
    observations = _observations(policy)
    before = observations.copy()
    policy.decide(observations)
    assert (observations == before).all(), "decide changed its observations"


def model_returns_an_acceleration_and_a_lane_a_vehicle(model: DriverModel) -> None:
    """`drive` returns finite accelerations and lanes of the road, one each a vehicle."""
    scene = example_scene()
    for vehicles in (_everyone(scene), (np.array([0]), np.array([3]))):
        acceleration, lane = map(np.asarray, model.drive(scene, vehicles))
        shapes = (acceleration.shape, lane.shape)
        assert shapes == (vehicles[0].shape,) * 2, f"shapes {shapes} for {vehicles[0].shape}"
        assert np.isfinite(acceleration).all(), "some accelerations are not finite"
        assert np.issubdtype(lane.dtype, np.integer), f"lanes are {lane.dtype}"
        found = (lane.min(), lane.max())
        assert found[0] >= 0, f"lane {found[0]}"
        assert found[1] < scene.constants.lanes, f"lane {found[1]} of {scene.constants.lanes}"


def model_drives_each_scene_alone(model: DriverModel) -> None:
    """What happens in one scene does not depend on the scenes beside it."""
    scene = example_scene()
    rows, places = _everyone(scene)
    together = _answer(model, example_scene(), (rows, places))
    for row in range(0, _SCENES, 5):
        alone = _answer(model, example_scene(), (rows[rows == row], places[rows == row]))
        assert (alone == together[:, rows == row]).all(), f"scene {row} is driven otherwise alone"


def model_drives_the_same_again(model: DriverModel) -> None:
    """The same scene is driven the same way twice."""
    vehicles = _everyone(example_scene())
    first, second = (_answer(model, example_scene(), vehicles) for _ in range(2))
    assert (first == second).all(), "two calls on the same scene differ"


def model_leaves_the_scene_alone(model: DriverModel) -> None:
    """`drive` writes to nothing but `timer_s`."""
    scene, before = example_scene(), example_scene()
    model.drive(scene, _everyone(scene))
    for name in set(Scene._fields) - _WRITABLE - {"constants"}:
        same = np.array_equal(getattr(scene, name), getattr(before, name))
        assert same, f"drive changed scene.{name}"


def agent_answers_the_same_in_another_process(agent: Agent) -> None:
    """It can be pickled, and what comes of that answers the same."""
    try:
        copy = pickle.loads(pickle.dumps(agent))
    except Exception as error:  # whatever a class does wrong
        raise AssertionError(f"cannot be pickled: {type(error).__name__}: {error}") from error
    same = _asked(agent)() == _asked(copy)()
    assert same.all(), f"{(~same).sum()} answers differ once it has been pickled"


def agent_answers_in_time(agent: Agent) -> None:
    """Asked about many vehicles, it takes at most 3 ms a vehicle; the best of three times."""
    ask = _asked(agent)
    took = []
    for _ in range(3):
        start = time.perf_counter()
        answers = ask()
        took.append((time.perf_counter() - start) * 1e3 / answers.shape[-1])
    assert min(took) <= SLOW_MS, f"takes {min(took):.1f} ms a vehicle; expected {SLOW_MS} at most"


def traffic_assigns_its_agents(traffic: Traffic) -> None:
    """`assign` returns names of `agents`, one a vehicle of each scene."""
    names = np.asarray(traffic.assign(np.random.default_rng(0), 50, 20))
    assert names.shape == (50, 20), f"shape {names.shape}, expected (50, 20)"
    unknown = set(names.ravel().tolist()) - set(traffic.agents)
    assert not unknown, f"assigned {sorted(unknown)}, which `agents` does not list"


def traffic_follows_its_rng(traffic: Traffic) -> None:
    """The same generator gives the same assignment."""
    first, second = (traffic.assign(np.random.default_rng(1), 50, 20) for _ in range(2))
    assert (np.asarray(first) == np.asarray(second)).all(), "two equal generators differ"


def _observations(policy: Policy) -> Observations:
    scene = example_scene()
    return observation_of(policy.observation)(scene, _everyone(scene))


def _asked(agent: Agent) -> Callable[[], NDArray[Any]]:
    """Asks an agent about every vehicle of the example scenes."""
    if isinstance(agent, Policy):
        observations = _observations(agent)
        return lambda: np.array(agent.decide(observations.copy()))
    scene = example_scene()
    return lambda: _answer(agent, scene, _everyone(scene))


def _everyone(scene: Scene) -> Vehicles:
    rows, places = np.nonzero(np.ones(scene.x.shape, dtype=np.bool_))
    return rows, places


def _answer(model: DriverModel, scene: Scene, vehicles: Vehicles) -> NDArray[np.float64]:
    acceleration, lane = model.drive(scene, vehicles)
    driven = ~scene.crashed[vehicles]  # what is answered for a wreck is ignored
    return np.where(driven, np.stack([acceleration, lane]), 0.0)
