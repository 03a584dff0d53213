"""Trainings from a suite file to networks: in order, side by side, and through interruptions.

One suite has a stage of each kind: an imitation of simulated drivers, stages regularised by it, one
without it, fine-tuned ones, and an imitation of recordings.
"""

import hashlib
import json
import os
import shutil
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import onnx
import polars as pl
import pytest
import torch
from charms_agents.training import pipeline, rehearsal
from charms_agents.training.network_file import read_network
from charms_agents.training.schedule import _width
from charms_agents.training.stage import Interrupted
from charms_agents.training.stage_progress import Tell
from charms_agents.training.suite_file import load_training
from command_line import charms_bench
from scipy import stats
from scipy.special import softmax
from trios import busy_road, write_trio

from charms_bench.errors import DataError, InputError, RunFolderError, SuiteError
from charms_bench.plugins.onnx_policy import OnnxPolicy
from charms_bench.runs.lock import locked
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
checkpoint_s: 1.0e-9
weights:
  safe: {safety: 1.0, efficiency: 0.8, comfort: 0.2}
conditions:
  roads: [{lanes: 3}, {lanes: 2, density: 1.5, traffic: idm_mobil}]
  roads_and_level_1: [{lanes: 3}, {lanes: 2, traffic: {mixture: {human: 0.5, level_1: 0.5}}}]
stages:
  style: {like: level_1, svo: prosocial, conditions: roads_and_level_1}
  level_1:
    steps: 160
    weights: safe
    svo: egoistic
    prior: people
    reward: {}
    scene: SCENE
    traffic: human
    conditions: roads
  plain:
    steps: 160
    weights: safe
    svo: egoistic
    scene: SCENE
    traffic: level_1
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
    charms_plain: {fine_tunes: plain, settings: {epochs: 1, batch_size: 16, rehearsal: 0.1}}
    imitation: {}
""".replace(
    "SCENE",
    "{profile: {name: charms, target_speed_steps_mps: [0.25, 0.5, 1.0, 2.0]}, "
    "traffic_vehicles: 3, ego_slots: 2, duration_s: 5.0}",
)
STAGES = ("people", "level_1", "style", "charms_style", "plain", "charms_plain", "imitation")
DRAWN = ("people", "level_1", "style", "charms_style", "imitation")
"""Stages whose networks give logits, by which actions are drawn."""
SEEN = Neighbours(commands=True)
STEPS = (0.25, 0.5, 1.0, 2.0)
KILLED_WHILE_WRITING = """
import os, signal, sys
from pathlib import Path
from charms_agents.training import pipeline
replace, calls = os.replace, []
def replace_or_die(source, target):
    calls.append(target)
    if len(calls) == 60:
        os.kill(os.getpid(), signal.SIGKILL)
    replace(source, target)
os.replace = replace_or_die
pipeline.run(Path(sys.argv[1]), Path(sys.argv[2]), only="level_1", workers=1)
"""


@pytest.fixture(scope="module")
def suite(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("suite")
    (folder / "recordings").mkdir()
    for number in range(1, 4):
        write_trio(folder / "recordings", busy_road(), number)
    file = folder / "train.yaml"
    file.write_text(SUITE)
    return file


@pytest.fixture(scope="module")
def finished(suite: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run in which one stage ran at a time, and nothing interrupted it."""
    output = tmp_path_factory.mktemp("finished")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(rehearsal, "EPISODES", 60)
        pipeline.run(suite, output, workers=1)
    return output


@pytest.fixture(scope="module")
def side_by_side(suite: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run in which two stages ran at a time, without those of recorded drivers."""
    output, some = tmp_path_factory.mktemp("side-by-side"), suite.with_name("some.yaml")
    some.write_text(SUITE.partition("    charms_style")[0])
    pipeline.run(some, output, workers=2)
    return output


def only(output: Path, pattern: str) -> Path:
    (path,) = output.glob(pattern)
    return path


def file_of(output: Path, name: str, ending: str = ".onnx") -> Path:
    return only(output, f"{name}-*/{name}{ending}")


def manifest(output: Path, name: str) -> dict[str, Any]:
    content: dict[str, Any] = json.loads(file_of(output, name, ".json").read_text())
    return content


def changed(suite: Path, before: str, after: str) -> Path:
    file = suite.with_name("changed.yaml")
    assert before in SUITE
    file.write_text(SUITE.replace(before, after, 1))
    return file


def stored(output: Path, name: str) -> dict[str, np.ndarray]:
    with np.load(file_of(output, name).with_name("checkpoint.npz")) as arrays:
        return {key: arrays[key] for key in arrays if key != "progress"}  # how long it took


def assert_same_training(one: Path, other: Path, name: str) -> None:
    for ending in (".onnx", ".csv"):
        assert file_of(one, name, ending).read_bytes() == file_of(other, name, ending).read_bytes()
    expected, found = (stored(output, name) for output in (one, other))
    assert expected.keys() == found.keys()
    for key, array in expected.items():
        np.testing.assert_array_equal(array, found[key], err_msg=key)


def test_every_stage_leaves_a_network_its_manifest_and_its_curve(finished: Path) -> None:
    for name in STAGES:
        network, made = file_of(finished, name), manifest(finished, name)
        assert made["onnx_sha256"] == hashlib.sha256(network.read_bytes()).hexdigest()
        assert made["export_check"]["observations"] > 0
        assert made["observation"] == {"type": "neighbours", "commands": True}
        assert list((network.parent / "tensorboard").glob("events.*"))
        published = finished / "networks" / network.name
        assert published.read_bytes() == network.read_bytes()
        assert published.with_suffix(".csv").exists()


def test_manifests_say_from_what_each_stage_was_made(suite: Path, finished: Path) -> None:
    made = {name: manifest(finished, name) for name in STAGES}
    sha256 = {name: each["onnx_sha256"] for name, each in made.items()}
    order = load_training(suite).order
    needs = {"level_1": "people", "style": "level_1", "charms_style": "style", "plain": "level_1"}
    assert all(order.index(needed) < order.index(name) for name, needed in needs.items())
    for name in ("level_1", "style"):
        assert made[name]["prior_sha256"] == sha256["people"]
    for name in ("level_1", "style", "plain"):
        assert made[name]["gradient_steps"] == (160 - 40) / 2
    assert made["plain"]["traffic"] == {"agent": "level_1", "weights_sha256": sha256["level_1"]}
    assert made["style"]["traffic"]["weights_sha256"]["level_1"] == sha256["level_1"]
    for name in ("style", "plain"):
        start = {"stage": name, "weights_sha256": sha256[name]}
        assert made[f"charms_{name}"]["starts_from"] == start
    assert made["charms_style"]["style"] == "safe, prosocial, fine-tuned on human driving"
    assert made["people"]["starts_from"] == {"hidden_layers": [8]}
    for conditions in (made["level_1"]["conditions"], made["people"]["simulated"]["conditions"]):
        assert conditions[1]["density"] == 1.5
    assert made["imitation"]["starts_from"] == {"hidden_layers": [16]}
    assert made["imitation"]["supervised"]["pull"] == 0.0
    # It rehearses the driving of its start in the traffic where that was trained.
    assert made["charms_plain"]["rehearsed"]["traffic"] == made["plain"]["traffic"]
    assert "rehearsed" not in made["charms_style"]


def test_stages_learn_from_samples_for_their_own_number_of_epochs(finished: Path) -> None:
    for name, epochs in (("people", 3), ("charms_style", 2), ("charms_plain", 1)):
        made = manifest(finished, name)
        assert (made["before"]["epoch"], made["after"]["epoch"]) == (0, epochs)
        assert made["after"]["loss"] < made["before"]["loss"]
        assert made["used"]["training"] > made["used"]["held_out"] > 0
        assert made["export_check"]["observations"] == sum(made["used"].values())


def test_side_by_side_the_networks_are_the_same(finished: Path, side_by_side: Path) -> None:
    names = {"people", "level_1", "style", "plain"}
    for name in names:
        assert_same_training(finished, side_by_side, name)
    assert {*pl.read_csv(side_by_side / "stages.csv")["stage"]} == names


def test_what_is_like_another_stage_takes_what_it_does_not_say(suite: Path) -> None:
    loaded = load_training(suite)
    style, first = loaded.stages["style"], loaded.stages["level_1"]
    assert (style.svo, style.traffic.name) == ("prosocial", "human")
    assert (style.steps, style.scene) == (first.steps, first.scene)


def test_curves_and_stages_are_summed_up_in_tables_and_a_figure(finished: Path) -> None:
    curves = pl.read_csv(finished / "curves.csv", infer_schema_length=None)
    points = dict(curves.group_by("stage").len().iter_rows())
    assert points == dict(zip(STAGES, (4, 4, 4, 3, 4, 2, 4), strict=True))
    assert {"return_mean", "loss", "log_likelihood", "agreement"} <= set(curves.columns)
    assert (finished / "curves.png").stat().st_size > 0
    rows = {row["stage"]: row for row in pl.read_csv(finished / "stages.csv").iter_rows(named=True)}
    assert rows.keys() == {*STAGES}
    style, made = manifest(finished, "style"), manifest(finished, "charms_style")
    assert (rows["style"]["steps"], rows["charms_style"]["steps"]) == (160, None)
    assert rows["style"]["steps_per_s"] == style["steps_per_s"]
    assert rows["charms_style"]["agreement_before"] == made["before"]["agreement"]
    assert rows["charms_style"]["log_likelihood"] == made["after"]["log_likelihood"]


@pytest.mark.parametrize("name", STAGES)
def test_a_file_says_which_steps_it_has_learnt_and_whether_it_draws_its_actions(
    finished: Path, name: str
) -> None:
    file = file_of(finished, name)
    model = onnx.load(file)
    says = {prop.key: prop.value for prop in model.metadata_props}
    assert (says["stage"], says["decision_hz"]) == (name, "3")
    assert json.loads(says["observation"]) == {"type": "neighbours", "commands": True}
    inputs = ["observations", *["noise"] * (name in DRAWN)]
    assert [port.name for port in model.graph.input] == inputs
    policy = OnnxPolicy(file)
    if name == "imitation":  # it learns from recordings, which have no profile
        assert says["actions"] == "LANE_LEFT, IDLE, LANE_RIGHT, FASTER, SLOWER"
        assert (policy.observation, policy.actions) == (SEEN, DEFAULT_ACTIONS)
    else:
        assert json.loads(says["target_speed_steps_mps"]) == [*STEPS]
        assert (policy.observation, policy.actions) == (SEEN, with_speed_steps(*STEPS))


@pytest.mark.parametrize("name", ["people", "charms_style"])
def test_actions_are_drawn_with_the_probabilities_of_softmax(finished: Path, name: str) -> None:
    file, count = file_of(finished, name), 20_000
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
    weight = next(read_network(file_of(finished, "people")).parameters())
    assert weight.shape == (8, 40)
    of_commands = weight.detach().numpy().reshape(8, 8, 5)[:, COMMANDS]
    assert (np.abs(of_commands[:, :4]).max(axis=0) > 0).all()
    assert not of_commands[:, 4].any()  # this column is always 0


def test_nothing_finished_is_done_again(suite: Path, finished: Path) -> None:
    before = {path: path.stat().st_mtime_ns for path in finished.rglob("*")}
    pipeline.run(suite, finished, workers=2)
    assert {path: path.stat().st_mtime_ns for path in finished.rglob("*")} == before


def test_one_stage_runs_with_what_it_needs(suite: Path, tmp_path: Path) -> None:
    needed = ("people", "level_1", "style", "charms_style")
    assert load_training(suite).needed_for("charms_style") == needed
    file = changed(suite, "recordings: recordings", "recordings: nowhere")  # which it does not need
    pipeline.run(file, tmp_path, only="people")
    assert {path.name.split("-")[0] for path in tmp_path.glob("*-*")} == {"people"}
    with pytest.raises(InputError, match="no stage named 'third'; it has: style, level_1, plain,"):
        pipeline.run(suite, tmp_path, only="third")


@pytest.mark.parametrize(
    ("name", "before", "after"),
    [
        ("people", "seed: 3", "seed: 4"),
        ("people", "agents: [human, idm_mobil]", "agents: [human]"),
        ("level_1", "density: 1.5", "density: 2.0"),
        ("level_1", "reward: {}", "reward: {failure_cost: 30.0}"),
    ],
)
def test_another_value_is_another_stage(
    suite: Path, finished: Path, tmp_path: Path, name: str, before: str, after: str
) -> None:
    pipeline.run(changed(suite, before, after), tmp_path, workers=1, only=name)
    assert manifest(tmp_path, name)["key"] != manifest(finished, name)["key"]


def test_other_recordings_are_another_stage(suite: Path, finished: Path, tmp_path: Path) -> None:
    other = tmp_path / "other"
    other.mkdir()
    write_trio(other, busy_road(), 1)
    pipeline.run(suite, tmp_path, only="imitation", recordings=other)
    assert manifest(tmp_path, "imitation")["key"] != manifest(finished, "imitation")["key"]


def test_options_of_the_command_replace_the_seed_and_the_steps_of_a_suite(
    suite: Path, tmp_path: Path
) -> None:
    options = ["--only", "level_1", "--seed", "9", "--steps", "80", "--workers", "1"]
    done = charms_bench("run", suite, "--output", tmp_path / "run", *options)
    assert done.returncode == 0, done.stderr
    said = manifest(tmp_path / "run", "level_1")
    assert (said["seed"], said["steps"]) == (9, 80)
    rejected = charms_bench("run", "ego", "--steps", 200)
    assert "--steps is for trainings; ego is an evaluation" in rejected.stderr


def test_a_training_killed_while_writing_goes_on_to_the_same_network(
    suite: Path, finished: Path, tmp_path: Path
) -> None:
    command = [sys.executable, "-c", KILLED_WHILE_WRITING, str(suite), str(tmp_path)]
    killed = subprocess.run(command, env=os.environ, capture_output=True, check=False)
    assert killed.returncode == -signal.SIGKILL, killed.stderr
    assert list(tmp_path.glob("level_1-*/checkpoint.npz"))
    assert not list(tmp_path.glob("level_1-*/*.onnx"))
    pipeline.run(suite, tmp_path, only="level_1", workers=1)
    assert not list(tmp_path.glob("*/.*.partial"))
    assert_same_training(finished, tmp_path, "level_1")


@pytest.mark.parametrize(
    ("stage", "done"), [("level_1", 80), ("people", 1), ("plain", 120), ("imitation", 2)]
)
def test_ctrl_c_leaves_a_checkpoint_to_go_on_from(
    suite: Path, finished: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch,
    stage: str, done: int,
) -> None:  # fmt: skip
    @contextmanager
    def interrupting(*_: Any) -> Iterator[Tell]:
        def tell(title: str, reached: int, *_: Any) -> None:
            if (title, reached) == (stage, done):
                signal.raise_signal(signal.SIGINT)

        yield tell

    before = signal.getsignal(signal.SIGINT)
    with monkeypatch.context() as patched:
        patched.setattr(pipeline, "progress", interrupting)
        with pytest.raises(KeyboardInterrupt):
            pipeline.run(suite, tmp_path, workers=1, only=stage)
    assert signal.getsignal(signal.SIGINT) is before
    assert list(tmp_path.glob(f"{stage}-*/checkpoint.npz"))
    assert not list(tmp_path.glob(f"{stage}-*/*.onnx"))
    pipeline.run(suite, tmp_path, workers=1, only=stage)
    assert_same_training(finished, tmp_path, stage)


def test_sigterm_waits_for_a_checkpoint_and_then_does_what_it_would_have_done() -> None:
    before = signal.signal(signal.SIGTERM, signal.default_int_handler)
    stops = []

    def train(stop: Callable[[], bool]) -> None:
        stops.append(stop())
        signal.raise_signal(signal.SIGTERM)
        stops.append(stop())
        raise Interrupted

    try:
        with pytest.raises(KeyboardInterrupt), pipeline._stop_on_signals() as stop:
            train(stop)
        assert signal.getsignal(signal.SIGTERM) is signal.default_int_handler
    finally:
        signal.signal(signal.SIGTERM, before)
    assert stops == [False, True]


def test_a_training_keeps_out_of_a_folder_in_use(suite: Path, tmp_path: Path) -> None:
    with locked(tmp_path), pytest.raises(RunFolderError, match="another run is using this folder"):
        pipeline.run(suite, tmp_path)
    assert [path.name for path in tmp_path.iterdir()] == [".lock"]


@pytest.mark.parametrize(
    ("length", "workers"),
    [(0, 1), (100, 1), (5000, 1), pytest.param(100, 2, marks=pytest.mark.slow)],
)
def test_a_broken_checkpoint_is_named(
    suite: Path, finished: Path, tmp_path: Path, length: int, workers: int
) -> None:
    for name in ("people", "level_1"):
        shutil.copytree(
            file_of(finished, name).parent, tmp_path / file_of(finished, name).parts[-2]
        )
    stage = file_of(tmp_path, "level_1").parent
    (stage / "level_1.json").unlink()
    whole = (stage / "checkpoint.npz").read_bytes()
    (stage / "checkpoint.npz").write_bytes(whole[:length])
    with pytest.raises(RunFolderError, match=r"checkpoint\.npz: not a checkpoint.*delete it"):
        pipeline.run(suite, tmp_path, only="level_1" if workers == 1 else None, workers=workers)


def test_the_checkpoint_of_another_stage_is_not_continued(
    suite: Path, finished: Path, tmp_path: Path
) -> None:
    folder = tmp_path / file_of(finished, "people").parts[-2]
    folder.mkdir()
    shutil.copy(file_of(finished, "imitation").with_name("checkpoint.npz"), folder)
    with pytest.raises(RunFolderError, match="cannot be continued: it was written with other set"):
        pipeline.run(suite, tmp_path, only="people", workers=1)


def test_stages_that_wait_for_each_other_need_one_process() -> None:
    assert _width({"a": (), "b": ("a",), "c": ("b",)}) == 1
    assert _width({"a": (), "b": ("a",), "c": ("a",), "d": ("c",)}) == 2


def test_recordings_that_are_missing_or_of_no_use_are_named_before_anything_is_trained(
    suite: Path, tmp_path: Path
) -> None:
    file, run, empty = changed(suite, ": recordings", ": nowhere"), tmp_path / "run", tmp_path / "e"
    expected = r"changed\.yaml:\d+: human\.recordings: no folder '.*nowhere'; .*--recordings"
    empty.mkdir()
    with pytest.raises(SuiteError, match=expected):
        pipeline.run(file, run)
    with pytest.raises(InputError, match=r"--recordings: no folder '.*away'"):
        pipeline.run(file, run, recordings=tmp_path / "away")
    with pytest.raises(DataError, match="no recordings; expected files named like"):
        pipeline.run(file, run, recordings=empty)
    assert not run.exists()


def test_all_networks_of_a_suite_have_its_actions(suite: Path, tmp_path: Path) -> None:
    brake = "{name: BRAKE, speed_from_present_mps: -6.0}"
    listed = f"actions: [LANE_LEFT, IDLE, LANE_RIGHT, FASTER, SLOWER, {brake}]"
    pipeline.run(changed(suite, "seed: 3\n", f"seed: 3\n{listed}\n"), tmp_path, only="charms_style")
    six = (*DEFAULT_ACTIONS, MetaAction("BRAKE", speed_from_present_mps=-6.0))
    for name in ("people", "level_1", "style", "charms_style"):
        policy = OnnxPolicy(file_of(tmp_path, name))
        assert policy.actions == with_speed_steps(*STEPS, actions=six)
        last = {"name": "BRAKE", "speed_from_present_mps": -6.0}
        assert manifest(tmp_path, name)["actions"][5:] == [last]


@pytest.mark.parametrize(
    ("before", "after", "message"),
    [
        ("fine_tunes: style", "fine_tunes: styl", "fine_tunes: no stage named 'styl' under"),
        ("    imitation: {}", "    style: {}", "style: another stage is also named 'style'"),
        ("{like: level_1", "{like: level_2", "style.like: no stage named 'level_2'"),
        ("  plain:\n    steps: 160", "  plain:\n    like: style", "not itself like another"),
        ("epochs: 1,", "epochs: 0,", "human.stages.charms_plain.settings.epochs"),
        ("  recordings: recordings\n", "", "human.recordings: Field required"),
        ("seed: 3", "actions: [LANE_LEFT, IDLE, FASTER]", "no meta-action means only 'right'"),
        ("seed: 3", "actions: [IDLE, {name: GO, lanes: 2}]", "meta-action 'GO': lanes is '2'"),
    ],
)
def test_what_is_wrong_in_the_stages_is_named_with_its_place(
    suite: Path, before: str, after: str, message: str
) -> None:
    with pytest.raises(SuiteError, match=rf"changed\.yaml:\d+: .*{message}"):
        load_training(changed(suite, before, after))
