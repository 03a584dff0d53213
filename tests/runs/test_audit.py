"""`charms-bench audit`: a true run is true, and each falsification is named."""

import hashlib
import json
import shutil
import subprocess
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl
import pytest
from command_line import Called, charms_bench
from linear_network import linear_network
from run_folders import sign

import charms_bench as harness
from charms_bench.runs import audit_software
from charms_bench.runs.code_hashes import SOURCES, commit, library_versions, module_blobs

MINE = {"distribution": "my-plugins", "version": "0.1.0"}
SUITE = """\
suite: small
episodes: 160
scene: {duration_s: 2.0, traffic_vehicles: 5}
egos: [{agent: idm_mobil, label: IDM}, {agent: policy.onnx, label: Net}]
traffic_models: [{traffic: idm_mobil}]
"""
RARE = """\
suite: small
episodes: 1
scene: {duration_s: 1.0, traffic_vehicles: 5}
egos: [{agent: idm_mobil}]
traffic_models: [{traffic: idm_mobil}]
"""


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A finished run of four shards, unaltered."""
    folder = tmp_path_factory.mktemp("whole")
    (folder / "suite.yaml").write_text(SUITE)
    for seed, name in enumerate(("policy", "other")):
        weights = np.random.default_rng(seed).normal(size=(35, 5))
        linear_network(folder / f"{name}.onnx", weights)
    made = charms_bench("run", "suite.yaml", "--workers", 1, "--output", "run", cwd=folder)
    assert made.returncode == 0, made.stderr
    return folder


@pytest.fixture
def folder(whole: Path, tmp_path: Path) -> Path:
    shutil.copytree(whole, tmp_path / "copy")
    return tmp_path / "copy"


def audited(folder: Path, *more: object) -> Called:
    before = contents(folder / "run")
    answer = charms_bench("audit", "run", "--all", "--workers", 1, *more, cwd=folder)
    assert contents(folder / "run") == before, "an audit must not change the folder"
    return answer


def contents(run: Path) -> dict[Path, bytes]:
    files = (path for path in run.rglob("*") if path.is_file() and path.name != ".lock")
    return {path: path.read_bytes() for path in files}


def change_manifest(folder: Path, change: Callable[[dict[str, Any]], object]) -> None:
    path = folder / "run" / "manifest.json"
    manifest = json.loads(path.read_text())
    change(manifest)
    path.write_text(json.dumps(manifest))


def shard(folder: Path, kind: str, cell: int = 0) -> Path:
    return min((folder / "run" / kind).glob(f"{cell:03d}-*.parquet"))


def rename_shard(folder: Path, name: str, new: str) -> None:
    """Gives a shard another name, and checksums that fit."""
    run = folder / "run"
    for kind in ("steps", "counts", "drivers", "episodes"):
        (run / kind / f"{name}.parquet").rename(run / kind / f"{new}.parquet")
    old = run / "checksums" / f"{name}.sha256"
    old.with_stem(new).write_text(old.read_text().replace(name, new))
    old.unlink()


def change_digit(folder: Path) -> str:
    """Changes the last digit of a value in the table of metrics; returns what is expected."""
    table = folder / "run" / "tables" / "small.csv"
    lines = table.read_text().splitlines(keepends=True)
    at = next(k for k, line in enumerate(lines) if ",dhw_mean," in line)
    was = lines[at].split(",")[4]
    now = was[:-1] + str((int(was[-1]) + 1) % 10)
    lines[at] = lines[at].replace(was, now, 1)
    table.write_text("".join(lines))
    return f"value is {now}; computed again, {was}"


def test_a_true_run_is_true(folder: Path) -> None:
    answer = audited(folder)
    assert answer.returncode == 0, answer
    assert "with a probability" not in answer.stdout
    assert "4 of 4 shards, simulated again, have the same rows" in answer.stdout
    assert "run: everything that was checked passes" in answer.stdout


def test_a_sample_is_drawn_anew_each_time_and_can_be_asked_for(folder: Path) -> None:
    found = [audit_of(folder, shards=1, workers=1).findings for _ in range(2)]
    seeds = {each.what for findings in found for each in findings if each.check == "rows"}
    assert len(seeds) == 2
    again = audit_of(folder, shards=1, seed=7, workers=1)
    assert again.verdict == "pass"
    assert "1 of 4 shards" in again.table.records()[-2]["found"]
    assert "seed 7" in again.table.records()[-2]["found"]


def audit_of(folder: Path, **options: Any) -> Any:
    return harness.open_run(folder / "run").audit(**options)


def test_the_verdict_says_how_likely_a_false_shard_was_missed(folder: Path) -> None:
    answer = charms_bench("audit", "run", "--shards", 1, "--workers", 1, cwd=folder)
    assert answer.returncode == 0, answer
    verdict = answer.stdout.splitlines()[-1]  # 3 of 4 shards are not drawn
    assert verdict.endswith("; if one shard is false, it was missed with a probability of 75%")
    assert audit_of(folder, shards=3, workers=1).undrawn == 0.25


def add(name: str) -> Callable[[Path], None]:
    """Adds a file of nothing to the run folder."""

    def change(folder: Path) -> None:
        (folder / "run" / name).parent.mkdir(exist_ok=True)
        (folder / "run" / name).write_text("x")

    return change


def link(name: str) -> Callable[[Path], None]:
    def change(folder: Path) -> None:
        path = folder / "run" / name
        path.rename(folder / path.name)
        path.symlink_to(folder / path.name)

    return change


def manifest(**fields: object) -> Callable[[Path], None]:
    return lambda folder: change_manifest(folder, lambda each: each.update(fields))


def page(name: str) -> Callable[[Path], None]:
    """Changes a digit of a table that people read."""

    def change(folder: Path) -> None:
        path = folder / "run" / "tables" / name
        path.write_text(path.read_text().replace("0", "1", 1))

    return change


def row(is_signed: bool) -> Callable[[Path], None]:
    """Changes the speed in the second row of step rows, and perhaps the checksum."""

    def change(folder: Path) -> None:
        path = shard(folder, "steps")
        rows, second = pl.read_parquet(path), pl.int_range(pl.len()) == 1
        speed = pl.when(second).then(40.0).otherwise("speed").alias("speed")
        rows.with_columns(speed).write_parquet(path)
        if is_signed:
            sign(folder / "run", path.stem)

    return change


def rows_and_tables(folder: Path) -> None:
    path = shard(folder, "episodes")
    pl.read_parquet(path).with_columns(duration_s=1.0).write_parquet(path)
    sign(folder / "run", path.stem)
    assert charms_bench("rescore", "run", cwd=folder).returncode == 0


def column(folder: Path) -> None:
    path = shard(folder, "steps")
    pl.read_parquet(path).with_columns(note=pl.lit("We win.")).write_parquet(path)
    sign(folder / "run", path.stem)


def other_network(folder: Path) -> None:
    (copy,) = (folder / "run" / "networks").iterdir()
    shutil.copy(folder / "other.onnx", copy)


def other_network_in_the_manifest(folder: Path) -> None:
    (copy,) = (folder / "run" / "networks").iterdir()
    copy.unlink()
    sha256 = hashlib.sha256((folder / "other.onnx").read_bytes()).hexdigest()
    shutil.copy(folder / "other.onnx", folder / "run" / "networks" / f"{sha256}.onnx")
    change_manifest(
        folder, lambda each: each["agents"]["policy.onnx"].update(weights_sha256=sha256)
    )


def missing_checksums(folder: Path) -> None:
    (folder / "run" / "checksums" / f"{shard(folder, 'counts').stem}.sha256").unlink()


def twice(folder: Path) -> None:
    """Adds a copy of a shard with another key."""
    name = shard(folder, "steps").stem
    shutil.copytree(folder / "run", folder / "copy")
    rename_shard(folder, name, f"{name[:-16]}{'0' * 16}")
    shutil.copytree(folder / "copy", folder / "run", dirs_exist_ok=True)


def other_keys(folder: Path) -> None:
    """Gives every shard a key as of other software."""
    for path in sorted((folder / "run" / "checksums").iterdir()):
        rename_shard(folder, path.stem, f"{path.stem.rpartition('-')[0]}-{'0' * 16}")


def another_commit(folder: Path) -> None:
    other_keys(folder)
    modules = module_blobs() | {"charms_bench.plugins.traffic": "0" * 40}
    manifest(modules=modules, commit="1234abcd")(folder)


def other_libraries_and_agents(folder: Path) -> None:
    other_keys(folder)
    agents = json.loads((folder / "run" / "manifest.json").read_text())["agents"]
    agents["idm_mobil"]["code_sha256"] = "0" * 64
    manifest(versions=library_versions() | {"numpy": "1.0"}, agents=agents)(folder)


def other_code(folder: Path) -> None:
    """Changes a digit, and the manifest so that other code may have written it."""
    change_digit(folder)
    modules = module_blobs() | {"charms_bench.report.markdown": "0" * 40}
    manifest(modules=modules, commit="1234abcd")(folder)


def other_metrics(folder: Path) -> None:
    tables = folder / "run" / "tables"
    (tables / "small.csv").write_text((tables / "small.csv").read_text().replace("paper-2", "x"))
    (tables / "small-drivers.csv").write_text("We win.")


EDITS: dict[str, tuple[Callable[[Path], object], int, Sequence[str]]] = {
    "a digit of a table": (
        change_digit, 1, ["fail     tables    tables/small.csv: IDM, idm_mobil, paper-2, dhw_mean:"]
    ),
    "a digit of a page": (page("small-drivers.md"), 1, ["tables/small-drivers.md: line "]),
    "a digit that other code may have written": (
        other_code, 3, ["unknown  tables    tables/small.csv: IDM, idm_mobil, paper-2, dhw_mean:"]
    ),
    "other metrics, which leave the other tables checked": (
        other_metrics,
        1,
        ["metric_set is x; computed again, paper-2", "small-drivers.csv: line 1 is 'We win.'"],
    ),
    "a row": (
        row(is_signed=False), 1, ["speed is 40.0; simulated again", "not match its checksum"]
    ),
    "a row with its checksum": (row(is_signed=True), 1, ["row 2 (episode 0, step 2): speed is 40"]),
    "rows and tables": (
        rows_and_tables, 1, ["row 1 (episode 0): duration_s is 1.0; simulated again, 2.0"]
    ),
    "a column that no run writes": (
        column, 1, ["the rows are the same, but the file has other bytes"]
    ),
    "a network": (other_network, 1, ["not the one in its name, which is policy.onnx"]),
    "a network, everywhere but in the rows": (
        other_network_in_the_manifest, 1, ["has a key of other software, agents or settings"]
    ),
    "a missing shard": (
        missing_checksums,
        1,
        [
            "is not of a finished shard",
            "the rows of IDM in idm_mobil, episodes 0 to 149 are missing",
        ],
    ),
    "a shard twice": (twice, 1, [f"has the episodes of 000-000000000-{'0' * 16}\n"]),
    "a table of something else": (
        add("tables/best.md"), 1, ["tables/best.md: is not a table of this suite"]
    ),
    "a file in tables": (add("tables/more/x.md"), 1, ["fail     files     tables/more/x.md: is"]),
    "a file in networks": (add("networks/x.onnx"), 1, ["fail     files     networks/x.onnx: is"]),
    "a file in steps": (add("steps/x.txt"), 1, ["fail     files     steps/x.txt: is not of a"]),
    "a file of nothing": (add("notes.txt"), 3, ["unknown  files     notes.txt: is not a file of"]),
    "what readers made": (add("replays/x.gif"), 0, ["everything that was checked passes"]),
    "a link to a table": (link("tables/small.csv"), 1, ["tables/small.csv: is a link, not a file"]),
    "a link to rows": (link("steps"), 1, ["steps: is a link, not a file"]),
    "a link to the manifest": (link("manifest.json"), 1, ["manifest.json: is a link, not a file"]),
    "the hash of the suite": (manifest(suite_sha256="0" * 64), 1, ["suite_sha256: is '000"]),
    "the version of a metric set": (
        manifest(metric_sets={"paper": 9}), 1, ["metric_sets.paper: is 9; the code of the run"]
    ),
    "no code": (manifest(modules={}), 3, ["the manifest does not name the code of the run"]),
    "another commit": (
        another_commit,
        3,
        [
            "modules: charms_bench.plugins.traffic is not the code of the run, which was charms-",
            f"bench {harness.__version__}; to check its rows, install commit 1234abcd",
            "none can be simulated again",
        ],
    ),
    "other libraries and agents": (
        other_libraries_and_agents,
        3,
        [
            f"libraries: numpy is {np.__version__}, expected 1.0; install these",
            "idm_mobil: is not the agent of the run: code_sha256 is ",
            "none can be simulated again",
        ],
    ),
}  # fmt: skip


@pytest.mark.parametrize("title", EDITS)
def test_what_was_changed_is_named(title: str, folder: Path) -> None:
    edit, code, said = EDITS[title]
    expected = edit(folder)
    answer = audited(folder)
    assert answer.returncode == code, answer
    assert [each for each in said if each not in answer.stdout] == []
    assert not isinstance(expected, str) or expected in answer.stdout
    assert code == 1 or "fail " not in answer.stdout


def test_a_table_of_other_thresholds_is_true(folder: Path) -> None:
    words = ("rescore", "run", "--set", "standard:ttc_s=2")
    assert charms_bench(*words, cwd=folder).returncode == 0
    assert audited(folder).returncode == 0


def swap_shards(folder: Path, one: Path, other: Path) -> None:
    """Gives two shards each other's rows, and checksums that fit."""
    for kind in ("steps", "counts", "drivers", "episodes"):
        files = [folder / "run" / kind / path.name for path in (one, other)]
        contents = [file.read_bytes() for file in files]
        for file, content in zip(files, reversed(contents), strict=True):
            file.write_bytes(content)
    for path in (one, other):
        sign(folder / "run", path.stem)


@pytest.mark.parametrize("of", ["episodes", "egos"])
def test_swapped_shards_are_named_without_a_simulation_and_undone_by_a_run(
    of: str, folder: Path
) -> None:
    before = contents(folder / "run")
    first, second = sorted((folder / "run" / "steps").glob("000-*"))
    other = second if of == "episodes" else shard(folder, "steps", 1)
    swap_shards(folder, first, other)
    findings = audit_of(folder, shards=1, workers=1).findings
    found = {each.where: each.what for each in findings if each.check == "files"}
    if of == "episodes":
        where, what = f"episodes/{first.name}", "an episode is not one of 0 to 149"
    else:
        (network,) = (folder / "run" / "networks").iterdir()
        where, what = f"checksums/{first.stem}.sha256", f"the ego is {network.name}, expected idm"
    assert what in found[where]
    for command in ("edge-cases", "rescore"):
        read = charms_bench(command, "run", cwd=folder)
        assert (read.returncode, what.partition(",")[0] in read.stderr) == (2, True), read
    made = charms_bench("run", "suite.yaml", "--workers", 1, "--output", "run", cwd=folder)
    assert made.returncode == 0, made.stderr
    assert contents(folder / "run") == before


def test_the_hash_of_a_module_is_that_of_git(tmp_path: Path) -> None:
    hashed = module_blobs()["charms_bench.errors"]
    file = SOURCES / "charms_bench" / "errors.py"
    done = subprocess.run(
        ["git", "hash-object", str(file)], capture_output=True, text=True, check=True
    )
    assert done.stdout.strip() == hashed


def test_the_commit_of_a_checkout_is_that_of_git() -> None:
    if not (SOURCES / ".git").exists():
        pytest.skip("needs a checkout")
    git = ["git", "-C", str(SOURCES)]
    asked = (["status", "--porcelain", "charms_bench"], ["rev-parse", "HEAD"])
    edited, head = (
        subprocess.run([*git, *words], capture_output=True, text=True, check=True).stdout.strip()
        for words in asked
    )
    assert commit() == ("" if edited else head)


def test_an_estimation_of_a_rare_event_is_checked_as_far_as_that_goes(tmp_path: Path) -> None:
    (tmp_path / "suite.yaml").write_text(RARE)
    words = ("--runs", 5, "--samples", 100, "--workers", 1, "--output", "run")
    made = charms_bench("rare", "suite.yaml", *words, cwd=tmp_path)
    assert made.returncode == 0, made.stderr
    answer = audited(tmp_path)
    assert answer.returncode == 3
    assert "the files of all runs match the hashes in them" in answer.stdout
    path = min((tmp_path / "run" / "runs").iterdir())
    path.write_text(path.read_text().replace("1", "2", 1))
    assert audited(tmp_path).returncode == 1


def test_a_folder_without_a_run_is_rejected(tmp_path: Path) -> None:
    (tmp_path / "run").mkdir()
    answer = charms_bench("audit", "run", cwd=tmp_path)
    assert answer.returncode == 2
    assert "holds no evaluation (manifest.json)" in answer.stderr


def test_a_missing_plugin_is_named_by_its_distribution() -> None:
    recorded = {
        "idm_mobil": {"distribution": "charms-bench", "version": "1"},
        '{"name": "overtaker", "options": {"gap_m": 3}}': MINE,
        "traffic rush_hour": MINE,
    }
    for name in ("overtaker", "rush_hour"):
        said = audit_software._remedy(f"no agent named '{name}'. Known: idm_mobil.", recorded)
        assert said == f" '{name}' was of my-plugins 0.1.0; install that"
    assert audit_software._remedy("something else", recorded) == ""
