"""Stages with a prior, from simulated drivers to a fine-tuned style."""

# ruff: noqa: E402  (nothing below can be imported without the extra 'train')

import json
import signal
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy import stats
from scipy.special import softmax

torch = pytest.importorskip("torch", reason="needs the extra 'train'")
onnx = pytest.importorskip("onnx", reason="needs the extra 'train'")

from charms_agents.training import pipeline
from charms_agents.training.network_file import read_network
from charms_agents.training.stage_progress import Tell
from charms_agents.training.suite_file import load_training
from trios import busy_road, write_trio

from charms_bench.errors import SuiteError
from charms_bench.plugins.onnx_policy import OnnxPolicy
from charms_bench.world.actions import DEFAULT_ACTIONS, MetaAction, with_speed_steps
from charms_bench.world.observations import COMMANDS, Neighbours

SUITE = """\
pipeline: charms
seed: 3
observation: {type: neighbours, commands: true}
hyperparameters:
  replay_buffer: 400
  learning_starts: 40
  target_update_steps: 20
  target_update_rate: 0.5
  hidden_layers: [16]
  scenes: 4
  return_steps: 3
  batch_size: 16
  standardised: true
  starts_at_mean_reward: true
  exploration_initial: 0.02
  exploration_final: 0.02
  prior_weight: 0.2
curve_steps: 40
weights:
  safe: {safety: 1.0, efficiency: 0.8, comfort: 0.2}
conditions:
  roads: [{lanes: 3}, {lanes: 2, density: 1.5, traffic: idm_mobil}]
  roads_and_level_1: [{lanes: 3}, {lanes: 2, traffic: {mixture: {human: 0.5, level_1: 0.5}}}]
stages:
  level_1:
    steps: 160
    weights: safe
    svo: egoistic
    prior: people
    reward: {}
    scene: SCENE
    traffic: human
    conditions: roads
  style: {like: level_1, svo: prosocial, conditions: roads_and_level_1}
human:
  recordings: recordings
  samples: {labels: manoeuvre, step_mps: 0.25, idle_ratio: 100.0}
  simulated:
    agents: [human, idm_mobil]
    scene: SCENE
    traffic: human
    conditions: roads
    episodes: 4
  fine_tuning: {loss: cross_entropy, learning_rate: 1.0e-4, epochs: 2, batch_size: 16}
  imitation:
    {loss: cross_entropy, learning_rate: 1.0e-2, epochs: 3, batch_size: 16, l2_anchoring: 0.0}
  stages:
    people: {drivers: simulated, hidden_layers: [8]}
    charms_style: {fine_tunes: style}
""".replace(
    "SCENE",
    "{profile: {name: charms, target_speed_steps_mps: [0.25, 0.5, 1.0, 2.0]}, "
    "traffic_vehicles: 3, ego_slots: 2, duration_s: 5.0}",
)
STAGES = ("people", "level_1", "style", "charms_style")
SEEN = Neighbours(commands=True)


@pytest.fixture(scope="module")
def suite(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("suite")
    (folder / "recordings").mkdir()
    for number in range(1, 3):
        write_trio(folder / "recordings", busy_road(), number)
    file = folder / "train.yaml"
    file.write_text(SUITE)
    return file


@pytest.fixture(scope="module")
def finished(suite: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The run folder of a training that nothing has interrupted."""
    output = tmp_path_factory.mktemp("finished")
    pipeline.run(suite, output, workers=1)
    return output


def network_file(output: Path, name: str) -> Path:
    return output / "networks" / f"{name}.onnx"


def manifest(output: Path, name: str) -> dict[str, Any]:
    content: dict[str, Any] = json.loads(
        network_file(output, name).with_suffix(".json").read_text()
    )
    return content


def test_the_stages_lead_from_simulated_drivers_to_a_fine_tuned_style(
    suite: Path, finished: Path
) -> None:
    assert load_training(suite).order == STAGES
    made = {name: manifest(finished, name) for name in STAGES}
    assert made["people"]["starts_from"] == {"hidden_layers": [8]}
    assert made["people"]["after"]["loss"] < made["people"]["before"]["loss"]
    for name in ("level_1", "style"):
        assert made[name]["prior_sha256"] == made["people"]["onnx_sha256"]
        assert made[name]["gradient_steps"] == (160 - 40) / 2
    assert made["style"]["traffic"]["weights_sha256"]["level_1"] == made["level_1"]["onnx_sha256"]
    start = {"stage": "style", "weights_sha256": made["style"]["onnx_sha256"]}
    assert made["charms_style"]["starts_from"] == start


@pytest.mark.parametrize("name", STAGES)
def test_a_file_says_which_steps_it_has_learnt_and_draws_its_actions(
    finished: Path, name: str
) -> None:
    file = network_file(finished, name)
    model = onnx.load(file)
    says = {prop.key: prop.value for prop in model.metadata_props}
    assert json.loads(says["target_speed_steps_mps"]) == [0.25, 0.5, 1.0, 2.0]
    assert json.loads(says["observation"]) == {"type": "neighbours", "commands": True}
    assert [port.name for port in model.graph.input] == ["observations", "noise"]
    policy = OnnxPolicy(file)
    assert policy.observation == SEEN
    assert policy.actions == with_speed_steps(0.25, 0.5, 1.0, 2.0)


@pytest.mark.parametrize("name", ["people", "charms_style"])
def test_actions_are_drawn_with_the_probabilities_of_softmax(finished: Path, name: str) -> None:
    file, count = network_file(finished, name), 20_000
    rng = np.random.default_rng(0)
    seen = rng.uniform(-0.2, 0.2, size=SEEN.shape).astype(np.float32)
    seen[0, :2] = 1.0
    with torch.no_grad():
        logits = read_network(file)(torch.from_numpy(seen.reshape(1, -1))).numpy()[0]
    expected = count * softmax(logits.astype(np.float64))
    policy = OnnxPolicy(file)
    values, _ = policy.values_and_memory(np.tile(seen, (count, 1, 1)), None, rng.random((count, 5)))
    drawn = np.bincount(policy.actions_of(values), minlength=5)
    common = expected > 5  # where the chi-squared distribution holds
    groups = [np.append(each[common], each[~common].sum()) for each in (drawn, expected)]
    found, wanted = (each[: -1 if common.all() else None] for each in groups)
    assert common.sum() > 1
    assert stats.chisquare(found, wanted).pvalue > 1e-3


def test_the_prior_learns_the_commands_of_simulated_drivers_by_what_it_observes(
    finished: Path,
) -> None:
    (weight, *_) = [
        module.weight
        for module in read_network(network_file(finished, "people"))
        if isinstance(module, torch.nn.Linear)
    ]
    assert weight.shape == (8, 40)
    of_commands = weight.detach().numpy().reshape(8, 8, 5)[:, COMMANDS]
    assert (np.abs(of_commands[:, :4]).max(axis=0) > 0).all()
    assert not of_commands[:, 4].any()  # this column is always 0


@pytest.mark.parametrize(("stage", "done"), [("level_1", 80), ("people", 1), ("style", 120)])
def test_an_interrupted_training_goes_on_to_the_same_bytes(
    suite: Path, finished: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch,
    stage: str, done: int,
) -> None:  # fmt: skip
    @contextmanager
    def interrupting(*_: Any) -> Iterator[Tell]:
        def tell(title: str, reached: int, *_: Any) -> None:
            if (title, reached) == (stage, done):
                signal.raise_signal(signal.SIGINT)

        yield tell

    with monkeypatch.context() as patched:
        patched.setattr(pipeline, "progress", interrupting)
        with pytest.raises(KeyboardInterrupt):
            pipeline.run(suite, tmp_path, workers=1, only=stage)
    assert list(tmp_path.glob(f"{stage}-*/checkpoint.npz"))
    assert not list(tmp_path.glob(f"{stage}-*/*.onnx"))
    pipeline.run(suite, tmp_path, workers=1, only=stage)
    for ending in (".onnx", ".csv"):
        expected, found = (
            network_file(output, stage).with_suffix(ending) for output in (finished, tmp_path)
        )
        assert expected.read_bytes() == found.read_bytes()


def test_other_conditions_and_another_reward_are_another_stage(
    suite: Path, finished: Path, tmp_path: Path
) -> None:
    for before, after in (
        ("{lanes: 3}, {lanes: 2, density: 1.5,", "{lanes: 3}, {lanes: 2, density: 2.0,"),
        ("reward: {}", "reward: {failure_cost: 30.0}"),
    ):
        assert SUITE.count(before) == 1
        file = suite.with_name("changed.yaml")
        file.write_text(SUITE.replace(before, after))
        pipeline.run(file, tmp_path, workers=1, only="level_1")
        assert manifest(tmp_path, "level_1")["key"] != manifest(finished, "level_1")["key"]


def test_all_networks_of_a_suite_have_its_actions(suite: Path, tmp_path: Path) -> None:
    brake = "{name: BRAKE, speed_from_present_mps: -6.0}"
    listed = f"actions: [LANE_LEFT, IDLE, LANE_RIGHT, FASTER, SLOWER, {brake}]"
    file = suite.with_name("six.yaml")
    file.write_text(SUITE.replace("seed: 3\n", f"seed: 3\n{listed}\n"))
    pipeline.run(file, tmp_path, workers=1)
    six = (*DEFAULT_ACTIONS, MetaAction("BRAKE", speed_from_present_mps=-6.0))
    for name in STAGES:
        policy = OnnxPolicy(network_file(tmp_path, name))
        assert policy.actions == with_speed_steps(0.25, 0.5, 1.0, 2.0, actions=six)
        assert manifest(tmp_path, name)["actions"][5:] == [
            {"name": "BRAKE", "speed_from_present_mps": -6.0}
        ]


def test_actions_that_people_cannot_be_learnt_by_are_refused(suite: Path) -> None:
    file = suite.with_name("few.yaml")
    file.write_text(SUITE.replace("seed: 3\n", "seed: 3\nactions: [LANE_LEFT, IDLE, FASTER]\n"))
    with pytest.raises(SuiteError, match="no meta-action means only 'right'"):
        load_training(file)
    file.write_text(SUITE.replace("seed: 3\n", "seed: 3\nactions: [IDLE, {name: GO, lanes: 2}]\n"))
    with pytest.raises(SuiteError, match=r"few.yaml:3: actions: meta-action 'GO': lanes is '2'"):
        load_training(file)
