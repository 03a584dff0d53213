"""`tools/train_stable_baselines3.py`, which trains the baselines of docs/training-plan.md."""

# ruff: noqa: E402  (nothing below can be imported without the extra 'train')

import json
import sys
from pathlib import Path

import numpy as np
import pytest

torch = pytest.importorskip("torch", reason="needs the extra 'train'")

from charms_agents.training.network import untrained
from charms_agents.training.network_file import export, read_network
from charms_agents.training.standardised import folded, standardise, unfolded
from charms_agents.training.suite_file import load_training
from stable_baselines3 import DQN, PPO

from charms_bench.engine.endings import TIME
from charms_bench.envs.vector_env import HighwayVectorEnv
from charms_bench.plugins.onnx_policy import OnnxPolicy
from charms_bench.plugins.registry import make_agent
from charms_bench.world.actions import DEFAULT_ACTIONS, MetaAction, with_speed_steps

ROOT = Path(__file__).parents[2]
sys.path.insert(0, str(ROOT / "tools"))
try:
    import train_stable_baselines3 as tool
finally:
    sys.path.remove(str(ROOT / "tools"))

SUITE = load_training(ROOT / "suites/train.yaml")
STAGE = SUITE.stages["level_1"].model_copy(update={"prior": None})
ACTIONS = with_speed_steps(
    0.25,
    0.5,
    1.0,
    2.0,
    actions=(*DEFAULT_ACTIONS, MetaAction("BRAKE", speed_from_present_mps=-6.0)),
)
SCENES = 25
"""One for each condition of the stage."""


@pytest.fixture(scope="module")
def conditions() -> tool.Conditions:
    return tool.Conditions(SUITE, STAGE, Path("no networks are needed"), SCENES)


def test_the_first_condition_has_the_observations_of_its_own_environment(
    conditions: tool.Conditions,
) -> None:
    scene, traffic = SUITE.places_of(STAGE)[0]
    reward = STAGE.reward_of(SUITE.weights["level_1"])
    agents, seed = {"human": make_agent("human")}, SUITE.first_episode_seed
    alone = HighwayVectorEnv(scene, 1, traffic, agents, reward, seed, SUITE.observed)
    plain = torch.from_numpy(alone.reset()[0].reshape(1, -1))
    expected = standardise(plain).reshape(SUITE.observed.shape).numpy()
    np.testing.assert_array_equal(conditions.reset()[0], expected)


def test_an_episode_that_ends_by_time_is_truncated(conditions: tool.Conditions) -> None:
    conditions.reset()
    ended = 0
    for _ in range(60):  # 20 s
        _, _, dones, infos = conditions.step(np.ones(SCENES, dtype=np.int64))
        for row in np.flatnonzero(dones):
            is_over = infos[row]["final_info"]["ending"] == TIME
            assert infos[row]["TimeLimit.truncated"] == is_over
            assert infos[row]["terminal_observation"].shape == SUITE.observed.shape
            ended += 1
    assert ended >= SCENES


@pytest.mark.parametrize("algorithm", [DQN, PPO])
def test_the_saved_network_takes_plain_observations(
    conditions: tool.Conditions, algorithm: type[DQN | PPO]
) -> None:
    model = algorithm("MlpPolicy", conditions, seed=0, device="cpu")
    rng = np.random.default_rng(0)
    plain = rng.uniform(-1, 1, (50, *SUITE.observed.shape)).astype(np.float32)
    seen = standardise(torch.from_numpy(plain).flatten(1)).reshape(plain.shape).numpy()
    before, _ = model.policy.predict(seen, deterministic=True)
    tool._take_plain_observations(model)
    after, _ = model.policy.predict(plain, deterministic=True)
    assert (before == after).all()
    assert len(set(after.tolist())) > 1


@pytest.fixture(scope="module")
def with_prior(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of a seed, with an untrained network as its prior."""
    folder = tmp_path_factory.mktemp("seed")
    rows, columns = SUITE.observed.shape
    network = folded(untrained((64, 64), 5, rows * columns, len(ACTIONS)))
    seen = np.random.default_rng(1).uniform(-1, 1, (20, rows, columns)).astype(np.float32)
    export(network, folder / "people.onnx", {}, seen, SUITE.observed, actions=ACTIONS)
    return folder


def test_rewards_are_less_by_lambda_per_nat_where_people_would_seldom_do_the_same(
    with_prior: Path,
) -> None:
    plain, regularised = (
        tool.Conditions(SUITE, stage, with_prior, SCENES)
        for stage in (STAGE, SUITE.stages["level_1"])
    )
    seen = torch.from_numpy(plain.reset().reshape(SCENES, -1))
    regularised.reset()
    actions = np.arange(SCENES) % 5
    difference = plain.step(actions)[1] - regularised.step(actions)[1]
    logits = unfolded(read_network(with_prior / "people.onnx"))(seen)
    shares = torch.softmax(logits, dim=1).detach().numpy()[np.arange(SCENES), actions]
    np.testing.assert_allclose(difference, -0.2 * np.log(shares), atol=2e-5)


def test_a_finished_seed_has_a_network_with_the_speed_steps_of_the_stage(with_prior: Path) -> None:
    suite = load_training(ROOT / "suites/train.yaml", seed=7, steps=1000)
    tool.train(suite, "level_1", "dqn", "charms", with_prior)
    assert OnnxPolicy(with_prior / "dqn.onnx").actions == ACTIONS
    manifest = json.loads((with_prior / "dqn.json").read_text())
    assert (manifest["seed"], manifest["steps"]) == (7, 1000)
    assert len(manifest["conditions"]) == SCENES
