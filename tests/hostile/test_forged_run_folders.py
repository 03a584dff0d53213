"""Run folders that somebody has edited to deceive: `audit` names the edit, `run` undoes it."""

import gzip
import os
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import polars as pl
import pytest
from bad_arguments import SUITE
from bad_run_folders import forged, signed
from command_line import charms_bench
from run_folders import files, sign

import charms_bench as harness
from charms_bench.runs.resumable_folder import RunFolder

SUITES = Path(__file__).parents[2] / "suites"


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a suite and its finished run."""
    made = tmp_path_factory.mktemp("whole")
    (made / "suite.yaml").write_text(SUITE)
    answer = charms_bench("run", "suite.yaml", "--workers", 1, "--output", "run", cwd=made)
    assert answer.returncode == 0, answer.stderr
    return made


@pytest.fixture
def folder(whole: Path, tmp_path: Path) -> Path:
    made = Path(shutil.copytree(whole, tmp_path / "copy"))
    (made / "outside").mkdir()
    (made / "outside" / "mine.txt").write_text("mine")
    return made


def contents(folder: Path) -> dict[str, str]:
    return {n: each for n, each in files(folder).items() if not n.endswith((".lock", ".png"))}


def continued(folder: Path) -> int:
    return charms_bench(
        "run", "suite.yaml", "--workers", 1, "--output", "run", cwd=folder
    ).returncode


def _where(column: str, value: object) -> Callable[[pl.DataFrame], pl.DataFrame]:
    def change(rows: pl.DataFrame) -> pl.DataFrame:
        first = pl.int_range(pl.len()) == 0
        changed = pl.when(first).then(pl.lit(value)).otherwise(column)
        return rows.with_columns(changed.cast(rows.schema[column]).alias(column))

    return change


def _checksums(run: Path) -> Path:
    return next((run / "checksums").iterdir())


FORGED: dict[str, Callable[[Path], object]] = {
    "a shard of later episodes": forged(f"000-000000150-{'0' * 16}"),
    "a shard of the same episodes": forged(f"000-000000000-{'0' * 16}"),
    "a speed that is not a number": signed("steps", _where("speed", float("nan"))),
    "a step twice": signed("steps", lambda rows: pl.concat([rows, rows.tail(1)])),
    "an episode without steps": signed("steps", lambda rows: rows.filter(pl.col("episode") > 0)),
    "an ending that there is not": signed("episodes", _where("ending", "victory")),
    "more crashes than vehicles": signed("episodes", _where("traffic_crashed", 99)),
    "a bin that there is not": signed("counts", _where("bin", 30_000)),
    "a quantity that there is not": signed("counts", _where("quantity", "x")),
    "a count below 0": signed("counts", _where("count", -7)),
    "a driver with escape codes": signed("drivers", _where("agent", "\x1b[2J")),
    "a driver with times below 0": signed("drivers", _where("rss_by_s", -3.0)),
    "an ego without a driver row": signed("drivers", lambda rows: rows.filter(~pl.col("is_ego"))),
    "checksums of a file elsewhere": lambda run: _checksums(run).write_text(
        f"{_checksums(run).read_text()}{'0' * 64}  ../outside/mine.txt\n"
    ),
}  # fmt: skip


@pytest.mark.parametrize("title", FORGED)
def test_an_audit_names_what_was_forged_without_a_simulation_and_a_run_undoes_it(
    title: str, folder: Path
) -> None:
    before = contents(folder)
    FORGED[title](folder / "run")
    findings = harness.audit(folder / "run", shards=1, workers=1).findings
    assert any(each.check == "files" and each.verdict == "fail" for each in findings)
    assert contents(folder) != before
    assert continued(folder) == 0
    assert contents(folder) == before


@pytest.mark.parametrize(
    "name",
    [
        "steps",
        "checksums",
        "tables",
        "networks",
        "manifest.json",
        "tables/other.md",
        "other/file",
    ],
)
def test_nothing_behind_a_link_is_written_or_deleted(name: str, folder: Path) -> None:
    path, target = folder / "run" / name, folder / "outside" / name
    path.parent.mkdir(exist_ok=True)
    target.parent.mkdir(exist_ok=True)
    path.rename(target) if path.exists() else target.mkdir()
    path.symlink_to(target)
    for words in (("rescore", "run"), ("run", "suite.yaml", "--output", "run", "--episodes", 1)):
        before = contents(folder / "outside")
        answer = charms_bench(*words, cwd=folder)
        assert answer.returncode == 2, answer
        assert f"run/{name}: is a link; expected a file or a folder" in answer.stderr
        assert contents(folder / "outside") == before


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("replays", ("replay", "run", 0)),
        ("replays", ("what-if", "run", 0, "--at", 1, "--agent", "human")),
        ("datasets", ("dataset", "run", "--format", "parquet")),
    ],
)
def test_episodes_are_not_written_behind_a_link(
    name: str, words: tuple[Any, ...], folder: Path
) -> None:
    (folder / "run" / name).symlink_to(folder / "outside")
    before = contents(folder / "outside")
    answer = charms_bench(*words, cwd=folder)
    assert answer.returncode == 2, answer
    assert f"run/{name}: is a link; expected a file or a folder" in answer.stderr
    assert contents(folder / "outside") == before


def test_a_shorter_run_deletes_finished_episodes_only_if_told_to(folder: Path) -> None:
    before = contents(folder)
    words = ("run", "suite.yaml", "--workers", 1, "--output", "run", "--episodes", 1)
    rejected = charms_bench(*words, cwd=folder, columns=300)
    assert rejected.returncode == 2
    assert "has 1 finished shard of a run of 2 episodes, which a run of 1 would" in rejected.stderr
    assert contents(folder) == before
    assert charms_bench(*words, "--shorten", cwd=folder).returncode == 0
    assert len(harness.open_run(folder / "run").episodes) == 1


def test_rows_of_another_ego_with_fitting_checksums_are_simulated_again(
    whole: Path, folder: Path
) -> None:
    other = SUITE.replace("egos: [{agent: idm_mobil}]", "egos: [{agent: stackelberg}]")
    (folder / "other.yaml").write_text(other)
    words = ("run", "other.yaml", "--workers", 1, "--output", "other")
    assert charms_bench(*words, cwd=folder).returncode == 0
    (name,), (alien,) = (
        [path.stem for path in (folder / run / "checksums").iterdir()] for run in ("run", "other")
    )
    before = contents(folder)
    for kind in ("episodes", "steps", "drivers", "counts"):
        shutil.copy(
            folder / "other" / kind / f"{alien}.parquet", folder / "run" / kind / f"{name}.parquet"
        )
    sign(folder / "run", name)
    assert continued(folder) == 0
    assert contents(folder) == before


@pytest.mark.parametrize("name", ["manifest.json", "tables/small.csv"])
def test_a_small_file_that_would_take_gigabytes_is_rejected(name: str, folder: Path) -> None:
    bomb = b'{"a": [' + b"[]," * 2**21 + b"[]]}" if name.endswith("json") else gzip.compress(b"1")
    (folder / "run" / name).write_bytes(bomb)
    (folder / "run" / "tables" / "SHA256SUMS").unlink()
    answer = charms_bench("show", "run", cwd=folder, columns=300)
    assert answer.returncode == 2
    what = "more than 1,048,576 lists" if name.endswith("json") else "is compressed; expected"
    assert what in answer.stderr


def test_a_folder_whose_name_is_not_utf8_has_the_same_files(whole: Path, tmp_path: Path) -> None:
    strange = Path(os.fsdecode(os.fsencode(tmp_path) + b"/r\xe9sultats"))
    strange.mkdir()
    (strange / "suite.yaml").write_text(SUITE)
    assert continued(strange) == 0
    assert contents(strange) == contents(whole)
    for words in (("show", "run"), ("replay", "run", 0), ("dataset", "run", "--format", "highd")):
        answer = charms_bench(*words, cwd=strange)
        assert answer.returncode == 0, (words, answer.stderr)


def test_files_that_no_run_wrote_stay(folder: Path) -> None:
    mine = ["steps/notes.txt", ".draft.partial", "checksums/todo.sha256.old", "notes.txt"]
    shard = f"000-000000000-{'0' * 16}"
    mine += [f"steps/{shard}.parquet", f"checksums/{shard}.sha256", f"networks/{'0' * 64}.onnx"]
    (folder / "run" / "networks").mkdir(exist_ok=True)
    for name in mine:
        (folder / "run" / name).write_text("mine")
    assert continued(folder) == 0
    assert [(folder / "run" / name).read_text() for name in mine] == ["mine"] * len(mine)


def test_a_pipe_in_place_of_a_network_does_not_hang(
    network_file: Callable[..., Path], tmp_path: Path
) -> None:
    network_file()
    text = SUITE.replace("{agent: idm_mobil}", "{agent: policy.onnx}")
    (tmp_path / "suite.yaml").write_text(text)
    assert continued(tmp_path) == 0
    before = contents(tmp_path)
    (copy,) = (tmp_path / "run" / "networks").iterdir()
    copy.unlink()
    os.mkfifo(copy)
    assert continued(tmp_path) == 0
    assert contents(tmp_path) == before


def test_a_table_with_other_line_endings_is_named(folder: Path) -> None:
    table = folder / "run" / "tables" / "small.csv"
    table.write_bytes(table.read_bytes().replace(b"\n", b"\r\n"))
    answer = charms_bench("audit", "run", "--workers", 1, cwd=folder)
    assert answer.returncode == 1, answer
    assert "tables/small.csv: has other line endings" in answer.stdout


def test_a_table_that_the_suite_does_not_ask_for_is_not_read(folder: Path) -> None:
    (folder / "run" / "tables" / "small-pairs.csv").write_text("We win.")
    assert charms_bench("show", "run", cwd=folder).returncode == 0
    assert charms_bench("audit", "run", "--workers", 1, cwd=folder).returncode == 1


@pytest.mark.parametrize("words", [("show", "run"), ("report", "run", "--top", 0)])
def test_a_table_that_was_edited_is_not_shown_until_it_is_written_again(
    words: tuple[Any, ...], folder: Path
) -> None:
    table = folder / "run" / "tables" / "small.csv"
    table.write_text(table.read_text().replace("collision_rate,0", "collision_rate,0.5", 1))
    answer = charms_bench(*words, cwd=folder, columns=300)
    assert (answer.returncode, answer.stdout) == (2, "")
    assert "tables/small.csv: does not match its checksum" in answer.stderr
    assert continued(folder) == 0
    assert charms_bench(*words, cwd=folder).returncode == 0


def test_rows_that_were_edited_are_named_beside_the_tables(folder: Path) -> None:
    rows = next((folder / "run" / "steps").iterdir())
    _where("speed", 99.0)(pl.read_parquet(rows)).write_parquet(rows)
    said = f"{rows.name}: is missing or does not match its checksum; run the suite again"
    shown = charms_bench("show", "run", "--json", cwd=folder)
    assert (shown.returncode, said in shown.stderr) == (0, True)
    reported = charms_bench("report", "run", "--top", 0, cwd=folder)
    assert (reported.returncode, said in reported.stderr) == (2, True)


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("my.html", ("report", "run", "--top", 0, "--output", "my.html")),
        (
            "my.html",
            ("what-if", "run", 0, "--at", 1, "--agent", "human", "--output", "my.html"),
        ),
        ("my.gif", ("replay", "run", 0, "--output", "my.gif")),
        ("my.trajectories.parquet", ("replay", "run", 0, "--output", "my.gif")),
        ("my.xml", ("replay", "run", 0, "--commonroad", "my.xml")),
        ("my.png", ("road", SUITES / "places" / "town.json", "--figure", "my.png")),
    ],
)
def test_a_file_is_replaced_only_if_a_command_has_written_it(
    name: str, words: tuple[Any, ...], folder: Path
) -> None:
    (folder / name).write_text("mine")
    answer = charms_bench(*words, cwd=folder, columns=300)
    assert f"{name}: already exists, and charms-bench has not written it" in answer.stderr
    assert (answer.returncode, (folder / name).read_text()) == (2, "mine")
    (folder / name).unlink()
    for _ in range(2):
        answer = charms_bench(*words, cwd=folder)
        assert (answer.returncode, (folder / name).exists()) == (0, True), answer.stderr


@pytest.mark.parametrize("place", ["", "steps", "checksums"])
def test_a_folder_that_is_replaced_during_a_run_ends_it(
    place: str, folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    next((folder / "run" / "checksums").iterdir()).unlink()
    finish = RunFolder.write

    def replace_and_finish(self: Any, *of: Any) -> None:
        (folder / "run" / place).rename(folder / "moved")
        (folder / "run" / place).symlink_to(folder / "outside")
        finish(self, *of)

    monkeypatch.setattr(RunFolder, "write", replace_and_finish)
    answer = charms_bench("run", "suite.yaml", "--workers", 1, "--output", "run", cwd=folder)
    assert answer.returncode == 2
    assert "was replaced during the run" in answer.stderr or "became a link" in answer.stderr
    assert [path.name for path in (folder / "outside").iterdir()] == ["mine.txt"]


def test_a_lock_that_cannot_be_one_is_named(folder: Path) -> None:
    (folder / "run" / ".lock").unlink(missing_ok=True)
    (folder / "run" / ".lock").mkdir()
    answer = charms_bench("run", "suite.yaml", "--workers", 1, "--output", "run", cwd=folder)
    assert (answer.returncode, "run/.lock: cannot be written" in answer.stderr) == (2, True)


def test_a_report_of_a_folder_whose_name_is_not_utf8_is_written(folder: Path) -> None:
    name = os.fsdecode(b"run\xff")
    (folder / "run").rename(folder / name)
    answer = charms_bench("report", name, "--top", 0, cwd=folder)
    assert answer.returncode == 0, answer.stderr
    assert "run?" in (folder / "report.html").read_text(encoding="utf-8")


@pytest.mark.parametrize(
    ("error", "message"),
    [
        (PermissionError(13, "Permission denied", "run/steps"), "run/steps: Permission denied"),
        (MemoryError(), "not enough memory"),
        (RuntimeError("can't start new thread"), "not enough memory, or too many threads"),
    ],
)
def test_what_the_machine_does_not_permit_is_one_line(
    error: Exception, message: str, folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(*of: object) -> None:
        raise error

    monkeypatch.setattr(RunFolder, "manifest", fail)
    answer = charms_bench("show", "run", cwd=folder)
    assert (answer.returncode, answer.stderr) == (2, f"error: {message}\n")
