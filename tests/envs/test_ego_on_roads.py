"""`charms_bench/Ego-v0` on highway-env's roads, among their own vehicles or among agents."""

from copy import deepcopy
from typing import Any

import gymnasium
import highway_env  # noqa: F401  # registers merge-v1
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

import charms_bench.envs  # noqa: F401  # registers Ego-v0
from charms_bench.engine.endings import ENDINGS, GOAL, RUNNING
from charms_bench.engine.simulation import Simulation
from charms_bench.envs import ID
from charms_bench.envs.ego_env import EgoEnv
from charms_bench.envs.learners_vector_env import LearnersVectorEnv
from charms_bench.envs.parallel_env import HighwayParallelEnv
from charms_bench.envs.rendering import moment_of
from charms_bench.errors import InputError
from charms_bench.plugins.agent import Policy
from charms_bench.plugins.registry import make_agent
from charms_bench.plugins.specs import TrafficSpec
from charms_bench.roads import OF_SUITES
from charms_bench.roads.settings import on_road
from charms_bench.runs.shard import engine_on
from charms_bench.world.actions import FASTER, IDLE
from charms_bench.world.named_road import NamedRoad
from charms_bench.world.scene import SceneSettings

SCENE: dict[str, Any] = {"profile": "roads", "duration_s": 45.0}


OF_ROAD: dict[str, Any] = {"traffic": "environment"}


def made(road: str = "merge-v1", traffic: str = "human", **arguments: Any) -> EgoEnv:
    env = gymnasium.make(ID, scene={**SCENE, "road": road}, traffic=traffic, **arguments)
    assert isinstance(env.unwrapped, EgoEnv)
    return env.unwrapped


def driven(env: EgoEnv, actions: list[int]) -> list[tuple[Any, ...]]:
    """What `step` returns until the episode is over."""
    steps = []
    for action in actions:
        seen, *rest, info = env.step(action)
        steps.append((seen.tobytes(), *rest, info.get("ending")))
        if rest[1] or rest[2]:
            break
    return steps


@pytest.mark.parametrize("road", OF_SUITES)
def test_every_road_of_suites_is_an_environment(road: str) -> None:
    env = made(road, "environment")
    check_env(env, skip_render_check=True)
    seen, _ = env.reset(seed=3)
    for _ in range(20):
        assert env.observation_space.contains(seen)
        seen, _, terminated, truncated, _ = env.step(env.action_space.sample())
        if terminated or truncated:
            break


@pytest.mark.parametrize(("road", "traffic"), [("merge-v1", "human"), ("exit-v1", "environment")])
def test_an_episode_is_that_of_a_suite_with_the_same_decisions(road: str, traffic: str) -> None:
    spec, policy = TrafficSpec.model_validate(traffic), make_agent("charms")
    assert isinstance(policy, Policy)
    env = made(road, traffic, actions=policy.actions)
    settings = on_road(SceneSettings.model_validate(SCENE), NamedRoad(name=road))
    agents = {name: make_agent(name) for name in ("charms", "human")}
    suite = Simulation(settings, 1, "charms", spec.make(), agents, engine_on(settings))
    suite.reset(np.array([7], dtype=np.uint64))
    env.reset(seed=7)
    over = False
    while not over:
        suite.step()
        action = suite.action[0, suite.scene.ego[0]]
        _, _, terminated, truncated, info = env.step(int(action))
        over = terminated or truncated
        np.testing.assert_array_equal(env.simulation.scene.x, suite.scene.x)
        np.testing.assert_array_equal(env.simulation.scene.speed, suite.scene.speed)
    assert info["ending"] == ENDINGS[suite.ending[0]]


def test_the_vector_environment_has_the_same_episodes() -> None:
    scene = {**SCENE, "road": "merge-v1"}
    many: Any = gymnasium.make_vec(ID, 3, "vector_entry_point", traffic="human", scene=scene)
    ones = [made() for _ in range(3)]
    seen, _ = many.reset(seed=5)
    np.testing.assert_array_equal(seen, [env.reset(seed=5 + k)[0] for k, env in enumerate(ones)])
    for _ in range(15):
        _, rewards, terminated, *_ = many.step(np.full(3, FASTER))
        steps = [env.step(FASTER) for env in ones]
        assert rewards.tolist() == [step[1] for step in steps]
        assert terminated.tolist() == [step[2] for step in steps]
        if terminated.any():
            break


def test_a_saved_state_and_a_copy_continue_the_episode() -> None:
    env, other = made(), made()
    env.reset(seed=2)
    driven(env, [IDLE] * 6)
    state, copied = env.get_state(), deepcopy(env)
    rest = driven(env, [FASTER, IDLE] * 80)
    assert rest[-1][-1] is not None
    other.set_state(state)
    assert driven(other, [FASTER, IDLE] * 80) == rest
    other.reset(options={"state": state})
    assert driven(other, [FASTER, IDLE] * 80) == rest
    assert driven(copied, [FASTER, IDLE] * 80) == rest


def test_the_goal_ends_an_episode_and_earns_the_decisions_that_are_left() -> None:
    env = made()
    env.reset(seed=5)
    steps = driven(env, [IDLE] * 135)
    _, reward, terminated, truncated, ending = steps[-1]
    assert (terminated, truncated, ending) == (True, False, "goal")
    assert env.simulation.ending[0] == GOAL
    assert all(0.0 < each[1] <= 1.0 for each in steps[:-1])
    assert reward - (135 - len(steps)) == pytest.approx(steps[-2][1], abs=0.1)


def test_a_picture_has_the_vehicles_where_highway_env_puts_them() -> None:
    stock: Any = gymnasium.make("merge-v1").unwrapped
    stock.reset(seed=3)
    env = made("merge-v1", "environment", render_mode="rgb_array")
    env.reset(seed=3)
    plan = moment_of(env.simulation, 0, ID).plan
    assert plan is not None
    is_vehicle = plan.present & ~plan.is_obstacle
    found = sorted(zip(plan.x[is_vehicle], plan.y[is_vehicle], strict=True))
    expected = sorted(tuple(each.position) for each in stock.road.vehicles)
    np.testing.assert_allclose(found, expected, atol=1e-9)
    frame = env.render()
    assert frame is not None
    assert frame.std() > 0


@pytest.mark.parametrize("road", ["merge-v1", "roundabout-v1"])
def test_learners_with_the_decisions_of_agents_drive_as_these(road: str) -> None:
    policy, around = make_agent("imitation"), TrafficSpec.model_validate("imitation").make()
    assert isinstance(policy, Policy)
    settings = on_road(SceneSettings.model_validate(SCENE), NamedRoad(name=road))
    agents = {"imitation": policy}
    suite = Simulation(settings, 1, "imitation", around, agents, engine_on(settings))
    suite.reset(np.array([7], dtype=np.uint64))
    drawn = {"actions": policy.actions, "observation": policy.observation}
    env = HighwayParallelEnv(traffic="imitation", road=road, **SCENE, **drawn)
    seen, _ = env.reset(seed=7)
    present = suite.engine.state.present[0]
    assert env.agents == [f"vehicle_{k}" for k in np.nonzero(present)[0]]
    decisions = 0
    while suite.ending[0] == RUNNING and len(env.agents) == present.sum():
        suite.step()
        actions = policy.decide(np.stack([*seen.values()]))
        seen, *_ = env.step(dict(zip(seen, actions.tolist(), strict=True)))
        for name in ("x", "y", "speed", "lane"):
            found, expected = (getattr(each.engine.state, name) for each in (env.simulation, suite))
            np.testing.assert_array_equal(found[:, present], expected[:, present])
        decisions += 1
    assert decisions > 10


def test_vehicles_that_come_later_need_a_driver_so_an_intersection_has_one_learner() -> None:
    scene = {"road": "intersection-v0", **SCENE}
    with pytest.raises(InputError, match="LearnersVectorEnv: learners: other vehicles come"):
        LearnersVectorEnv(2, (0, 1), scene=scene)
    LearnersVectorEnv(2, (0,), scene=scene).reset(seed=0)


def test_a_learner_that_reaches_the_goal_leaves_the_others_on_the_road() -> None:
    env = LearnersVectorEnv(2, (0, 2), traffic="human", first_seed=5, road="merge-v1", **SCENE)
    env.reset()
    endings = np.zeros((2, 2), dtype=np.int64)
    for _ in range(135):
        _, _, terminated, truncated, infos = env.step(np.full(4, IDLE))
        ended = (terminated | truncated).reshape(2, 2)
        if ended.any():
            endings[ended] = infos["final_info"]["ending"].reshape(2, 2)[ended]
        if endings.all():
            break
    assert GOAL in endings[:, 0]
    assert GOAL not in endings[:, 1]


def test_the_default_traffic_of_a_road_is_its_own() -> None:
    own, named = (gymnasium.make(ID, scene={"road": "exit-v1"}, **each) for each in ({}, OF_ROAD))
    for _ in range(2):
        seen = [env.reset(seed=4)[0] for env in (own, named)]
        np.testing.assert_array_equal(*seen)
        np.testing.assert_array_equal(own.step(IDLE)[0], named.step(IDLE)[0])
    straight: Any = gymnasium.make(ID).unwrapped
    straight.reset(seed=4)
    assert "idm_mobil" in straight.simulation.drivers[0]


def test_a_planner_can_be_the_traffic() -> None:
    env = made("merge-v1", "mpc")
    env.reset(seed=1)
    steps = driven(env, [IDLE] * 3)
    assert len(steps) == 3
    state = env.simulation.engine.state
    assert env.simulation.has_action[0, 1:][state.present[0, 1:]].all()
