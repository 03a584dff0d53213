"""Scripts for highway-env run here when the id of the environment is changed, and nothing else.

They do what highway-env's own scripts and its readme do, with fewer training steps. `tox -e slow`
and `tox -e libraries` run each with highway-env's id, too, and the latter records their videos.
"""

from importlib.util import find_spec
from pathlib import Path
from typing import Any

import gymnasium
import highway_env  # noqa: F401  # registers its environments
import numpy as np
import pytest
from gymnasium.error import ResetNeeded

import charms_bench.envs  # noqa: F401  # registers the environments
from charms_bench.errors import InputError

RENDERING = {
    "screen_width": 800,
    "screen_height": 300,
    "centering_position": [0.5, 0.5],
    "scaling": 7,
    "show_trajectories": True,
    "render_agent": False,
    "offscreen_rendering": True,
    "real_time_rendering": True,
}


THEIRS = pytest.param("", id="highway-env", marks=pytest.mark.slow)
OURS = pytest.param("charms_bench.envs:charms_bench/", id="charms-bench")


@pytest.fixture(params=[THEIRS, OURS])
def prefix(request: pytest.FixtureRequest) -> str:
    """What stands before the name of an environment."""
    return str(request.param)


def drive(env: Any, model: Any, folder: Path) -> None:
    """An episode of what was learnt, with a video where Gymnasium can record one."""
    if find_spec("moviepy") is not None:
        env = gymnasium.wrappers.RecordVideo(env, str(folder), episode_trigger=lambda _: True)
        env.unwrapped.set_record_video_wrapper(env)
    env.unwrapped.configure({"simulation_frequency": 15, "duration": 3})
    observation, _ = env.reset()
    done = truncated = False
    while not (done or truncated):
        action, _ = model.predict(observation, deterministic=True)
        observation, _, done, truncated, _ = env.step(action)
        assert env.render() is not None
    env.close()
    assert find_spec("moviepy") is None or [*folder.glob("*.mp4")]


@pytest.mark.filterwarnings("ignore::DeprecationWarning", "ignore::UserWarning")
def test_dqn_learns_on_the_motorway(prefix: str, tmp_path: Path) -> None:
    sb3 = pytest.importorskip("stable_baselines3", reason="needs the extra 'train'")
    env = gymnasium.make(f"{prefix}highway-fast-v0", render_mode="rgb_array")
    env.reset()
    model = sb3.DQN(
        "MlpPolicy",
        env,
        policy_kwargs={"net_arch": [256, 256]},
        learning_rate=5e-4,
        buffer_size=15_000,
        learning_starts=50,
        batch_size=32,
        gamma=0.8,
        train_freq=1,
        gradient_steps=1,
        target_update_interval=50,
        device="cpu",
    )
    model.learn(100)
    model.save(tmp_path / "model")
    drive(env, sb3.DQN.load(tmp_path / "model", env=env, device="cpu"), tmp_path)


@pytest.mark.filterwarnings("ignore::DeprecationWarning", "ignore::UserWarning")
def test_sac_with_hindsight_learns_to_park(prefix: str, tmp_path: Path) -> None:
    sb3 = pytest.importorskip("stable_baselines3", reason="needs the extra 'train'")
    config = {"add_walls": False, "duration": 10}
    env = gymnasium.make(f"{prefix}parking-v0", config=config, render_mode="rgb_array")
    model = sb3.SAC(
        "MultiInputPolicy",
        env,
        replay_buffer_class=sb3.HerReplayBuffer,
        replay_buffer_kwargs={"n_sampled_goal": 4, "goal_selection_strategy": "future"},
        buffer_size=10_000,
        learning_rate=1e-3,
        learning_starts=100,
        gamma=0.95,
        batch_size=256,
        tau=0.05,
        policy_kwargs={"net_arch": [64, 64]},
        device="cpu",
    )
    model.learn(200)
    drive(env, model, tmp_path)


@pytest.mark.filterwarnings("ignore::DeprecationWarning", "ignore::UserWarning")
def test_ppo_learns_on_the_racetrack(prefix: str, tmp_path: Path) -> None:
    sb3 = pytest.importorskip("stable_baselines3", reason="needs the extra 'train'")
    from stable_baselines3.common.env_util import make_vec_env

    name = f"{prefix}racetrack-v0"
    model = sb3.PPO(
        "MlpPolicy",
        make_vec_env(name, n_envs=3),
        policy_kwargs={"net_arch": {"pi": [256, 256], "vf": [256, 256]}},
        n_steps=64,
        batch_size=64,
        n_epochs=10,
        learning_rate=5e-4,
        gamma=0.9,
        device="cpu",
    )
    model.learn(192)
    model.save(tmp_path / "model")
    env = gymnasium.make(name, render_mode="rgb_array")
    drive(env, sb3.PPO.load(tmp_path / "model", device="cpu"), tmp_path)


@pytest.mark.filterwarnings("ignore::DeprecationWarning", "ignore::UserWarning")
def test_processes_of_stable_baselines3_find_the_id() -> None:
    pytest.importorskip("stable_baselines3", reason="needs the extra 'train'")
    from stable_baselines3.common.env_util import make_vec_env
    from stable_baselines3.common.vec_env import SubprocVecEnv

    config = {"lanes_count": 3, "vehicles_count": 15, "policy_frequency": 2}
    env = make_vec_env(
        "charms_bench.envs:charms_bench/highway-v0",
        n_envs=1,
        vec_env_cls=SubprocVecEnv,
        env_kwargs={"config": config},
    )
    observations = env.reset()
    assert observations.shape == (1, 5, 5)
    assert env.get_attr("config")[0]["lanes_count"] == 3
    env.close()


def test_the_loop_of_the_readme_draws_pictures(prefix: str) -> None:
    env: Any = gymnasium.make(f"{prefix}highway-v0", render_mode="rgb_array", config=RENDERING)
    env.unwrapped.config["vehicles_count"] = 10
    env.reset(options={"config": {"lanes_count": 3}})
    for _ in range(3):
        env.step(env.unwrapped.action_type.actions_indexes["IDLE"])
    assert set(env.unwrapped.get_available_actions()) <= env.unwrapped.action_type.actions.keys()
    assert env.render().ndim == 3
    env.close()


@pytest.mark.parametrize("name", ["merge-v1", "roundabout-v1", "intersection-multi-agent-v2"])
def test_vehicles_are_read_as_in_highway_env(name: str) -> None:
    ours, theirs = (gymnasium.make(f"{each}{name}").unwrapped for each in ("charms_bench/", ""))
    action: Any = (1, 1) if "multi" in name else 1
    for env in (ours, theirs):
        env.reset(seed=4)
        env.step(action)
    for ego, own in enumerate(ours.controlled_vehicles):
        assert own in ours.road.vehicles
        assert own.speed == pytest.approx(theirs.controlled_vehicles[ego].speed)
    assert ours.vehicle is ours.controlled_vehicles[0]
    assert ours.time == theirs.time
    assert len(ours.road.vehicles) == len(theirs.road.vehicles)
    for own, other in zip(ours.road.vehicles, theirs.road.vehicles, strict=True):
        for what in ("position", "velocity", "direction", "heading", "speed", "target_speed"):
            np.testing.assert_allclose(getattr(own, what), getattr(other, what), atol=1e-9)
        for what in ("lane_index", "target_lane_index", "crashed", "on_road", "LENGTH", "WIDTH"):
            assert getattr(own, what) == getattr(other, what)
        assert own.action == pytest.approx(other.action)
    ours.step(action)
    assert ours.vehicle.position[0] != own.position[0]


def test_what_is_not_here_says_what_to_use() -> None:
    env: Any = gymnasium.make("charms_bench/merge-v1").unwrapped
    with pytest.raises(AttributeError, match="'viewer'; use render_mode"):
        _ = env.viewer
    with pytest.raises(AttributeError, match=r"no attribute 'wheels'$"):
        _ = env.wheels
    env.reset(seed=0)
    with pytest.raises(AttributeError, match="speed"):
        env.vehicle.speed = 20.0


@pytest.mark.parametrize(
    ("thing", "name", "instead"),
    [
        ("road", "neighbour_vehicles", "road.vehicles"),
        ("road", "network", "lane_index"),
        ("road", "objects", "include_obstacles"),
        ("vehicle", "lane", "lane_index"),
        ("vehicle", "to_dict", "position"),
        ("vehicle", "destination", "highway-env itself"),
    ],
)
def test_what_roads_and_vehicles_do_not_have_says_what_to_use(
    thing: str, name: str, instead: str
) -> None:
    env, stock = (gymnasium.make(f"{each}merge-v1").unwrapped for each in ("charms_bench/", ""))
    for each in (env, stock):
        each.reset(seed=0)
    assert hasattr(getattr(stock, thing), name)
    with pytest.raises(AttributeError, match=f"no attribute '{name}'; use .*{instead}"):
        getattr(getattr(env, thing), name)
    with pytest.raises(AttributeError, match=r"no attribute 'wheels'$"):
        _ = getattr(env, thing).wheels


def test_there_are_no_vehicles_before_the_first_reset() -> None:
    env: Any = gymnasium.make("charms_bench/merge-v1", render_mode="rgb_array").unwrapped
    for ask in ("env.vehicle", "env.road", "env.get_available_actions()", "env.render()"):
        with pytest.raises(ResetNeeded, match="before the first reset"):
            eval(ask, {"env": env})


MORE = {"type": "ContinuousAction"}


@pytest.mark.parametrize("name", ["merge-v1", "two-way-v0", "roundabout-v1"])
@pytest.mark.parametrize(
    ("config", "said"),
    [
        ({"action": MORE}, "'ContinuousAction' is not supported, because highway-env's reward"),
        (
            {"action": {"type": "MultiAgentAction", "action_config": MORE}},
            "'ContinuousAction' is not supported, because highway-env's reward fails",
        ),
        ({"controlled_vehicles": 2}, "this environment has one ego, whatever the number in"),
    ],
)
def test_what_highway_env_cannot_do_is_rejected_by_a_sentence(
    name: str, config: Any, said: str
) -> None:
    with pytest.raises(InputError, match=f"^{name}: config.*{said}"):
        gymnasium.make(f"charms_bench/{name}", config=config)
    with pytest.raises(InputError, match=f"^{name}: config.*{said}"):
        gymnasium.make_vec(f"charms_bench/{name}", num_envs=2, config=config)
