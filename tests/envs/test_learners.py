"""Vehicles driven from outside: how they move, who drives the others, and what ends whom."""

from types import SimpleNamespace
from typing import Any

import gymnasium
import highway_env  # noqa: F401  # registers highway-v0
import numpy as np
import pytest
from highway_env.envs.highway_env import HighwayEnv

from charms_bench.engine.endings import OFF_ROAD, REAR_END, RUNNING, SIDE, TIME
from charms_bench.engine.neighbours import locate
from charms_bench.engine.simulation import Simulation
from charms_bench.envs.highway_reward import highway_rewards
from charms_bench.envs.learners import Learners
from charms_bench.errors import InputError
from charms_bench.plugins.agent import Policy
from charms_bench.plugins.registry import make_agent
from charms_bench.plugins.traffic import Mixture, OneAgent, Traffic
from charms_bench.testing.reference_engine import HighwayEnvEngine
from charms_bench.world.actions import ACTIONS, FASTER, IDLE, Actions
from charms_bench.world.observations import named_observation, neighbours
from charms_bench.world.profile import PROFILES
from charms_bench.world.scene import Observations, SceneSettings


def learners(
    settings: SceneSettings, numbers: Any = None, scenes: int = 1, traffic: Traffic | None = None
) -> Learners:
    traffic = traffic or OneAgent("idm_mobil")
    agents = {name: make_agent(name) for name in traffic.agents}
    made = Learners(settings, scenes, numbers, traffic, agents, highway_rewards)
    made.reset(np.arange(scenes, dtype=np.uint64), np.arange(scenes))
    return made


def on_the_middle_lane(*x: float, **scene: Any) -> Learners:
    """One scene of learners at these x, all at 25 m/s."""
    settings = SceneSettings(traffic_vehicles=len(x) - 1, ego_slots=1, **scene)
    made = learners(settings)
    scene = made.simulation.scene
    scene.x[0], scene.y[0], scene.target_lane[0] = x, 4.0, 1
    scene.speed[0] = scene.target_speed[0] = 25.0
    locate(scene, np.array([0]))
    return made


class Whims(Policy):
    """Decides by what it observes, in no sensible way."""

    def decide(self, observations: Observations) -> Actions:
        return (observations.sum(axis=(1, 2)) * 1e4).astype(np.int64) % len(ACTIONS)


def test_a_scene_is_that_of_highway_envs_own_multi_agent_environment() -> None:
    count, lanes = 9, 4
    config = {
        "lanes_count": lanes,
        "controlled_vehicles": count,
        "vehicles_count": 0,
        "ego_spacing": 0.7,
        "action": {"type": "MultiAgentAction", "action_config": {"type": "DiscreteMetaAction"}},
        "observation": {
            "type": "MultiAgentObservation",
            "observation_config": {"type": "Kinematics"},
        },
    }
    stock: Any = gymnasium.make("highway-v0", config=config, disable_env_checker=True).unwrapped
    expected, _ = stock.reset(seed=4)
    settings = SceneSettings.model_validate(
        {"profile": "highway-env", "lanes": lanes, "traffic_vehicles": count - 1, "ego_slots": 1}
        | {"decision_hz": 1, "duration_s": 40.0}
    )
    ours = learners(settings)
    scene = ours.simulation.scene
    scene.x[0], scene.y[0] = np.transpose([vehicle.position for vehicle in stock.road.vehicles])
    scene.speed[0] = scene.target_speed[0] = 25.0
    scene.target_lane[0] = [vehicle.target_lane_index[2] for vehicle in stock.road.vehicles]
    locate(scene, np.array([0]))
    rng, ended, before = np.random.default_rng(1), False, 0.0
    while not ended:
        seen = named_observation("Kinematics")(scene, ours.vehicles)
        alive = ours.alive.copy()
        np.testing.assert_allclose(seen, np.array(expected)[alive], rtol=0, atol=1e-6)
        actions = rng.integers(len(ACTIONS), size=count)
        ours.step(actions)
        expected, reward, *endings, _ = stock.step(tuple(actions.tolist()))
        np.testing.assert_allclose(scene.speed[0], [v.speed for v in stock.road.vehicles])
        wrecks = [vehicle.crashed for vehicle in stock.road.vehicles]
        np.testing.assert_array_equal(~ours.alive, wrecks)
        assert ours.returns[0] - before == pytest.approx(reward)
        before = ours.returns[0]
        ended = any(endings)
    assert sum(wrecks) > 2


def test_learners_of_a_policy_drive_as_the_policy_does_in_a_suite() -> None:
    settings = SceneSettings(density=1.5)
    agents = {"whims": Whims()}
    expected = Simulation(settings, 5, "whims", OneAgent("whims"), agents)
    expected.reset(np.arange(5, dtype=np.uint64))
    found = learners(settings, scenes=5)
    for _ in range(12):
        actions = np.zeros(found.alive.shape, dtype=np.int64)
        actions[found.alive] = Whims().decide(neighbours(found.simulation.scene, found.vehicles))
        found.step(actions)
        running = expected.scene.active.copy()
        expected.step()
        for name in ("x", "y", "speed", "heading"):
            one, other = (getattr(each.scene, name) for each in (found.simulation, expected))
            # A suite's agents command their wrecks, which changes nothing about their motion.
            np.testing.assert_array_equal(one[running], other[running])
    assert expected.failed.any()
    assert expected.scene.active.any()


def test_vehicles_that_are_not_learners_have_the_drivers_that_they_have_without_learners() -> None:
    mixture = Mixture({"idm_mobil": 0.5, "stackelberg": 0.5})
    settings = SceneSettings()
    agents = {name: make_agent(name) for name in mixture.agents}
    without = Simulation(settings, 4, None, mixture, agents)
    without.reset(np.arange(4, dtype=np.uint64))
    found = learners(settings, (0, 2, 7), scenes=4, traffic=mixture)
    drivers = found.simulation.drivers
    assert (drivers[np.arange(4)[:, None], found.places.reshape(4, -1)] == "").all()
    assert (drivers == "").sum() == 12
    np.testing.assert_array_equal(drivers[drivers != ""], without.drivers[drivers != ""])
    np.testing.assert_array_equal(found.simulation.scene.x, without.scene.x)


def test_learners_are_the_ego_and_the_others_in_the_order_of_spawning() -> None:
    found = learners(SceneSettings(), (5, 0, 1), scenes=30)
    assert found.numbers == (0, 1, 5)
    for row, ego in enumerate(found.simulation.scene.ego):
        others = [place for place in range(21) if place != ego]
        assert found.places[3 * row : 3 * row + 3].tolist() == [ego, others[0], others[4]]
    assert len({*found.simulation.scene.ego}) == 6


@pytest.mark.parametrize("profile", PROFILES)
def test_each_vehicle_gets_the_reward_that_highway_env_computes_for_it(profile: str) -> None:
    settings = SceneSettings(profile=PROFILES[profile], density=2.0, traffic_vehicles=9)
    simulation = Simulation(settings, 4, None, OneAgent(""), {}, HighwayEnvEngine)
    simulation.reset(np.arange(4, dtype=np.uint64))
    rng = np.random.default_rng(0)
    vehicles = np.nonzero(np.ones(simulation.scene.x.shape))
    compared = []
    for _ in range(15):
        simulation.command(vehicles, rng.integers(len(ACTIONS), size=vehicles[0].size))
        simulation.step()
        for row, place, reward in zip(
            *vehicles, highway_rewards(simulation.scene, vehicles), strict=True
        ):
            road = simulation.engine.roads[row]
            stock = SimpleNamespace(
                road=road, vehicle=road.vehicles[place], config=HighwayEnv.default_config()
            )
            stock._rewards = lambda action, of=stock: HighwayEnv._rewards(of, action)
            assert reward == pytest.approx(HighwayEnv._reward(stock, 0), abs=1e-12)
            compared.append(reward)
    assert simulation.scene.crashed.any()
    assert min(compared) < 0.34 < 0.9 < max(compared)


def test_a_crash_ends_two_learners_and_the_others_go_on_until_the_time_is_over() -> None:
    found = on_the_middle_lane(100.0, 106.0, 250.0, duration_s=2.0)
    found.simulation.scene.speed[0, 0] = 33.0
    first = found.step(np.full(3, IDLE))
    assert first.terminated.tolist() == [True, True, False]
    assert first.endings.tolist() == [REAR_END, REAR_END, RUNNING]
    assert not first.truncated.any()
    for _ in range(4):
        later = found.step(np.full(3, FASTER))
        assert not (later.terminated | later.truncated).any()
        assert later.rewards[:2].tolist() == [0.0, 0.0]
    scene = found.simulation.scene
    assert scene.target_speed[0].tolist() == [25.0, 25.0, 29.0]  # wrecks obey nobody
    last = found.step(np.full(3, IDLE))
    assert last.truncated.tolist() == [False, False, True]
    assert last.endings.tolist() == [RUNNING, RUNNING, TIME]
    assert not found.alive.any()


def test_leaving_the_road_ends_a_learner_where_the_profile_says_so() -> None:
    for profile, ending in (("charms", OFF_ROAD), ("highway-env", RUNNING)):
        found = on_the_middle_lane(100.0, 200.0, profile=PROFILES[profile])
        found.simulation.scene.y[0, 1] = 16.0
        locate(found.simulation.scene, np.array([0]))
        assert found.step(np.full(2, IDLE)).endings.tolist() == [RUNNING, ending]


def test_a_side_collision_is_told_from_a_rear_end_collision() -> None:
    found = on_the_middle_lane(100.0, 100.5)
    scene = found.simulation.scene
    scene.y[0, 1], scene.target_lane[0, 1] = 8.0, 2
    locate(scene, np.array([0]))
    scene.target_lane[0, 0] = 2
    endings = [found.step(np.full(2, IDLE)).endings.tolist() for _ in range(12)]
    assert [SIDE, SIDE] in endings


@pytest.mark.parametrize("numbers", [(), (1, 2), (0, 0), (0, 21), (-1, 0), 5, (0, 1.5)])
def test_numbers_that_no_vehicle_has_are_rejected(numbers: Any) -> None:
    expected = r"learners: found .*; expected different numbers from 0 to 20, .* such as range\(3\)"
    with pytest.raises(InputError, match=expected):
        learners(SceneSettings(), numbers)


def test_there_is_at_least_one_scene() -> None:
    with pytest.raises(InputError, match="scenes is 0; expected at least 1"):
        learners(SceneSettings(), scenes=0)
