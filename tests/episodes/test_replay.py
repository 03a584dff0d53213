"""Replays: the episodes of the run, from its folder alone."""

import json
import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import polars as pl
import pytest

from charms_bench.episodes.recorded_cell import RecordedCell, find_cells
from charms_bench.episodes.replay import TRAJECTORY_SCHEMA, _by_vehicle, replay
from charms_bench.errors import RunFolderError
from charms_bench.runs.finished_run import FinishedRun, open_finished
from charms_bench.runs.resumable_folder import KINDS
from charms_bench.runs.runner import run
from charms_bench.runs.shard import in_parquet
from charms_bench.runs.suite import Suite

SMALL = {
    "suite": "small",
    "episodes": 6,
    "seed": 10,
    "scene": {"duration_s": 3.0, "traffic_vehicles": 8},
    "egos": [{"agent": "idm_mobil"}, {"agent": "outside_policy", "label": "Keep right"}],
    "traffic_models": [{"traffic": {"mixture": {"idm_mobil": 0.5, "outside_policy": 0.5}}}],
}


@pytest.fixture(scope="module")
def finished(tmp_path_factory: pytest.TempPathFactory) -> FinishedRun:
    return run(Suite.model_validate(SMALL), tmp_path_factory.mktemp("run") / "small", workers=1)


@pytest.fixture
def copied(finished: FinishedRun, tmp_path: Path) -> FinishedRun:
    return open_finished(Path(shutil.copytree(finished.folder.path, tmp_path / "copy")))


def test_a_replay_passes_through_the_rows_of_the_run(finished: FinishedRun) -> None:
    first, second = replay(RecordedCell(finished, 1, Path()), [13, 11])
    stored = finished.cells()[1].steps
    for replayed, episode in ((first, 13), (second, 11)):
        rows = stored.filter(episode=episode)
        frames = [replayed.frame_of(step) for step in rows["step"]]
        for name in ("x", "y", "heading", "speed", "acceleration", "lane", "target_lane"):
            values = getattr(replayed, name)[frames, replayed.ego]
            np.testing.assert_array_equal(values.astype(rows[name].to_numpy().dtype), rows[name])
        assert replayed.episode == episode
        assert replayed.t_s[frames[0]] == pytest.approx(1 / 3)


def test_a_copied_run_folder_is_enough(copied: FinishedRun) -> None:
    (replayed,) = replay(RecordedCell(copied, 0, Path()), [15])
    assert replayed.cell.ego.title == "idm_mobil"
    assert replayed.t_s[-1] == 3.0


def test_each_vehicle_is_driven_by_whom_the_traffic_assigned(finished: FinishedRun) -> None:
    (replayed,) = replay(RecordedCell(finished, 1, Path()), [12])
    others = [name for k, name in enumerate(replayed.agents) if k != replayed.ego]
    rng = np.random.default_rng([12, 1])
    assert others == rng.choice(["idm_mobil", "outside_policy"], size=8, p=[0.5, 0.5]).tolist()
    assert replayed.agents[replayed.ego] == "outside_policy"


def test_trajectories_have_a_row_a_vehicle_and_simulation_step(finished: FinishedRun) -> None:
    (replayed,) = replay(RecordedCell(finished, 1, Path()), [12])
    table = replayed.trajectories()
    assert table.schema == TRAJECTORY_SCHEMA
    assert table.height == 9 * (45 + 1)
    assert table["t_s"].unique().sort().to_list() == pytest.approx(np.arange(46) / 15)
    ego = table.filter("ego")
    np.testing.assert_array_equal(ego["x"], replayed.x[:, replayed.ego])
    decided = pl.col("action").is_not_null()
    assert set(table.filter(decided)["agent"]) == {"outside_policy"}
    assert table.filter(t_s=0.0)["action"].is_null().all()


def test_an_episode_that_goes_another_way_is_rejected(copied: FinishedRun) -> None:
    shard, folder = copied.shards[0], copied.folder
    rows = folder.read("steps", [shard])
    later = (pl.col("episode") == 12) & (pl.col("step") >= 4)
    faster = pl.when(later).then(pl.col("speed") + 1).otherwise("speed").alias("speed")
    files = {kind: in_parquet(folder.read(kind, [shard])) for kind in KINDS}
    folder.write(shard, files | {"steps": in_parquet(rows.with_columns(faster))})
    with pytest.raises(
        RunFolderError, match="no longer follows the recorded trajectory: step 4, speed was"
    ):
        replay(RecordedCell(copied, 0, Path()), [12])
    assert replay(RecordedCell(copied, 0, Path()), [13])

    manifest = copied.folder.manifest()
    manifest["agents"]["idm_mobil"]["version"] = "0.0.1"
    (copied.folder.path / "manifest.json").write_text(json.dumps(manifest))
    with pytest.raises(RunFolderError, match="used other versions of idm_mobil; install those"):
        replay(RecordedCell(copied, 0, Path()), [12])


def test_an_episode_that_the_run_has_not_is_rejected(finished: FinishedRun) -> None:
    with pytest.raises(RunFolderError, match="holds the episodes 10 to 15, not 16"):
        replay(RecordedCell(finished, 0, Path()), [12, 16])


def test_cells_are_found_by_their_titles(finished: FinishedRun) -> None:
    def found(*titles: str) -> list[int]:
        return [each.index for each in find_cells(finished, Path(), *titles)]

    assert found() == [0, 1]
    assert found("Keep right") == [1]
    assert found("Keep right", "idm_mobil + outside_policy") == [1]
    with pytest.raises(RunFolderError, match=r"no ego called 'Keep left'.*Did you mean 'Keep ri"):
        found("Keep left")


def test_a_copied_run_folder_holds_the_networks_that_were_given_by_path(
    network_file: Callable[..., Path], tmp_path: Path
) -> None:
    network = network_file()
    own = {**SMALL, "egos": [{"agent": {"onnx": network.name}}], "folder": network.parent}
    run(Suite.model_validate(own), tmp_path / "run", workers=1)
    network.unlink()
    opened = open_finished(Path(shutil.move(tmp_path / "run", tmp_path / "copy")))
    assert replay(RecordedCell(opened, 0, tmp_path / "elsewhere"), [10])
    network_file(np.ones((35, 5)), name=str(next((tmp_path / "copy" / "networks").iterdir())))
    with pytest.raises(RunFolderError, match=r"\.onnx: has changed since it was written; run the"):
        replay(RecordedCell(opened, 0, tmp_path / "elsewhere"), [10])


def test_vehicles_that_have_had_the_same_place_one_after_another_have_their_own_columns() -> None:
    moments = {
        "present": np.array([[1, 1], [1, 0], [1, 1]], dtype=np.bool_),
        "entry": np.array([[0, 1], [0, 1], [0, 7]]),
        "x": np.array([[1.0, 2.0], [3.0, 4.0], [5.0, 6.0]]),
        "length": np.array([[5.0, 4.0], [5.0, 4.0], [5.0, 9.0]]),
        "width": np.full((3, 2), 2.0),
        "driver": np.array([[0, 3], [0, 3], [0, 4]]),
    }
    found = _by_vehicle(moments)
    assert found["present"].T.tolist() == [[1, 1, 1], [1, 0, 0], [0, 0, 1]]
    assert found["x"][found["present"]].tolist() == [1.0, 2.0, 3.0, 5.0, 6.0]
    assert (found["x"][~found["present"]] < -500.0).all()
    assert found["length"].tolist() == [[5.0, 4.0, 9.0]] * 3
    assert found["driver"].tolist() == [[0, 3, 4]] * 3
