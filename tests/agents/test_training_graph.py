"""Stages as a graph: styles side by side, human driving, and what a run leaves behind."""

import hashlib
import json
import shutil
import signal
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import polars as pl
import pytest

pytest.importorskip("torch", reason="needs the extra 'train'")
pytest.importorskip("onnx", reason="needs the extra 'train'")

from charms_agents.training import pipeline
from charms_agents.training.schedule import _width
from charms_agents.training.stage_progress import Tell
from charms_agents.training.suite_file import load_training
from trios import busy_road, write_trio

from charms_bench.errors import DataError, InputError, RunFolderError, SuiteError
from charms_bench.plugins.onnx_policy import OnnxPolicy

SUITE = """\
pipeline: charms
hyperparameters:
  replay_buffer: 40
  learning_starts: 20
  target_update_steps: 20
  hidden_layers: [8]
  scenes: 4
curve_steps: 20
weights:
  plain: {safety: 1.0, efficiency: 1.0, comfort: 1.0}
stages:
  level_1:
    steps: 40
    weights: plain
    svo: egoistic
    scene: {traffic_vehicles: 3, ego_slots: 2, duration_s: 2.0}
    traffic: level_0
  kind: {like: level_1, svo: prosocial, traffic: level_1}
  selfish: {like: level_1, traffic: level_1}
human:
  recordings: recordings
  fine_tuning: {learning_rate: 1.0e-3, epochs: 3, batch_size: 16, l2_anchoring: 0.1}
  imitation: {learning_rate: 1.0e-2, epochs: 4, batch_size: 16, l2_anchoring: 0.0}
  stages:
    charms_kind: {fine_tunes: kind}
    charms_selfish: {fine_tunes: selfish, settings: {epochs: 2, rehearsal: 0.1}}
    imitation: {}
"""
STAGES = ("level_1", "kind", "selfish", "charms_kind", "charms_selfish", "imitation")


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
    """A run in which one stage ran at a time."""
    output = tmp_path_factory.mktemp("finished")
    pipeline.run(suite, output, workers=1)
    return output


def only(output: Path, pattern: str) -> Path:
    (path,) = output.glob(pattern)
    return path


def manifest(output: Path, name: str) -> dict[str, Any]:
    content: dict[str, Any] = json.loads(only(output, f"{name}-*/{name}.json").read_text())
    return content


def changed(suite: Path, before: str, after: str) -> Path:
    file = suite.with_name("changed.yaml")
    assert SUITE.count(before) == 1
    file.write_text(SUITE.replace(before, after))
    return file


def test_every_stage_of_the_graph_leaves_a_network(finished: Path) -> None:
    for name in STAGES:
        network = only(finished, f"{name}-*/{name}.onnx")
        made = manifest(finished, name)
        assert made["onnx_sha256"] == hashlib.sha256(network.read_bytes()).hexdigest()
        assert OnnxPolicy(network).decision_hz == 3.0
        assert list((network.parent / "tensorboard").glob("events.*"))


@pytest.fixture(scope="module")
def side_by_side(suite: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run of two seeds in which two stages ran at a time."""
    output, several = tmp_path_factory.mktemp("side-by-side"), suite.with_name("several.yaml")
    several.write_text(f"{SUITE}seeds: [0, 1]\n")
    pipeline.run(several, output, workers=2)
    return output


def test_side_by_side_the_networks_are_the_same(finished: Path, side_by_side: Path) -> None:
    same = side_by_side / "seed-0"
    for name in STAGES:
        expected, found = (only(out, f"{name}-*/{name}.onnx") for out in (finished, same))
        assert expected.read_bytes() == found.read_bytes(), name
        assert (same / "networks" / f"{name}.onnx").read_bytes() == expected.read_bytes()
        expected, found = (only(out, f"{name}-*/{name}.csv") for out in (finished, same))
        assert expected.read_text() == found.read_text(), name


def test_a_suite_of_several_seeds_trains_the_networks_of_each_seed(side_by_side: Path) -> None:
    folders = ("seed-0", "seed-1")
    for name in STAGES:
        first, second = (
            only(side_by_side / folder, f"{name}-*/{name}.onnx").read_bytes() for folder in folders
        )
        assert first != second, name
    titles = {f"{folder}/{name}" for folder in folders for name in STAGES}
    assert {*pl.read_csv(side_by_side / "stages.csv")["stage"]} == titles


def test_a_fine_tuned_network_says_where_it_started_and_what_it_changed(finished: Path) -> None:
    made = manifest(finished, "charms_kind")
    sha256 = manifest(finished, "kind")["onnx_sha256"]
    assert made["starts_from"] == {"stage": "kind", "weights_sha256": sha256}
    assert made["style"] == "plain, prosocial, fine-tuned on human driving"
    assert (made["before"]["epoch"], made["after"]["epoch"]) == (0, 3)
    assert made["after"]["loss"] < made["before"]["loss"]
    assert made["used"]["training"] > made["used"]["held_out"] > 0
    assert made["export_check"]["observations"] == sum(made["used"].values())


def test_a_stage_can_learn_by_settings_of_its_own(finished: Path) -> None:
    selfish = manifest(finished, "charms_selfish")
    assert selfish["after"]["epoch"] == 2
    # It rehearses the driving of its start in the traffic where that was trained.
    assert selfish["rehearsed"]["traffic"] == manifest(finished, "selfish")["traffic"]
    assert "rehearsed" not in manifest(finished, "charms_kind")
    assert manifest(finished, "imitation")["supervised"]["pull"] == 0.0
    assert manifest(finished, "imitation")["starts_from"] == {"hidden_layers": [8]}


def test_what_is_like_another_stage_takes_what_it_does_not_say(suite: Path) -> None:
    loaded = load_training(suite)
    kind, first = loaded.stages["kind"], loaded.stages["level_1"]
    assert (kind.svo, kind.traffic.name) == ("prosocial", "level_1")
    assert (kind.steps, kind.scene) == (first.steps, first.scene)


def test_the_curves_of_all_stages_are_in_one_table_and_one_figure(finished: Path) -> None:
    table = pl.read_csv(finished / "curves.csv", infer_schema_length=None)
    points = dict(table.group_by("stage").len().iter_rows())
    assert points == dict(zip(STAGES, (2, 2, 2, 4, 3, 5), strict=True))
    assert {"return_mean", "loss", "log_likelihood", "agreement"} <= set(table.columns)
    assert (finished / "curves.png").stat().st_size > 0


def test_all_stages_are_summed_up_in_a_table(finished: Path) -> None:
    table = pl.read_csv(finished / "stages.csv")
    assert set(table["stage"]) == set(STAGES)
    rows = {row["stage"]: row for row in table.iter_rows(named=True)}
    assert rows["kind"]["steps"] == 40
    assert rows["kind"]["steps_per_s"] == manifest(finished, "kind")["steps_per_s"]
    made = manifest(finished, "charms_kind")
    assert rows["charms_kind"]["agreement_before"] == made["before"]["agreement"]
    assert rows["charms_kind"]["log_likelihood"] == made["after"]["log_likelihood"]
    assert rows["charms_kind"]["steps"] is None


def test_nothing_finished_is_done_again(suite: Path, finished: Path) -> None:
    before = {path: path.stat().st_mtime_ns for path in finished.rglob("*")}
    pipeline.run(suite, finished, workers=2)
    assert {path: path.stat().st_mtime_ns for path in finished.rglob("*")} == before


def test_one_stage_runs_with_what_it_needs(suite: Path, tmp_path: Path) -> None:
    assert load_training(suite).needed_for("charms_kind") == ("level_1", "kind", "charms_kind")
    pipeline.run(suite, tmp_path, only="imitation")
    assert {path.name.split("-")[0] for path in tmp_path.glob("*-*")} == {"imitation"}


def test_other_recordings_are_another_stage(suite: Path, finished: Path, tmp_path: Path) -> None:
    other = tmp_path / "other"
    other.mkdir()
    for number in range(1, 3):
        write_trio(other, busy_road(), number)
    pipeline.run(suite, tmp_path, only="imitation", recordings=other)
    keys = [manifest(output, "imitation")["key"] for output in (finished, tmp_path)]
    assert keys[0] != keys[1]


def test_ctrl_c_between_epochs_goes_on_to_the_same_network(
    suite: Path, finished: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    @contextmanager
    def interrupting(*_: Any) -> Iterator[Tell]:
        yield lambda _, done, *__: signal.raise_signal(signal.SIGINT) if done == 2 else None

    with monkeypatch.context() as patched:
        patched.setattr(pipeline, "progress", interrupting)
        with pytest.raises(KeyboardInterrupt):
            pipeline.run(suite, tmp_path, only="imitation")
    assert only(tmp_path, "imitation-*/checkpoint.npz").exists()
    assert not list(tmp_path.glob("imitation-*/*.onnx"))
    pipeline.run(suite, tmp_path, only="imitation")
    networks = [only(out, "imitation-*/imitation.onnx") for out in (finished, tmp_path)]
    assert networks[0].read_bytes() == networks[1].read_bytes()


@pytest.mark.slow
def test_what_goes_wrong_in_a_process_is_said_as_it_is_here(
    suite: Path, finished: Path, tmp_path: Path
) -> None:
    for path in finished.glob("level_1-*"):
        shutil.copytree(path, tmp_path / path.name)
    broken = tmp_path / only(finished, "kind-*").name / "checkpoint.npz"
    broken.parent.mkdir()
    broken.write_bytes(b"broken")
    with pytest.raises(RunFolderError, match=r"checkpoint\.npz: not a checkpoint"):
        pipeline.run(suite, tmp_path, workers=2)


def test_stages_that_wait_for_each_other_need_one_process() -> None:
    assert _width({"a": (), "b": ("a",), "c": ("b",)}) == 1
    assert _width({"a": (), "b": ("a",), "c": ("a",), "d": ("c",)}) == 2


def test_a_missing_folder_of_recordings_names_the_field(suite: Path, tmp_path: Path) -> None:
    file = changed(suite, "recordings: recordings", "recordings: nowhere")
    expected = r"changed\.yaml:\d+: human\.recordings: no folder '.*nowhere'; .*--recordings"
    with pytest.raises(SuiteError, match=expected):
        pipeline.run(file, tmp_path)
    assert not list(tmp_path.iterdir())
    with pytest.raises(InputError, match=r"--recordings: no folder '.*away'"):
        pipeline.run(file, tmp_path, recordings=tmp_path / "away")


def test_without_a_need_for_recordings_none_are_missed(suite: Path, tmp_path: Path) -> None:
    file = changed(suite, "recordings: recordings", "recordings: nowhere")
    pipeline.run(file, tmp_path, only="level_1")
    assert only(tmp_path, "level_1-*/level_1.onnx").exists()


def test_recordings_of_no_use_are_named_before_anything_is_trained(
    suite: Path, tmp_path: Path
) -> None:
    empty = tmp_path / "empty"
    empty.mkdir()
    with pytest.raises(DataError, match="no recordings; expected files named like"):
        pipeline.run(suite, tmp_path / "run", recordings=empty)
    assert not (tmp_path / "run").exists()


@pytest.mark.parametrize(
    ("before", "after", "message"),
    [
        ("{fine_tunes: kind}", "{fine_tunes: kin}", "fine_tunes: no stage named 'kin' under"),
        (
            "    imitation: {}",
            "    kind: {}",
            "kind: another stage is also named 'kind'",
        ),
        (
            "{like: level_1, svo",
            "{like: level_2, svo",
            "kind.like: no stage named 'level_2'",
        ),
        ("{like: level_1, svo", "{like: selfish, svo", "that is not itself like another"),
        ("epochs: 2, r", "epochs: 0, r", "human.stages.charms_selfish.settings.epochs"),
        ("  recordings: recordings\n", "", "human.recordings: Field required"),
    ],
)
def test_what_is_wrong_in_the_graph_is_named_with_its_place(
    suite: Path, before: str, after: str, message: str
) -> None:
    with pytest.raises(SuiteError, match=rf"changed\.yaml:\d+: .*{message}"):
        load_training(changed(suite, before, after))
