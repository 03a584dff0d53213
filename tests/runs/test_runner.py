"""Runs: the same rows whatever the workers, the order or the interruptions."""

import json
import shutil
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from run_folders import files, sign

from charms_bench.errors import AgentError, RunFolderError
from charms_bench.metrics import METRIC_SETS
from charms_bench.plugins.specs import AgentSpec, TrafficSpec
from charms_bench.runs import finished_run, runner, shard_names
from charms_bench.runs.cells import CellRows
from charms_bench.runs.finished_run import open_finished
from charms_bench.runs.resumable_folder import KINDS
from charms_bench.runs.runner import plan, run
from charms_bench.runs.shard import in_parquet
from charms_bench.runs.suite import Suite
from charms_bench.testing.parity import verify
from charms_bench.testing.verify import cases_of

pytestmark = pytest.mark.filterwarnings("ignore:.*fork.*:DeprecationWarning")
SMALL: dict[str, Any] = {
    "suite": "small",
    "episodes": 25,
    "scene": {"duration_s": 2.0, "traffic_vehicles": 5},
    "egos": [{"agent": "idm_mobil"}, {"agent": "outside_policy"}],
    "traffic_models": [{"traffic": "idm_mobil"}],
}


def suite(**changes: object) -> Suite:
    return Suite.model_validate({**SMALL, **changes})


@pytest.fixture
def small_shards(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    monkeypatch.setattr(shard_names, "SHARD_EPISODES", 10)
    return


@pytest.mark.usefixtures("small_shards")
def test_the_files_do_not_depend_on_the_number_of_workers(tmp_path: Path) -> None:
    one = run(suite(), tmp_path / "one", workers=1)
    run(suite(), tmp_path / "two", workers=2)
    assert next(iter(one.folder.manifest().items())) == ("format", 4)
    assert files(tmp_path / "one") == files(tmp_path / "two")
    assert len(files(tmp_path / "one")) == 2 + 2 * 3 * 5  # manifest, lock; 2 cells of 3 shards


@pytest.mark.usefixtures("small_shards")
def test_a_finished_shard_is_never_run_again(tmp_path: Path) -> None:
    first = run(suite(), tmp_path, workers=1)
    before = {path: path.stat().st_mtime_ns for path in tmp_path.rglob("*.parquet")}
    lost = sorted(before)[0]
    lost.unlink()
    run(suite(), tmp_path, workers=1)
    after = {path: path.stat().st_mtime_ns for path in tmp_path.rglob("*.parquet")}
    assert {path for path in before if before[path] != after[path]} <= {
        path for path in before if path.name == lost.name
    }
    assert len(first.shards) * len(KINDS) == len(after)


@pytest.mark.usefixtures("small_shards")
def test_a_cell_can_be_read_as_soon_as_all_its_shards_are_written(tmp_path: Path) -> None:
    done: list[str] = []
    read: list[tuple[int, int, int]] = []

    def on_cell(index: int, rows: CellRows) -> None:
        read.append((index, len(rows.episodes), len(done)))

    def run_again() -> None:
        run(
            suite(),
            tmp_path,
            workers=1,
            tell=lambda ego, count: done.append(ego),
            on_cell=on_cell,
        )

    run_again()
    assert read == [(0, 25, 3), (1, 25, 6)]  # each cell has three shards
    last = max((tmp_path / "checksums").iterdir())
    last.unlink()
    done.clear()
    read.clear()
    run_again()
    assert read == [(0, 25, 3), (1, 25, 6)]


@pytest.mark.usefixtures("small_shards")
def test_a_run_is_read_from_a_copy_of_its_folder_alone(tmp_path: Path) -> None:
    ran = run(suite(columns=("speed_mean",)), tmp_path / "here", workers=1)
    opened = open_finished(Path(shutil.move(tmp_path / "here", tmp_path / "there [*]")))
    assert opened.suite == ran.suite
    here = [shard.name for shard in ran.shards]
    assert [shard.name for shard in opened.shards] == here
    assert [cell.agent for cell in opened.cells()] == ["idm_mobil", "outside_policy"]


@pytest.mark.usefixtures("small_shards")
def test_a_run_that_is_not_finished_says_how_much_is_missing(tmp_path: Path) -> None:
    run(suite(), tmp_path, workers=1)
    max((tmp_path / "checksums").iterdir()).unlink()
    with pytest.raises(RunFolderError, match="20 of 25 episodes of outside_policy"):
        open_finished(tmp_path)


@pytest.mark.usefixtures("small_shards")
def test_more_episodes_add_to_what_is_there(tmp_path: Path) -> None:
    run(suite(episodes=10), tmp_path, workers=1)
    before = files(tmp_path / "episodes")
    run(suite(episodes=20), tmp_path, workers=1)
    assert before.items() <= files(tmp_path / "episodes").items()


@pytest.mark.usefixtures("small_shards")
def test_rows_of_another_run_are_taken_whatever_their_cells_are(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    run(suite(), tmp_path / "one", workers=1)
    idm, outside = SMALL["egos"]
    turned = suite(suite="turned", episodes=20, egos=[{**outside, "label": "Outside"}, idm])
    expected = run(turned, tmp_path / "simulated", workers=1)

    def simulate(work: object, tasks: list[object], *others: object) -> Iterator[None]:
        assert not tasks
        yield from ()

    monkeypatch.setattr(runner, "in_processes", simulate)
    run(turned, tmp_path / "taken", rows=tmp_path / "one")
    assert len(expected.shards) == 4
    for kind in ("episodes", "steps", "counts", "drivers"):
        assert files(tmp_path / "taken" / kind) == files(tmp_path / "simulated" / kind)


@pytest.mark.usefixtures("small_shards")
def test_what_another_run_lacks_is_simulated_and_what_is_damaged_named(tmp_path: Path) -> None:
    said: list[str] = []
    run(suite(episodes=15), tmp_path / "short", workers=1)  # whose second shard is half of ours
    lost = min((tmp_path / "short" / "counts").iterdir())
    lost.unlink()
    rows = tmp_path / "short"
    taken = run(suite(), tmp_path / "taken", workers=1, rows=rows, notice=said.append)
    what = "cannot be read: No such file or directory; its 10 episodes are not copied"
    assert said == [f"{lost}: {what}"]
    assert sum(len(cell.episodes) for cell in taken.cells()) == 50


def test_another_run_without_rows_of_the_suite_is_rejected(tmp_path: Path) -> None:
    run(suite(episodes=2), tmp_path / "one", workers=1)
    with pytest.raises(RunFolderError, match=r"one: holds no rows of this suite that can be"):
        run(suite(episodes=2, seed=7), tmp_path / "two", workers=1, rows=tmp_path / "one")


def test_another_suite_is_kept_out_of_a_folder_and_the_difference_named(tmp_path: Path) -> None:
    run(suite(episodes=2), tmp_path, workers=1)
    before = files(tmp_path)
    denser = suite(episodes=2, scene={**SMALL["scene"], "density": 1.5})
    with pytest.raises(RunFolderError, match=r"scene\.density was 1\.0, now 1\.5"):
        run(denser, tmp_path, workers=1)
    assert files(tmp_path) == before


def test_a_folder_with_something_else_in_it_is_left_alone(tmp_path: Path) -> None:
    (tmp_path / "thesis.tex").write_text("years of work")
    with pytest.raises(RunFolderError, match="is not empty and holds no run"):
        run(suite(), tmp_path, workers=1)
    assert [path.name for path in tmp_path.iterdir()] == ["thesis.tex"]


@pytest.mark.parametrize(
    ("change", "found"), [({}, "has no format"), ({"format": 2}, "has format 2")]
)
def test_a_folder_of_another_format_is_rejected_and_left_alone(
    tmp_path: Path, change: dict[str, object], found: str
) -> None:
    manifest = tmp_path / "manifest.json"
    manifest.write_text(json.dumps({**change, "charms_bench": "0.1.0", "suite": {}}))
    expected = rf"manifest\.json: {found}, expected format 4; run the suite again into another"
    for use in (open_finished, lambda path: run(suite(), path, workers=1)):
        with pytest.raises(RunFolderError, match=expected):
            use(tmp_path)
    assert {path.name for path in tmp_path.iterdir()} <= {"manifest.json", ".lock"}


@pytest.mark.usefixtures("small_shards")
def test_sums_do_not_depend_on_how_many_shards_are_read_at_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    metrics = [metric for metric_set in METRIC_SETS for metric in metric_set.metrics]
    made = run(suite(), tmp_path, workers=1)
    at_once = made.cells()[0]
    monkeypatch.setattr(finished_run, "PART_ROWS", 1)
    by_shard = made.cells()[0]
    assert [len(list(cell.parts)) for cell in (at_once, by_shard)] == [1, 3]
    sums = (cell.sums(metrics, made.suite.scene) for cell in (at_once, by_shard))
    for whole, parts in zip(*sums, strict=True):
        np.testing.assert_array_equal(parts, whole)


def test_rows_with_more_columns_are_read_and_rows_with_fewer_are_rejected(tmp_path: Path) -> None:
    finished = run(suite(episodes=2), tmp_path, workers=1)
    shard = finished.shards[0]
    files = {kind: finished.folder.read(kind, [shard]) for kind in KINDS}
    later = {kind: rows.with_columns(jerk=0.0) for kind, rows in files.items()}
    finished.folder.write(shard, {kind: in_parquet(rows) for kind, rows in later.items()})
    assert finished.cells()[0].steps.equals(files["steps"])
    fewer = files | {"steps": files["steps"].drop("lane", "speed")}
    finished.folder.write(shard, {kind: in_parquet(rows) for kind, rows in fewer.items()})
    with pytest.raises(RunFolderError, match="the columns speed, lane are missing or have other"):
        _ = finished.cells()[0].steps


@pytest.mark.usefixtures("small_shards")
def test_rows_of_other_episodes_are_neither_written_nor_read(tmp_path: Path) -> None:
    finished = run(suite(episodes=20), tmp_path, workers=1)
    folder, (first, second) = finished.folder, finished.shards[:2]
    rows = {kind: folder.read(kind, [first]) for kind in KINDS}
    wrong = {kind: in_parquet(each) for kind, each in rows.items()}
    said = "an episode is not one of 10 to 19; run the suite again"
    with pytest.raises(RunFolderError, match=said):
        folder.write(second, wrong)
    for kind, data in wrong.items():
        (tmp_path / kind / f"{second.name}.parquet").write_bytes(data)
    sign(tmp_path, second.name)
    assert not folder.is_whole(second)
    with pytest.raises(RunFolderError, match=said):
        folder.read("steps", [second])


@pytest.mark.usefixtures("small_shards")
@pytest.mark.parametrize(("workers", "failing"), [(1, 0), (1, 1), (2, 0)])
def test_a_cell_that_fails_leaves_the_others_alone(
    tmp_path: Path, workers: int, failing: int
) -> None:
    egos = [{"agent": "idm_mobil"}]
    egos.insert(failing, {"agent": "outside_raising"})
    notices: list[str] = []
    left = run(suite(egos=egos), tmp_path, workers=workers, notice=notices.append)
    assert [cell.agent for cell in left.cells()] == ["idm_mobil"]
    assert len(list((tmp_path / "episodes").glob(f"00{1 - failing}-*.parquet"))) == 3
    assert not list(tmp_path.rglob("*.partial"))
    (said,) = notices  # once, though the cell has three shards
    assert said.startswith("outside_raising in idm_mobil: agent 'outside_raising', episode ")
    with pytest.raises(RunFolderError, match="0 of 25 episodes of outside_raising"):
        open_finished(tmp_path)
    assert set(run(suite(egos=egos), tmp_path, workers=1).failed) == {failing}


def test_a_run_of_which_every_cell_fails_has_no_rows(tmp_path: Path) -> None:
    egos = [{"agent": "outside_raising"}, {"agent": "outside_raising", "label": "Again"}]
    with pytest.raises(AgentError, match="in idm_mobil: agent 'outside_raising', ep") as raised:
        run(suite(egos=egos, episodes=2), tmp_path, workers=1)
    assert [note[:5] for note in raised.value.__notes__] == ["Again"]


def test_a_shards_key_follows_the_agents_options_and_the_scene() -> None:
    def keys(**changes: object) -> set[str]:
        return {shard.key for shard in plan(suite(**changes))}

    eager = [{"agent": {"name": "stackelberg", "options": {"gain": 0.05}}}]
    calm = [{"agent": {"name": "stackelberg", "options": {"gain": 0.2}}}]
    assert not keys(egos=eager) & keys(egos=calm)
    assert not keys() & keys(scene={"lanes": 4})


def test_a_plugin_drives_highway_envs_own_vehicles_in_the_same_way() -> None:
    scene = {"duration_s": 4.0, "traffic_vehicles": 8, "density": 2.0}
    egos = [{"agent": "outside_policy"}, {"agent": "outside_model"}]
    both = suite(
        episodes=3, scene=scene, egos=egos, traffic_models=[{"traffic": "outside_traffic"}]
    )
    for found in verify(cases_of(both), range(3), workers=1):
        assert (found.episodes, found.largest, found.differences) == (3, 0.0, [])


def test_a_large_suite_makes_each_cell_agent_and_traffic_once(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    made: Counter[str] = Counter()
    for kind in (AgentSpec, TrafficSpec):

        def make(self: Any, *networks: Any, original: Any = kind.make) -> Any:
            made[str(self.name)] += 1
            return original(self, *networks)

        monkeypatch.setattr(kind, "make", make)
    egos = [{"agent": "outside_policy", "label": f"ego {k}"} for k in range(12)]
    traffics = [{"traffic": "idm_mobil", "label": f"traffic {k}"} for k in range(11)]
    large = suite(egos=egos, traffic_models=traffics)
    assert len(plan(large)) == 12 * 11
    assert made == {"outside_policy": 1, "idm_mobil": 2}  # as an agent and as a traffic
    assert large.cells[0] is large.cells[0]
