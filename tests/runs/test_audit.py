"""`charms-bench audit`: a true run is true, and each falsification is named."""

import hashlib
import json
import os
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl
import pytest
from command_line import Called, charms_bench

import charms_bench as harness
from charms_bench.runs.code_hashes import SOURCES, commit, module_blobs

SUITE = """\
suite: small
episodes: 160
scene: {duration_s: 2.0, traffic_vehicles: 5}
egos: [{agent: idm_mobil, label: IDM}, {agent: policy.onnx, label: Net}]
traffics: [{traffic: idm_mobil}]
"""
RARE = """\
suite: small
episodes: 1
scene: {duration_s: 1.0, traffic_vehicles: 5}
egos: [{agent: idm_mobil}]
traffics: [{traffic: idm_mobil}]
"""


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A finished run of four shards, unaltered."""
    onnx = pytest.importorskip("onnx", reason="needs the extra 'train'")
    folder = tmp_path_factory.mktemp("whole")
    (folder / "suite.yaml").write_text(SUITE)
    helper, rng = onnx.helper, np.random.default_rng(0)
    for name in ("policy", "other"):
        weights = onnx.numpy_helper.from_array(rng.normal(size=(35, 5)).astype("f4"), "weights")
        graph = helper.make_graph(
            [helper.make_node("MatMul", ["observations", "weights"], ["values"])],
            "policy",
            [helper.make_tensor_value_info("observations", 1, ["batch", 35])],
            [helper.make_tensor_value_info("values", 1, ["batch", 5])],
            [weights],
        )
        opset = [helper.make_opsetid("", 17)]
        onnx.save(
            helper.make_model(graph, opset_imports=opset, ir_version=9), folder / f"{name}.onnx"
        )
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


def sign(folder: Path, path: Path) -> None:
    """Writes the checksum of a file that was changed, as somebody would who hides the change."""
    checksums = folder / "run" / "checksums" / f"{path.stem}.sha256"
    name = f"{path.parent.name}/{path.name}"
    lines = [
        f"{hashlib.sha256(path.read_bytes()).hexdigest()}  {name}" if name in line else line
        for line in checksums.read_text().splitlines()
    ]
    checksums.write_text("\n".join(lines) + "\n")


def test_a_true_run_is_true(folder: Path) -> None:
    answer = audited(folder)
    assert answer.returncode == 0, answer
    assert "4 of 4 shards, simulated again, have the same rows" in answer.stdout
    assert "run: everything that was checked is true" in answer.stdout


def test_a_sample_is_drawn_anew_each_time_and_can_be_asked_for(folder: Path) -> None:
    found = [audit_of(folder, shards=1, workers=1).findings for _ in range(2)]
    seeds = {each.what for findings in found for each in findings if each.check == "rows"}
    assert len(seeds) == 2
    again = audit_of(folder, shards=1, seed=7, workers=1)
    assert again.verdict == "true"
    assert "1 of 4 shards" in again.table.records()[-2]["found"]
    assert "seed 7" in again.table.records()[-2]["found"]


def audit_of(folder: Path, **options: Any) -> Any:
    return harness.open_run(folder / "run").audit(**options)


def test_a_digit_changed_in_a_table_is_named(folder: Path) -> None:
    table = folder / "run" / "tables" / "small.csv"
    row = pl.read_csv(table).filter(pl.col("metric") == "dhw_mean").row(0, named=True)
    was, now = (
        str(row["value"]),
        str(row["value"])[:-1] + str((int(str(row["value"])[-1]) + 1) % 10),
    )
    lines = table.read_text().splitlines(keepends=True)
    at = next(k for k, line in enumerate(lines) if ",dhw_mean," in line)
    lines[at] = lines[at].replace(was, now)
    table.write_text("".join(lines))
    answer = audited(folder)
    assert answer.returncode == 1, answer
    expected = f"IDM, idm_mobil, paper-2, dhw_mean: value is {now}; computed again, {was}"
    assert f"tables/small.csv: {expected}" in answer.stdout


def test_a_digit_changed_in_a_table_that_people_read_is_named(folder: Path) -> None:
    page = folder / "run" / "tables" / "small-drivers.md"
    page.write_text(page.read_text().replace("0", "1", 1))
    answer = audited(folder)
    assert answer.returncode == 1
    assert "tables/small-drivers.md: line " in answer.stdout


@pytest.mark.parametrize("is_signed", [False, True])
def test_a_row_changed_is_named(folder: Path, is_signed: bool) -> None:
    path = shard(folder, "steps")
    rows = pl.read_parquet(path)
    second = pl.int_range(pl.len()) == 1
    rows.with_columns(pl.when(second).then(40.0).otherwise("speed").alias("speed")).write_parquet(
        path
    )
    if is_signed:
        sign(folder, path)
    answer = audited(folder)
    assert answer.returncode == 1
    place = f"episode {rows['episode'][1]}, step {rows['step'][1]}"
    what = f"row 2 ({place}): speed is 40.0; simulated again, {rows['speed'][1]}"
    assert f"steps/{path.name}: {what}" in answer.stdout
    assert ("does not match its checksum" in answer.stdout) != is_signed


def test_rows_and_tables_that_were_both_changed_are_named(folder: Path) -> None:
    path = shard(folder, "episodes")
    rows = pl.read_parquet(path)
    rows.with_columns(
        pl.lit("time").alias("ending"), pl.lit(1).alias("steps").cast(rows.schema["steps"])
    ).write_parquet(path)
    sign(folder, path)
    assert charms_bench("rescore", "run", cwd=folder).returncode == 0
    answer = audited(folder)
    assert answer.returncode == 1
    assert (
        f"episodes/{path.name}: row 1 (episode 0): steps is 1; simulated again, 6" in answer.stdout
    )


def test_a_network_exchanged_is_named(folder: Path) -> None:
    (copy,) = (folder / "run" / "networks").iterdir()
    shutil.copy(folder / "other.onnx", copy)
    answer = audited(folder)
    assert answer.returncode == 1
    found = hashlib.sha256(copy.read_bytes()).hexdigest()
    what = f"has the hash {found}, not the one in its name, which is policy.onnx"
    assert f"networks/{copy.name}: {what}" in answer.stdout


def test_a_network_exchanged_everywhere_but_in_the_rows_is_named(folder: Path) -> None:
    (copy,) = (folder / "run" / "networks").iterdir()
    copy.unlink()
    sha256 = hashlib.sha256((folder / "other.onnx").read_bytes()).hexdigest()
    shutil.copy(folder / "other.onnx", folder / "run" / "networks" / f"{sha256}.onnx")
    change_manifest(
        folder, lambda each: each["agents"]["policy.onnx"].update(weights_sha256=sha256)
    )
    answer = audited(folder)
    assert answer.returncode == 1
    key = "has a key of other software, agents or settings than the manifest says"
    assert f"checksums/{shard(folder, 'steps', 1).stem}.sha256: {key}" in answer.stdout


def test_a_shard_that_is_missing_and_a_file_of_none_are_named(folder: Path) -> None:
    path = shard(folder, "counts")
    (folder / "run" / "checksums" / f"{path.stem}.sha256").unlink()
    answer = audited(folder)
    assert answer.returncode == 1
    assert f"counts/{path.name}: is not of a finished shard" in answer.stdout
    assert "the rows of IDM in idm_mobil, episodes 0 to 149 are missing" in answer.stdout


def test_a_table_of_something_else_is_named(folder: Path) -> None:
    (folder / "run" / "tables" / "best.md").write_text("We win.")
    answer = audited(folder)
    assert answer.returncode == 1
    assert "tables/best.md: is not a table of this suite" in answer.stdout


def test_a_table_of_other_thresholds_is_true(folder: Path) -> None:
    words = ("rescore", "run", "--set", "standard:ttc_s=2")
    assert charms_bench(*words, cwd=folder).returncode == 0
    assert audited(folder).returncode == 0


def test_other_libraries_and_other_agents_are_named_and_nothing_is_called_false(
    folder: Path,
) -> None:
    def change(manifest: dict[str, Any]) -> None:
        manifest["versions"]["numpy"] = "1.0"
        manifest["agents"]["idm_mobil"]["code_sha256"] = "0" * 64

    change_manifest(folder, change)
    answer = audited(folder)
    assert answer.returncode == 2
    assert f"libraries: numpy is {np.__version__}, expected 1.0; install these" in answer.stdout
    assert "idm_mobil: is not the agent of the run: code_sha256 is " in answer.stdout
    assert "false" not in answer.stdout.replace("nothing false", "")


def test_a_run_of_another_commit_is_named(whole: Path, tmp_path: Path) -> None:
    shutil.copytree(SOURCES / "charms_bench", tmp_path / "charms_bench")
    module = tmp_path / "charms_bench" / "world" / "lanes.py"
    module.write_text(module.read_text() + "\n# Another commit.\n")
    (tmp_path / "suite.yaml").write_text(RARE)
    path = os.pathsep.join(filter(None, (str(tmp_path), os.environ.get("PYTHONPATH"))))
    code = "from charms_bench.cli import main; main()"
    done = subprocess.run(
        [sys.executable, "-c", code, "run", "suite.yaml", "--output", "run", "--workers", "1"],
        cwd=tmp_path,
        env={**os.environ, "PYTHONPATH": path},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    change_manifest(tmp_path, lambda manifest: manifest.update(commit="1234abcd"))
    answer = audited(tmp_path)
    assert answer.returncode == 2
    what = "charms_bench.world.lanes is not the code of the run, which was charms-bench"
    assert f"modules: {what} {harness.__version__}" in answer.stdout
    assert "install commit 1234abcd" in answer.stdout
    assert "none can be simulated again" in answer.stdout


def test_an_old_manifest_that_names_no_code_is_not_called_true(folder: Path) -> None:
    change_manifest(folder, lambda manifest: manifest.pop("modules"))
    answer = audited(folder)
    assert answer.returncode == 2
    assert "the manifest does not name the code of the run" in answer.stdout


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
    command = ["git", "-C", str(SOURCES), "rev-parse", "HEAD"]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    assert commit() == done.stdout.strip()


def test_an_estimation_of_a_rare_event_is_checked_as_far_as_that_goes(tmp_path: Path) -> None:
    (tmp_path / "suite.yaml").write_text(RARE)
    words = ("--runs", 5, "--samples", 100, "--workers", 1, "--output", "run")
    made = charms_bench("rare", "suite.yaml", *words, cwd=tmp_path)
    assert made.returncode == 0, made.stderr
    answer = audited(tmp_path)
    assert answer.returncode == 2
    assert "the files of all runs match the hashes in them" in answer.stdout
    path = min((tmp_path / "run" / "runs").iterdir())
    path.write_text(path.read_text().replace("1", "2", 1))
    assert audited(tmp_path).returncode == 1


def test_a_folder_without_a_run_is_refused(tmp_path: Path) -> None:
    (tmp_path / "run").mkdir()
    answer = charms_bench("audit", "run", cwd=tmp_path)
    assert answer.returncode == 2
    assert "holds no evaluation (manifest.json)" in answer.stderr
