"""The training pipeline from a suite file to networks, and through being killed."""

# ruff: noqa: E402  (nothing below can be imported without the extra 'train')

import hashlib
import json
import os
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from command_line import charms_bench

pytest.importorskip("torch", reason="needs the extra 'train'")
onnx = pytest.importorskip("onnx", reason="needs the extra 'train'")

from charms_agents.training import pipeline
from charms_agents.training.stage import Interrupted
from charms_agents.training.stage_progress import Tell

from charms_bench.errors import InputError, RunFolderError
from charms_bench.plugins.onnx_policy import OnnxPolicy
from charms_bench.runs.lock import locked
from charms_bench.world.observations import paper_neighbours

SUITE = """\
pipeline: charms
seed: 3
hyperparameters:
  learning_rate: 1.0e-3
  replay_buffer: 200
  learning_starts: 60
  target_update_steps: 20
  hidden_layers: [16]
  scenes: 4
variants:
  steady:
    replay_buffer: 200
    learning_starts: 60
    target_update_steps: 20
    hidden_layers: [16]
    scenes: 4
    return_steps: 3
    target_update_rate: 0.5
    learning_rate_decay: 0.8
    standardised: true
curve_steps: 100
checkpoint_s: 1.0e-9
weights:
  plain: {safety: 1.0, efficiency: 1.0, comfort: 1.0}
stages:
  second:
    steps: 200
    variant: steady
    weights: plain
    svo: prosocial
    scene: {traffic_vehicles: 3, ego_slots: 2, duration_s: 5.0}
    traffic: first
  first:
    steps: 400
    weights: plain
    svo: egoistic
    scene: {traffic_vehicles: 3, ego_slots: 2, duration_s: 5.0}
    traffic: level_0
"""
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
pipeline.run(Path(sys.argv[1]), Path(sys.argv[2]))
"""


@pytest.fixture(scope="module")
def suite(tmp_path_factory: pytest.TempPathFactory) -> Path:
    file = tmp_path_factory.mktemp("suite") / "train.yaml"
    file.write_text(SUITE)
    return file


@pytest.fixture(scope="module")
def finished(suite: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The run folder of a training that nothing has interrupted."""
    output = tmp_path_factory.mktemp("finished")
    pipeline.run(suite, output)
    return output


def only(output: Path, pattern: str) -> Path:
    (path,) = output.glob(pattern)
    return path


def manifest(output: Path, name: str) -> dict[str, Any]:
    content: dict[str, Any] = json.loads(only(output, f"{name}-*/{name}.json").read_text())
    return content


def read(checkpoint: Path) -> dict[str, np.ndarray]:
    with np.load(checkpoint) as arrays:
        return dict(arrays)


def assert_same_training(one: Path, other: Path) -> None:
    for name in ("first", "second"):
        for file in (f"{name}.onnx", f"{name}.csv"):
            expected, found = (only(output, f"{name}-*/{file}") for output in (one, other))
            assert expected.read_bytes() == found.read_bytes()
        stored = [read(only(output, f"{name}-*/checkpoint.npz")) for output in (one, other)]
        assert stored[0].keys() == stored[1].keys()
        for key in stored[0].keys() - {"progress"}:  # which says how long it took
            np.testing.assert_array_equal(stored[0][key], stored[1][key], err_msg=key)


def test_every_stage_leaves_a_network_its_manifest_and_its_curve(finished: Path) -> None:
    for name in ("first", "second"):
        folder = only(finished, f"{name}-*")
        network = folder / f"{name}.onnx"
        written = manifest(finished, name)
        assert written["onnx_sha256"] == hashlib.sha256(network.read_bytes()).hexdigest()
        assert written["export_check"] == {"observations": 200, "ties": 0}
        assert written["gradient_steps"] == (written["steps"] - 60) / 2
        assert (folder / f"{name}.csv").exists()
        assert list((folder / "tensorboard").glob("events.*"))


def test_a_network_says_what_it_is(finished: Path) -> None:
    file = only(finished, "second-*/second.onnx")
    says = {prop.key: prop.value for prop in onnx.load(file).metadata_props}
    assert says["stage"] == "second"
    assert says["style"] == "plain, prosocial"
    assert says["decision_hz"] == "3"
    assert says["actions"] == "LANE_LEFT, IDLE, LANE_RIGHT, FASTER, SLOWER"
    observations = np.zeros((7, 7, 5), dtype=np.float32)
    assert OnnxPolicy(file).values_and_memory(observations)[0].shape == (7, 5)


def test_networks_observe_what_their_suite_names(tmp_path: Path) -> None:
    file = tmp_path / "train.yaml"
    file.write_text(SUITE.replace("seed: 3", "seed: 3\nobservation: paper_neighbours"))
    pipeline.run(file, tmp_path / "run")
    for name in ("first", "second"):
        assert manifest(tmp_path / "run", name)["observation"] == "paper_neighbours"
        network = OnnxPolicy(only(tmp_path / "run", f"{name}-*/{name}.onnx"))
        assert network.observation == paper_neighbours


def test_a_stage_drives_the_traffic_of_the_next(finished: Path) -> None:
    sha256 = manifest(finished, "first")["onnx_sha256"]
    traffic = manifest(finished, "second")["traffic"]
    assert traffic == {"agent": "first", "weights_sha256": sha256}


def test_a_finished_stage_is_not_trained_again(suite: Path, finished: Path) -> None:
    before = {path: path.stat().st_mtime_ns for path in finished.rglob("*")}
    pipeline.run(suite, finished)
    assert {path: path.stat().st_mtime_ns for path in finished.rglob("*")} == before


def test_other_settings_are_another_stage(finished: Path, tmp_path: Path) -> None:
    file = tmp_path / "train.yaml"
    file.write_text(SUITE.replace("seed: 3", "seed: 4"))
    pipeline.run(file, tmp_path, only="first")
    assert only(tmp_path, "first-*").name != only(finished, "first-*").name
    assert not list(tmp_path.glob("second-*"))


def test_options_of_the_command_replace_the_seed_and_the_steps_of_a_suite(
    suite: Path, tmp_path: Path
) -> None:
    options = ["--only", "first", "--seed", "9", "--steps", "200", "--workers", "1"]
    done = charms_bench("run", suite, "--output", tmp_path / "run", *options)
    assert done.returncode == 0, done.stderr
    said = manifest(tmp_path / "run", "first")
    assert (said["seed"], said["steps"]) == (9, 200)
    refused = charms_bench("run", "ego", "--steps", 200)
    assert "--steps is for trainings; ego is an evaluation" in refused.stderr


def test_a_training_killed_while_writing_goes_on_to_the_same_network(
    suite: Path, finished: Path, tmp_path: Path
) -> None:
    command = [sys.executable, "-c", KILLED_WHILE_WRITING, str(suite), str(tmp_path)]
    killed = subprocess.run(command, env=os.environ, capture_output=True, check=False)
    assert killed.returncode == -signal.SIGKILL, killed.stderr
    assert not list(tmp_path.glob("*/*.onnx"))
    pipeline.run(suite, tmp_path)
    assert not list(tmp_path.glob("*/.*.partial"))
    assert_same_training(finished, tmp_path)


def test_ctrl_c_leaves_a_checkpoint_to_go_on_from(
    suite: Path, finished: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    @contextmanager
    def interrupting(*_: Any) -> Iterator[Tell]:
        yield lambda _, done, *__: signal.raise_signal(signal.SIGINT) if done == 200 else None

    before = signal.getsignal(signal.SIGINT)
    with monkeypatch.context() as patched:
        patched.setattr(pipeline, "progress", interrupting)
        with pytest.raises(KeyboardInterrupt):
            pipeline.run(suite, tmp_path, only="first")
    assert signal.getsignal(signal.SIGINT) is before
    stored = read(only(tmp_path, "first-*/checkpoint.npz"))
    assert json.loads(str(stored["numbers"]))["counters"]["steps"] == 200
    pipeline.run(suite, tmp_path)
    assert_same_training(finished, tmp_path)


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


@pytest.mark.parametrize("length", [0, 100, 5000])
def test_a_broken_checkpoint_is_named(
    suite: Path, finished: Path, tmp_path: Path, length: int
) -> None:
    stored = only(finished, "first-*/checkpoint.npz")
    broken = tmp_path / stored.parent.name / stored.name
    broken.parent.mkdir()
    broken.write_bytes(stored.read_bytes()[:length])
    with pytest.raises(RunFolderError, match=r"checkpoint\.npz: not a checkpoint.*delete it"):
        pipeline.run(suite, tmp_path, only="first")


def test_a_stage_that_is_not_there_is_named(suite: Path, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no stage named 'third'; it has: second, first"):
        pipeline.run(suite, tmp_path, only="third")
