"""Minari datasets: the episodes that the environment of the dataset gives."""

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pytest
import yaml

import charms_bench
from charms_bench.envs import ID
from charms_bench.episodes.minari_dataset import environment_of
from charms_bench.plugins.agent import Policy
from charms_bench.runs import shard_names
from charms_bench.runs.suite import Suite
from charms_bench.world.actions import IDLE, Actions
from charms_bench.world.kinematics_observation import Kinematics
from charms_bench.world.scene import Observations

SUITE = """\
suite: small
episodes: 8
seed: 900000000
scene: {duration_s: 8.0, traffic_vehicles: 10, density: 2.0, profile: highway-env}
egos: [{agent: outside_policy}]
traffic_models: [{traffic: {mixture: {idm_mobil: 0.5, outside_policy: 0.5}}}]
"""


class Idle(Policy):
    def decide(self, observations: Observations) -> Actions:
        return np.full(len(observations), IDLE)


@pytest.fixture(scope="module")
def minari() -> Any:
    return pytest.importorskip("minari", reason="needs the extra 'dataset'")


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> charms_bench.Run:
    folder = tmp_path_factory.mktemp("small")
    (folder / "suite.yaml").write_text(SUITE)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(shard_names, "SHARD_EPISODES", 3)  # datasets are written in three parts
        return charms_bench.run(folder / "suite.yaml", folder / "run", workers=1)


@pytest.fixture(scope="module")
def loaded(minari: Any, run: charms_bench.Run) -> Iterator[Any]:
    with pytest.MonkeyPatch.context() as patch:
        path = run.dataset("minari", run.path / "datasets" / "keep-right-v3")
        patch.setenv("MINARI_DATASETS_PATH", str(path.parent))
        yield minari.load_dataset("keep-right-v3")


def test_minari_loads_all_episodes_with_their_seeds_and_endings(
    loaded: Any, run: charms_bench.Run
) -> None:
    stored = run.episodes.sort("episode")
    assert loaded.total_episodes == 8
    assert loaded.total_steps == stored["steps"].sum()
    told = list(loaded.storage.get_episode_metadata(range(8)))
    assert [each["seed"] for each in told] == stored["episode"].to_list()
    assert [each["ending"] for each in told] == stored["ending"].to_list()
    assert (loaded.spec.dataset_name, loaded.spec.version) == ("keep-right", 3)
    assert {"time"} < set(stored["ending"]), "some crash"


def test_its_environment_gives_the_same_episodes_to_the_last_bit(loaded: Any) -> None:
    check_repeats(loaded, 8)


def check_repeats(loaded: Any, episodes: int) -> None:
    env, told_of = loaded.recover_environment(), loaded.storage.get_episode_metadata
    for episode, told in zip(loaded, told_of(range(episodes)), strict=True):
        observation, _ = env.reset(seed=int(told["seed"]))
        steps = [env.step(action) for action in episode.actions]
        observations = [observation, *(step[0] for step in steps)]
        np.testing.assert_array_equal(episode.observations, observations)
        np.testing.assert_array_equal(episode.rewards, [step[1] for step in steps])
        np.testing.assert_array_equal(episode.terminations, [step[2] for step in steps])
        np.testing.assert_array_equal(episode.truncations, [step[3] for step in steps])
        assert episode.terminations[-1] != episode.truncations[-1]


@pytest.mark.parametrize(
    "metadata",
    [
        {"actions": "continuous"},
        {"target_speed_steps_mps": "[1.0, 3.0]"},
        {"decision_hz": "5", "actions": "continuous", "history": "2"},
    ],
)
def test_continuous_actions_and_own_speed_steps_repeat_in_its_environment(
    minari: Any, network_file: Callable[..., Path], tmp_path: Path, metadata: dict[str, str]
) -> None:
    inputs, outputs = 35 * int(metadata.get("history", 1)), 2 if "actions" in metadata else 5
    weights = np.random.default_rng(1).normal(size=(inputs, outputs)) / 8
    path = network_file(np.tanh(weights) / 20, metadata=metadata)
    hz = int(metadata.get("decision_hz", 3))
    scene = {"duration_s": 4.0, "traffic_vehicles": 9, "simulation_hz": 15, "decision_hz": hz}
    suite = {"suite": "s", "episodes": 3, "scene": scene, "egos": [{"agent": str(path)}]}
    (tmp_path / "suite.yaml").write_text(
        yaml.safe_dump({**suite, "traffic_models": [{"traffic": "idm_mobil"}]})
    )
    made = charms_bench.run(tmp_path / "suite.yaml", tmp_path / "run", workers=1)
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("MINARI_DATASETS_PATH", str(tmp_path))
        made.dataset("minari", tmp_path / "own-v0")
        loaded = minari.load_dataset("own-v0")
    check_repeats(loaded, 3)
    assert loaded.action_space == loaded.recover_environment().action_space
    assert len(np.unique(np.concatenate([each.actions for each in loaded]), axis=0)) > 1


def test_its_spaces_are_those_of_its_environment(loaded: Any) -> None:
    env = loaded.recover_environment()
    assert loaded.observation_space == env.observation_space
    assert loaded.action_space == env.action_space
    assert all(each in loaded.observation_space for each in loaded[0].observations)


@pytest.mark.parametrize(
    ("traffic", "is_plain"),
    [
        ("pch", True),
        ({"mixture": {"idm_mobil": 0.5, "stackelberg": 0.5}}, True),
        ({"name": "pch", "options": {"tau": 0.3}}, False),
        ({"mixture": {"a.onnx": 1.0}}, False),
    ],
)
def test_only_a_traffic_of_plain_values_has_an_environment(traffic: Any, is_plain: bool) -> None:
    entries = {"egos": [{"agent": "charms"}], "traffic_models": [{"traffic": traffic}]}
    (cell,) = Suite.model_validate({"suite": "s", "episodes": 1, **entries}).cells
    assert (environment_of(cell, Idle()) is not None) == is_plain


def test_highway_envs_observation_is_that_of_the_environment(run: charms_bench.Run) -> None:
    shown = Kinematics(vehicles_count=3, features_range={"x": (-50.0, 50.0)})
    policy = Idle()
    policy.observation = shown
    spec = environment_of(run.suite.cells[0], policy)
    assert spec is not None
    again = gymnasium.envs.registration.EnvSpec.from_json(spec.to_json())
    env = gymnasium.make(again)
    scene = {"duration_s": 8.0, "traffic_vehicles": 10, "density": 2.0, "profile": "highway-env"}
    plain = gymnasium.make(
        ID, traffic={"idm_mobil": 0.5, "outside_policy": 0.5}, observation=shown, **scene
    )
    np.testing.assert_array_equal(env.reset(seed=5)[0], plain.reset(seed=5)[0])
    assert env.observation_space.shape == (3, 5)
