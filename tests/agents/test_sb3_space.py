"""A checkpoint is exported with what it was trained on, or rejected with the reason."""

import json
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pytest
import stable_baselines3 as sb3
import torch
from charms_agents.training.sb3_export import export_zip
from command_line import charms_bench
from gymnasium.wrappers import FrameStackObservation, NormalizeObservation, RescaleObservation
from stable_baselines3.common.vec_env import VecEnv, VecFrameStack, VecNormalize

from charms_bench.envs import ego_env  # noqa: F401  # registers the environments
from charms_bench.envs.sb3 import EpisodesVecEnv
from charms_bench.errors import ModelError
from charms_bench.plugins.onnx_policy import OnnxPolicy
from charms_bench.world.actions import DEFAULT_ACTIONS, MetaAction
from charms_bench.world.interaction_observation import Interaction
from charms_bench.world.kinematics_observation import Kinematics
from charms_bench.world.observations import neighbours, paper_neighbours

SAVED = "mean=env.obs_rms.mean, var=env.obs_rms.var, clip=env.clip_obs"


def made(name: str = "charms_bench/Ego-v0", **options: Any) -> VecEnv:
    return EpisodesVecEnv(gymnasium.make_vec(name, num_envs=2, **options))


def trained(env: Any, folder: Path, **settings: Any) -> tuple[Any, Path]:
    """A PPO after its first update, whose weights are large enough to matter."""
    kwargs = {"net_arch": [16]}
    model = sb3.PPO(
        "MlpPolicy", env, n_steps=8, batch_size=8, n_epochs=1, policy_kwargs=kwargs, seed=3,
        device="cpu", **settings,
    )  # fmt: skip
    model.learn(16)
    with torch.no_grad():
        for parameter in model.policy.parameters():
            parameter.mul_(3.0)
    model.save(folder / "model.zip")
    return model, folder / "model.zip"


def rejection(path: Path, *arguments: object) -> str:
    done = charms_bench("export", path, path.with_suffix(".onnx"), *arguments)
    assert done.returncode == 2, done
    assert not path.with_suffix(".onnx").exists()
    return done.stderr.partition("error: ")[2]


@pytest.mark.parametrize(
    ("options", "observation"),
    [
        ({}, neighbours),
        ({"observation": "paper_neighbours"}, paper_neighbours),
        (
            {"observation": {"type": "Kinematics", "vehicles_count": 7, "see_behind": True}},
            Kinematics(vehicles_count=7, see_behind=True),
        ),
        ({"decision_hz": 5}, neighbours),
    ],
)
def test_the_observation_and_the_rate_are_those_of_the_environment(
    options: dict[str, Any], observation: Any, tmp_path: Path
) -> None:
    _, path = trained(made(**options), tmp_path)
    done = export_zip(path, tmp_path / "out.onnx", {})
    policy = OnnxPolicy(tmp_path / "out.onnx")
    assert policy.observation == observation
    assert policy.decision_hz == done["decision_hz"] == options.get("decision_hz", 3)


def test_another_observation_than_the_environments_is_rejected(tmp_path: Path) -> None:
    _, path = trained(made(observation="paper_neighbours"), tmp_path)
    said = rejection(path, "--observation", "neighbours")
    assert "was trained on paper_neighbours (charms_bench/Ego-v0), not on neighbours" in said


def test_a_highway_env_network_is_not_exported_as_one_of_neighbours(tmp_path: Path) -> None:
    pytest.importorskip("highway_env")
    config = {"observation": {"type": "Kinematics", "vehicles_count": 7}}
    _, path = trained(gymnasium.make("highway-v0", config=config), tmp_path)
    kinematics = "{type: Kinematics, vehicles_count: 7}"
    for more in (), ("--observation", "neighbours"):
        assert f"--observation '{kinematics}'" in rejection(path, *more)
    done = charms_bench("export", path, tmp_path / "k.onnx", "--observation", kinematics)
    assert "observes Kinematics, decides at 1 Hz; its checkpoint does not say" in done.stdout
    assert OnnxPolicy(tmp_path / "k.onnx").is_assumed  # merge-v0 has the same space


def test_the_environment_of_the_papers_authors_has_no_bounds(tmp_path: Path) -> None:
    config = {"observation": {"type": "Kinematics", "vehicles_count": 7}}
    _, path = trained(gymnasium.make("highway-v0", config=config), tmp_path)
    export_zip(path, tmp_path / "out.onnx", {}, paper_neighbours)
    assert OnnxPolicy(tmp_path / "out.onnx").observation == paper_neighbours


def test_a_network_with_bounds_is_not_exported_as_one_of_kinematics(tmp_path: Path) -> None:
    env = RescaleObservation(gymnasium.make("charms_bench/Ego-v0"), np.float32(0), np.float32(1))
    _, path = trained(env, tmp_path)
    kinematics = "{type: Kinematics, vehicles_count: 7}"
    assert "and Kinematics has none" in rejection(path, "--observation", kinematics)
    assert "other bounds than those of neighbours, as behind a wrapper" in rejection(path)


def test_a_network_of_a_road_that_no_suite_has_is_rejected(tmp_path: Path) -> None:
    config = {"observation": {"type": "Kinematics"}}
    _, path = trained(gymnasium.make("charms_bench/parking-v0", config=config), tmp_path)
    assert "was trained in charms_bench/parking-v0, on whose road suites have no" in rejection(path)


def test_a_network_of_interaction_is_exported(tmp_path: Path) -> None:
    on_road = {"scene": {"road": "merge-v1"}, "observation": "interaction"}
    for name, options in (("straight", {"observation": "interaction"}), ("merge", on_road)):
        _, path = trained(made(**options), tmp_path)
        done = export_zip(path, tmp_path / f"{name}.onnx", {})
        policy = OnnxPolicy(tmp_path / f"{name}.onnx")
        assert (policy.observation, done["trained_in"]) == (Interaction(), "Ego-v0")


def test_a_network_of_highway_takes_its_options_along(tmp_path: Path) -> None:
    config = {"observation": {"type": "Kinematics", "absolute": True}, "policy_frequency": 5}
    _, path = trained(gymnasium.make("charms_bench/highway-v0", config=config), tmp_path)
    export_zip(path, tmp_path / "out.onnx", {})
    policy = OnnxPolicy(tmp_path / "out.onnx")
    assert (policy.observation, policy.decision_hz) == (Kinematics(absolute=True), 5)


def test_other_target_speeds_than_those_of_suites_are_rejected(tmp_path: Path) -> None:
    config = {"action": {"type": "DiscreteMetaAction", "target_speeds": [0, 10, 20]}}
    _, path = trained(gymnasium.make("charms_bench/highway-v0", config=config), tmp_path)
    assert "was trained with the target speeds [0, 10, 20] m/s" in rejection(path)


def driven(env: VecEnv, model: Any, path: Path) -> None:
    """The model and its file act alike, decision by decision, as the harness asks the file."""
    policy, seen = OnnxPolicy(path), env.reset()
    history = np.zeros((2, policy.history_length, 7, 5), np.float32)
    for _ in range(12):
        raw = original(env)
        history = np.concatenate([history[:, 1:], raw[:, None]], axis=1)
        expected, _ = model.predict(seen, deterministic=True)
        found = policy.decide(history if policy.history_length > 1 else raw)
        np.testing.assert_allclose(found, expected, rtol=0, atol=1e-4)
        seen, _, ended, _ = env.step(expected)
        history[ended] = 0


def original(env: Any) -> Any:
    """The newest observations before any wrapper."""
    while hasattr(env, "venv"):
        env = env.venv
    episodes = env.episodes.unwrapped
    learners = episodes._episodes.learners
    return learners.observe(learners.vehicles)


def test_statistics_that_are_missing_are_named(tmp_path: Path) -> None:
    _, path = trained(VecNormalize(made()), tmp_path)
    said = rejection(path)
    assert "was trained with VecNormalize, whose statistics a checkpoint does not hold" in said
    assert f"numpy.savez('norm.npz', {SAVED}), and give --normalise norm.npz" in said


def test_rewards_alone_may_be_normalised(tmp_path: Path) -> None:
    _, path = trained(VecNormalize(made(), norm_obs=False), tmp_path)
    for more in (), ("--normalise", "none"):
        done = charms_bench("export", path, tmp_path / "out.onnx", *more)
        assert done.returncode == 0, done


@pytest.mark.parametrize("norm_obs", [False, True])
@pytest.mark.parametrize("kind", ["DQN", "SAC"])
def test_off_policy_algorithms_are_told_from_those_behind_a_normalisation(
    kind: str, norm_obs: bool, tmp_path: Path
) -> None:
    env = made(actions="continuous" if kind == "SAC" else "meta")
    env = VecNormalize(env, norm_obs=True) if norm_obs else env
    model = getattr(sb3, kind)("MlpPolicy", env, learning_starts=8, buffer_size=64, device="cpu")
    model.learn(40)
    model.save(tmp_path / "model.zip")
    if norm_obs:
        assert "was trained with VecNormalize" in rejection(tmp_path / "model.zip")
    else:
        export_zip(tmp_path / "model.zip", tmp_path / "out.onnx", {})


@pytest.mark.parametrize("actions", ["meta", "continuous"])
@pytest.mark.parametrize("frames", [1, 3])
def test_a_normalised_network_acts_as_its_checkpoint(
    actions: str, frames: int, tmp_path: Path
) -> None:
    env = made(actions=actions)
    env = VecNormalize(VecFrameStack(env, frames) if frames > 1 else env, clip_obs=1.5)
    model, path = trained(env, tmp_path)
    env.training = False
    saved = {"mean": env.obs_rms.mean, "var": env.obs_rms.var, "clip": env.clip_obs}
    np.savez(tmp_path / "norm.npz", **saved)
    done = charms_bench(
        "export", path, tmp_path / "out.onnx", "--normalise", tmp_path / "norm.npz", "--json"
    )
    assert json.loads(done.stdout)["history"] == frames
    driven(env, model, tmp_path / "out.onnx")


def test_the_statistics_of_gymnasiums_wrapper_are_taken_along(tmp_path: Path) -> None:
    env = NormalizeObservation(gymnasium.make("charms_bench/Ego-v0"))
    model, path = trained(env, tmp_path)
    assert "give --normalise" in rejection(path)
    rms = env.obs_rms
    np.savez(tmp_path / "norm.npz", mean=rms.mean, var=rms.var, clip=np.inf)
    export_zip(path, tmp_path / "out.onnx", {}, normalise=tmp_path / "norm.npz")
    seen = np.random.default_rng(0).uniform(-1, 1, (100, 7, 5)).astype(np.float32)
    normal = ((seen - rms.mean) / np.sqrt(rms.var + 1e-8)).astype(np.float32)
    expected, _ = model.predict(normal, deterministic=True)
    np.testing.assert_array_equal(OnnxPolicy(tmp_path / "out.onnx").decide(seen), expected)


@pytest.mark.parametrize(
    ("arrays", "message"),
    [
        ({"mean": np.zeros((7, 5)), "var": np.ones((7, 5))}, "has no clip; expected a file made"),
        ({"mean": np.zeros(3), "var": np.ones(3), "clip": 10}, r"expected \(7, 5\)"),
        ({"mean": np.zeros(35), "var": -np.ones(35), "clip": 10}, "variances and a clip above 0"),
        ({"mean": np.array([{}]), "var": np.ones(35), "clip": 10}, "cannot be read: Object arrays"),
    ],
)
def test_statistics_that_do_not_fit_are_rejected(
    arrays: dict[str, Any], message: str, tmp_path: Path
) -> None:
    _, path = trained(VecNormalize(made()), tmp_path)
    np.savez(tmp_path / "norm.npz", **arrays, allow_pickle=True)
    with pytest.raises(ModelError, match=message):
        export_zip(path, tmp_path / "out.onnx", {}, normalise=tmp_path / "norm.npz")


def test_the_pickle_of_a_vec_normalize_is_not_loaded(tmp_path: Path) -> None:
    env = VecNormalize(made())
    _, path = trained(env, tmp_path)
    env.save(str(tmp_path / "norm.pkl"))
    said = rejection(path, "--normalise", tmp_path / "norm.pkl")
    assert "is not a NumPy archive; expected a file made in Python with numpy.savez(" in said


def test_stacked_frames_become_history(tmp_path: Path) -> None:
    env = VecFrameStack(made(), 4)
    model, path = trained(env, tmp_path)
    done = export_zip(path, tmp_path / "out.onnx", {})
    assert (done["sizes"][0], done["history"]) == (140, 4)
    driven(env, model, tmp_path / "out.onnx")


def test_the_first_of_gymnasiums_stacked_frames_stands_for_the_time_before(tmp_path: Path) -> None:
    env = FrameStackObservation(gymnasium.make("charms_bench/Ego-v0"), 3)
    model, path = trained(env, tmp_path)
    export_zip(path, tmp_path / "out.onnx", {})
    policy = OnnxPolicy(tmp_path / "out.onnx")
    seen = np.random.default_rng(0).uniform(-1, 1, (50, 3, 7, 5)).astype(np.float32)
    seen[:25, 0], seen[:12, 1] = 0.0, 0.0
    filled = seen.copy()
    filled[:12, 1] = filled[:12, 2]
    filled[:25, 0] = filled[:25, 1]
    expected, _ = model.predict(filled, deterministic=True)
    np.testing.assert_array_equal(policy.decide(seen), expected)
    assert policy.history_length == 3


@pytest.mark.parametrize("kind", ["PPO", "A2C"])
def test_a_continuous_ppos_file_has_the_clipped_mean(kind: str, tmp_path: Path) -> None:
    env = made(actions="continuous")
    model = getattr(sb3, kind)("MlpPolicy", env, seed=3, device="cpu")
    with torch.no_grad():
        for parameter in model.policy.parameters():
            parameter.mul_(40.0)
    model.save(tmp_path / "model.zip")
    export_zip(tmp_path / "model.zip", tmp_path / "out.onnx", {})
    policy = OnnxPolicy(tmp_path / "out.onnx")
    seen = np.random.default_rng(0).uniform(-1, 1, (90, 7, 5)).astype(np.float32)
    expected, _ = model.predict(seen, deterministic=True)
    np.testing.assert_allclose(policy.decide(seen), expected, rtol=0, atol=1e-5)
    assert policy.actions == "continuous"
    assert ((np.abs(expected) == 1).any(), (np.abs(expected) < 1).any()) == (True, True)
    assert "--stochastic is for" in rejection(tmp_path / "model.zip", "--stochastic")


def test_a_network_has_the_meta_actions_of_its_environment(tmp_path: Path) -> None:
    six = (*DEFAULT_ACTIONS, MetaAction("BRAKE", speed_from_present_mps=-6.0))
    model, path = trained(made(actions=six), tmp_path)
    export_zip(path, tmp_path / "out.onnx", {})
    policy = OnnxPolicy(tmp_path / "out.onnx")
    assert policy.actions == six
    seen = np.random.default_rng(0).uniform(-1, 1, (90, 7, 5)).astype(np.float32)
    expected, _ = model.predict(seen, deterministic=True)
    np.testing.assert_array_equal(policy.decide(seen), expected)
