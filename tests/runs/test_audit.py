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
from charms_bench.runs import audit_software
from charms_bench.runs.code_hashes import SOURCES, commit, module_blobs

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


def rename_shard(folder: Path, name: str, new: str) -> None:
    """Gives a shard another name, and checksums that fit."""
    run = folder / "run"
    for kind in ("steps", "counts", "drivers", "episodes"):
        (run / kind / f"{name}.parquet").rename(run / kind / f"{new}.parquet")
    old = run / "checksums" / f"{name}.sha256"
    old.with_stem(new).write_text(old.read_text().replace(name, new))
    old.unlink()


def change_keys(folder: Path) -> None:
    """Gives every shard a key as of other software."""
    for path in sorted((folder / "run" / "checksums").iterdir()):
        beginning = path.stem.rpartition("-")[0]
        rename_shard(folder, path.stem, f"{beginning}-{'0' * 16}")


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


def test_a_digit_changed_in_a_table_is_named(folder: Path) -> None:
    expected = change_digit(folder)
    answer = audited(folder)
    assert answer.returncode == 1, answer
    assert f"tables/small.csv: IDM, idm_mobil, paper-2, dhw_mean: {expected}" in answer.stdout


@pytest.mark.parametrize("module", ["charms_bench.world.road", "charms_bench.report.markdown"])
@pytest.mark.parametrize("commit", ["", "1234abcd"])
def test_a_changed_digit_is_false_whatever_code_the_manifest_names(
    folder: Path, module: str, commit: str
) -> None:
    change_digit(folder)

    def change(manifest: dict[str, Any]) -> None:
        manifest["modules"][module] = "0" * 40
        manifest["commit"] = commit

    change_manifest(folder, change)
    answer = audited(folder)
    assert answer.returncode == 1, answer
    assert "fail     tables    tables/small.csv: IDM, idm_mobil" in answer.stdout


def test_a_digit_changed_in_a_page_is_false_whatever_code_the_manifest_names(folder: Path) -> None:
    page = folder / "run" / "tables" / "small.md"
    page.write_text(page.read_text().replace("0", "1", 1))
    module = "charms_bench.report.markdown"
    change_manifest(folder, lambda manifest: manifest["modules"].update({module: "0" * 40}))
    answer = audited(folder)
    assert answer.returncode == 1, answer
    assert "fail     tables    tables/small.md: line " in answer.stdout


def test_a_table_of_other_metrics_leaves_the_other_tables_checked(folder: Path) -> None:
    tables = folder / "run" / "tables"
    (tables / "small.csv").write_text((tables / "small.csv").read_text().replace("paper-2", "x"))
    (tables / "small-drivers.csv").write_text("We win.")
    answer = audited(folder)
    assert answer.returncode == 1, answer
    assert "metric_set is x; computed again, paper-2" in answer.stdout
    assert "tables/small-drivers.csv: line 1 is 'We win.'" in answer.stdout


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
    rows.with_columns(duration_s=1.0).write_parquet(path)
    sign(folder, path)
    assert charms_bench("rescore", "run", cwd=folder).returncode == 0
    answer = audited(folder)
    assert answer.returncode == 1
    assert (
        f"episodes/{path.name}: row 1 (episode 0): duration_s is 1.0; simulated again, 2.0"
        in answer.stdout
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


def test_a_shard_that_the_suite_does_not_have_is_named_and_not_read(folder: Path) -> None:
    run, name = folder / "run", f"000-000000160-{'0' * 16}"
    for kind in ("steps", "counts", "drivers", "episodes"):
        rows = pl.read_parquet(shard(folder, kind))
        rows.head(0 if kind == "episodes" else 20).write_parquet(run / kind / f"{name}.parquet")
    lines = [
        f"{hashlib.sha256((run / kind / f'{name}.parquet').read_bytes()).hexdigest()}  "
        f"{kind}/{name}.parquet\n"
        for kind in ("steps", "counts", "drivers", "episodes")
    ]
    (run / "checksums" / f"{name}.sha256").write_text("".join(lines))
    answer = audited(folder)
    assert answer.returncode == 1, answer
    assert f"checksums/{name}.sha256: is not of a shard of the suite" in answer.stdout
    read = charms_bench("rescore", "run", cwd=folder)
    assert read.returncode == 2
    assert f"{name}.sha256: is not of a shard of the suite in manifest.json" in read.stderr


def swap_shards(folder: Path, one: Path, other: Path) -> None:
    """Gives two shards each other's rows, and checksums that fit."""
    for kind in ("steps", "counts", "drivers", "episodes"):
        files = [folder / "run" / kind / path.name for path in (one, other)]
        contents = [file.read_bytes() for file in files]
        for file, content in zip(files, reversed(contents), strict=True):
            file.write_bytes(content)
            sign(folder, file)


def test_two_shards_that_were_swapped_are_named_without_a_simulation(folder: Path) -> None:
    first, second = sorted((folder / "run" / "steps").glob("000-*"))
    swap_shards(folder, first, second)
    findings = audit_of(folder, shards=1, workers=1).findings
    found = {each.where: each.what for each in findings if each.check == "files"}
    expected = "an episode is not one of 0 to 149; run the suite again"
    assert found[f"episodes/{first.name}"] == expected
    read = charms_bench("edge-cases", "run", cwd=folder)
    assert read.returncode == 2
    assert f"{first.name}: {expected}" in read.stderr


def test_the_shards_of_two_egos_that_were_swapped_are_named(folder: Path) -> None:
    one, other = shard(folder, "steps", 0), shard(folder, "steps", 1)
    swap_shards(folder, one, other)
    findings = audit_of(folder, shards=1, workers=1).findings
    found = {each.where: each.what for each in findings if each.check == "files"}
    (network,) = (folder / "run" / "networks").iterdir()
    where = f"checksums/{one.stem}.sha256"
    assert found[where] == f"the ego is {network.name}, expected idm_mobil"


def test_rows_of_two_egos_that_were_swapped_are_not_scored(folder: Path) -> None:
    swap_shards(folder, shard(folder, "steps", 0), shard(folder, "steps", 1))
    answer = charms_bench("rescore", "run", cwd=folder)
    assert answer.returncode == 2
    assert "the ego is " in answer.stderr


def test_a_run_continues_by_simulating_a_swapped_shard_again(folder: Path) -> None:
    before = contents(folder / "run")
    first, second = sorted((folder / "run" / "steps").glob("000-*"))
    swap_shards(folder, first, second)
    made = charms_bench("run", "suite.yaml", "--workers", 1, "--output", "run", cwd=folder)
    assert made.returncode == 0, made.stderr
    assert contents(folder / "run") == before


def test_two_shards_of_the_same_episodes_are_named(folder: Path) -> None:
    name = shard(folder, "steps").stem
    shutil.copytree(folder / "run", folder / "copy")
    rename_shard(folder, name, f"{name[:-16]}{'0' * 16}")
    shutil.copytree(folder / "copy", folder / "run", dirs_exist_ok=True)
    answer = audited(folder)
    assert answer.returncode == 1, answer
    assert f"checksums/{name}.sha256: has the episodes of {name[:-16]}0000" in answer.stdout
    assert "run the suite again, which deletes" in charms_bench("rescore", "run", cwd=folder).stderr


def test_a_column_that_no_run_writes_is_named(folder: Path) -> None:
    path = shard(folder, "steps")
    pl.read_parquet(path).with_columns(note=pl.lit("We win.")).write_parquet(path)
    sign(folder, path)
    answer = audited(folder)
    assert answer.returncode == 1, answer
    assert f"steps/{path.name}: the rows are the same, but the file has other bytes" in (
        answer.stdout
    )


def test_a_file_of_nothing_is_named_and_what_readers_made_is_not(folder: Path) -> None:
    for name in ("replays/x.gif", "notes.txt"):
        (folder / "run" / name).parent.mkdir(exist_ok=True)
        (folder / "run" / name).write_text("x")
    answer = audited(folder)
    assert answer.returncode == 3, answer
    assert "unknown  files     notes.txt: is not a file of a run" in answer.stdout
    assert "x.gif" not in answer.stdout


@pytest.mark.parametrize(
    "name", ["steps/000-000000000-0000000000000000.txt", "networks/x.onnx", "tables/more/x.md"]
)
def test_a_file_beside_those_of_the_run_is_named(folder: Path, name: str) -> None:
    (folder / "run" / name).parent.mkdir(exist_ok=True)
    (folder / "run" / name).write_text("x")
    answer = audited(folder)
    assert answer.returncode == 1, answer
    assert f"fail     files     {name}: is not " in answer.stdout


@pytest.mark.parametrize("name", ["tables/small.csv", "steps", "manifest.json"])
def test_a_link_is_named(folder: Path, name: str) -> None:
    path = folder / "run" / name
    path.rename(folder / path.name)
    path.symlink_to(folder / path.name)
    answer = audited(folder)
    assert answer.returncode == 1, answer
    assert f"{name}: is a link, not a file" in answer.stdout


def test_a_hash_of_another_suite_is_false_whatever_code_the_manifest_names(folder: Path) -> None:
    change_manifest(folder, lambda manifest: manifest.update(suite_sha256="0" * 64, modules={}))
    answer = audited(folder)
    assert answer.returncode == 1, answer
    assert "suite_sha256: is not the hash of the suite in manifest.json" in answer.stdout


def test_a_field_that_the_code_of_the_run_does_not_write_is_named(folder: Path) -> None:
    change_manifest(folder, lambda manifest: manifest["metric_sets"].update(paper=9))
    answer = audited(folder)
    assert answer.returncode == 1, answer
    assert "metric_sets.paper: is 9; the code of the run writes 2" in answer.stdout


def test_a_manifest_that_contradicts_the_keys_of_its_shards_is_false(folder: Path) -> None:
    def change(manifest: dict[str, Any]) -> None:
        manifest["commit"] = ""
        manifest["modules"]["charms_bench.world.road"] = "0" * 40
        manifest["versions"]["numpy"] = "1.0"
        manifest["agents"]["idm_mobil"]["code_sha256"] = "0" * 64

    change_manifest(folder, change)
    answer = audited(folder)
    assert answer.returncode == 1, answer
    assert "charms_bench.world.road is other code in the manifest, but shards have" in (
        answer.stdout
    )
    assert f"libraries: numpy is {np.__version__}, expected 1.0; but shards have" in answer.stdout
    assert "in the manifest, but shards have the key of the installed agent" in answer.stdout


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

    change_keys(folder)
    change_manifest(folder, change)
    answer = audited(folder)
    assert answer.returncode == 3, answer
    assert f"libraries: numpy is {np.__version__}, expected 1.0; install these" in answer.stdout
    assert "idm_mobil: is not the agent of the run: code_sha256 is " in answer.stdout
    assert "fail" not in answer.stdout.replace("nothing fails", "")


def test_a_run_of_another_commit_is_named(whole: Path, tmp_path: Path) -> None:
    shutil.copytree(SOURCES / "charms_bench", tmp_path / "charms_bench")
    module = tmp_path / "charms_bench" / "plugins" / "traffic.py"
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
    assert answer.returncode == 3
    what = "charms_bench.plugins.traffic is not the code of the run, which was charms-bench"
    assert f"modules: {what} {harness.__version__}" in answer.stdout
    assert "install commit 1234abcd" in answer.stdout
    assert "none can be simulated again" in answer.stdout


def test_an_old_manifest_that_names_no_code_is_not_called_true(folder: Path) -> None:
    change_manifest(folder, lambda manifest: manifest.pop("modules"))
    answer = audited(folder)
    assert answer.returncode == 3
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


def test_a_folder_without_a_run_is_refused(tmp_path: Path) -> None:
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
