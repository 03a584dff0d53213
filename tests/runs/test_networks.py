"""Networks by path as traffic, in a mixture and in `pch`: checked, hashed, kept and replayed."""

import shutil
from collections.abc import Callable
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl
import pytest
from charms_agents.charms import STYLES
from command_line import charms_bench
from polars.testing import assert_frame_equal

import charms_bench as bench
from charms_bench.errors import CharmsBenchError, InputError
from charms_bench.runs.finished_run import open_finished
from charms_bench.runs.pairing import pairs_of
from charms_bench.runs.runner import combined, plan, run
from charms_bench.runs.shard import ShardFiles, simulate
from charms_bench.runs.suite import Suite
from charms_bench.runs.suite_roads import RoadEntry
from charms_bench.world.scene import SceneSettings

NetworkFile = Callable[..., Path]
POLICIES = Path(str(files("charms_agents") / "policies"))
BY_PATH = {f"{style}-{svo}": f"charms_{style}_{svo}.onnx" for style, svo in STYLES.values()}
WAYS: dict[str, Callable[[str], Any]] = {
    "traffic": lambda path: path,
    "onnx": lambda path: {"onnx": path},
    "mixture": lambda path: {"mixture": {path: 0.5, "idm_mobil": 0.5}},
    "pch": lambda path: {"name": "pch", "options": {"styles": {"safe-egoistic": path}}},
}
"""The ways to name a network in a traffic."""
SLOW = {"speed_min_mps": 0.0, "target_speed_min_mps": 0.0}


def suite_of(folder: Path, traffic: object, ego: object = "idm_mobil") -> Suite:
    scene = {"duration_s": 3.0, "traffic_vehicles": 6}
    entries = {"egos": [{"agent": ego}], "traffic_models": [{"traffic": traffic, "label": "mine"}]}
    return Suite.model_validate(
        {"suite": "small", "episodes": 3, "scene": scene, "folder": folder, **entries}
    )


def rows_of(folder: Path, traffic: object) -> ShardFiles:
    (task,) = plan(suite_of(folder, traffic)).values()
    return simulate(task)


def key_of(folder: Path, traffic: object) -> str:
    (task,) = plan(suite_of(folder, traffic)).values()
    return task.key


@pytest.mark.parametrize(
    ("named", "by_path"),
    [
        ("imitation", "imitation.onnx"),
        (
            {"mixture": {"imitation": 0.5, "idm_mobil": 0.5}},
            {"mixture": {"imitation.onnx": 0.5, "idm_mobil": 0.5}},
        ),
        (
            {"name": "pch", "options": {"tau": 1.0}},
            {"name": "pch", "options": {"tau": 1.0, "styles": BY_PATH}},
        ),
    ],
)
def test_a_network_drives_by_its_path_as_it_drives_by_its_name(
    named: object, by_path: object
) -> None:
    one, other = (dict(rows_of(POLICIES, traffic)) for traffic in (named, by_path))
    drivers = [pl.read_parquet(rows.pop("drivers")) for rows in (one, other)]
    assert one == other
    sums = [rows.drop("agent").group_by("episode", "is_ego").sum() for rows in drivers]
    assert_frame_equal(*sums, check_row_order=False, check_exact=False)


@pytest.mark.parametrize("way", WAYS)
def test_a_key_follows_the_content_of_a_traffics_network_and_not_its_path(
    network_file: NetworkFile, tmp_path: Path, way: str
) -> None:
    network_file(name="one.onnx")
    (tmp_path / "below").mkdir()
    shutil.copy(tmp_path / "one.onnx", tmp_path / "below" / "two.onnx")
    before = key_of(tmp_path, WAYS[way]("one.onnx"))
    assert key_of(tmp_path, WAYS[way]("below/two.onnx")) == before
    rows = [rows_of(tmp_path, WAYS[way](path)) for path in ("one.onnx", "below/two.onnx")]
    assert rows[0] == rows[1]
    assert key_of(tmp_path / "below", WAYS[way]("../one.onnx")) == before
    network_file(np.ones((35, 5)), name="one.onnx")
    assert key_of(tmp_path, WAYS[way]("one.onnx")) != before


def test_a_key_follows_the_order_of_a_mixture_and_its_proportion_of_each_network(
    network_file: NetworkFile, tmp_path: Path
) -> None:
    for name in ("a", "b", "c"):
        network_file(name=f"{name}.onnx")  # all the same
    mixtures = [
        {"a.onnx": 0.2, "idm_mobil": 0.3, "b.onnx": 0.0, "c.onnx": 0.5},
        {"a.onnx": 0.1, "idm_mobil": 0.3, "b.onnx": 0.1, "c.onnx": 0.5},
        {"idm_mobil": 0.3, "a.onnx": 0.1, "b.onnx": 0.1, "c.onnx": 0.5},
    ]
    assert len({key_of(tmp_path, {"mixture": mixture}) for mixture in mixtures}) == 3


def test_a_run_says_what_its_networks_observe_and_do(
    network_file: NetworkFile, tmp_path: Path
) -> None:
    network_file(name="mine.onnx", metadata={"trained_in": "not stated"})
    (tmp_path / "suite.yaml").write_text(
        "suite: small\nepisodes: 2\nscene: {duration_s: 2.0, traffic_vehicles: 6}\n"
        "egos: [{agent: {onnx: mine.onnx, decision_hz: 1}, label: PPO}, {agent: idm_mobil}]\n"
        "traffic_models: [{traffic: idm_mobil}]\n"
    )
    what = "PPO: observes neighbours; chooses meta actions at 1 Hz; its checkpoint does not"
    for command in (["run", "suite.yaml", "--workers", "1"], ["show", "runs/small"]):
        assert what in charms_bench(*command, cwd=tmp_path).stdout


def test_a_network_of_kinematics_is_rejected_on_a_road(
    network_file: NetworkFile, tmp_path: Path
) -> None:
    network = network_file(np.zeros((25, 5)), metadata={"observation": '{"type": "Kinematics"}'})
    for ego, traffic in ((network.name, "idm_mobil"), ("idm_mobil", network.name)):
        suite = suite_of(tmp_path, traffic, ego)
        scene = SceneSettings.model_validate({"profile": {"name": "charms", **SLOW}})
        changes = {"scene": scene, "roads": (RoadEntry(name="merge-v0"),)}
        with pytest.raises(InputError, match="receives on this road neither the ranges nor"):
            run(suite.model_copy(update=changes), tmp_path / "run", workers=1)


def test_an_agent_that_cannot_drive_on_roads_leaves_the_other_cells_and_is_named_once(
    network_file: NetworkFile, tmp_path: Path
) -> None:
    network = network_file(np.zeros((25, 5)), metadata={"observation": '{"type": "Kinematics"}'})
    egos = [{"agent": network.name}, {"agent": "idm_mobil"}]
    given = {"suite": "s", "episodes": 1, "egos": egos, "roads": ["merge-v0", "u-turn-v0"]}
    suite = Suite.model_validate(given, context={"folder": tmp_path})
    failed: dict[int, CharmsBenchError] = {}
    assert {shard.cell for shard in plan(suite, failed)} == {2, 3}
    error = combined(suite, failed)
    assert f"(also {network.name} in u-turn-v0)" in str(error)
    assert not hasattr(error, "__notes__")


@pytest.mark.parametrize("way", WAYS)
def test_a_moved_run_folder_has_the_networks_of_its_traffic(
    network_file: NetworkFile, tmp_path: Path, way: str
) -> None:
    network = network_file()
    suite = suite_of(tmp_path, WAYS[way](network.name), {"onnx": network.name, "decision_hz": 5})
    run(suite, tmp_path / "run", workers=1)
    network.unlink()
    charms_bench("rescore", tmp_path / "run")
    moved = bench.open_run(shutil.move(tmp_path / "run", tmp_path / "moved"), tmp_path / "nowhere")
    assert len(list((moved.path / "networks").iterdir())) == 1
    assert network.name in moved.replay(1).agents
    (drivers,) = (rows for part in moved.cells[0].drivers for rows in part)
    assert network.name in set(drivers["agent"])
    assert len(moved.edge_cases()) == 3
    assert moved.report(tmp_path / "report.html").exists()


@pytest.mark.parametrize(
    ("traffic", "message"),
    [
        (
            "nets/none.onnx",
            "suite.yaml:5: traffic_models[0].traffic: {0}/nets/none.onnx: cannot be read: No",
        ),
        (
            "nets/none.onnx",
            "directory; `charms-bench export CHECKPOINT.zip --to {0}/nets` makes it",
        ),
        (
            "\n      mixture:\n        idm_mobil: 0.5\n        nets/bad.onnx: 0.5",
            "suite.yaml:8: traffic_models[0].traffic.mixture.nets/bad.onnx: {0}/nets/bad.onnx: is",
        ),
        (
            "{name: pch, options: {tau: 1,\n    styles: {safe-egoistic: nets/none.onnx}}}",
            "suite.yaml:6: traffic_models[0].traffic.options.styles.safe-egoistic: {0}/nets/none.",
        ),
        (
            "{name: pch, options: {styles: {kind: nets/bad.onnx}}}",
            "suite.yaml:5: traffic_models[0]: traffic 'pch': no style 'kind'. Known: efficient-",
        ),
        (
            "nets/bad.pt",
            "suite.yaml:5: traffic_models[0]: no traffic named 'nets/bad.pt'. Known: ",
        ),
        ("nets/bad.pt", "The path of a network ends in .onnx, in small"),
        ("{name: nets/bad.onnx, options: {gain: 1}}", "is an agent; as a traffic, it takes no opt"),
        ('{name: pch, options: {styles: {safe-egoistic: "a\\e[2J.onnx"}}}', "can be printed"),
    ],
)
def test_a_network_that_cannot_be_used_is_named_with_its_line_before_anything_runs(
    tmp_path: Path, traffic: str, message: str
) -> None:
    (tmp_path / "nets").mkdir()
    for name in ("bad.onnx", "bad.pt"):
        (tmp_path / "nets" / name).write_bytes(b"nothing")
    suite = tmp_path / "suite.yaml"
    head = "suite: small\nepisodes: 1\negos: [{agent: idm_mobil}]\ntraffic_models:\n"
    suite.write_text(f"{head}  - traffic: {traffic}\n")
    for command in (("run", suite, "--output", tmp_path / "run"), ("verify", "--suite", suite)):
        called = charms_bench(*command)
        assert called.returncode == 2
        assert message.format(tmp_path) in called.stderr
        assert "Traceback" not in called.stderr
    assert not (tmp_path / "run").exists()


def test_runs_are_compared_if_their_traffics_networks_have_the_same_content(
    network_file: NetworkFile, tmp_path: Path
) -> None:
    weights = {"a": None, "b": None, "c": np.ones((35, 5))}
    runs = []
    for name, given in weights.items():
        ego = "idm_mobil" if name == "a" else "level_0"
        network_file(given, name=f"{name}.onnx")
        run(suite_of(tmp_path, WAYS["pch"](f"{name}.onnx"), ego), tmp_path / name, workers=1)
        runs.append(open_finished(tmp_path / name))
    ((one, other),) = pairs_of(runs[0], runs[1], None)
    assert (one.agent, other.agent) == ("idm_mobil", "level_0")
    with pytest.raises(InputError, match=r"traffic_models\[0\]\.options\.styles\.safe-egoistic is"):
        pairs_of(runs[0], runs[2], None)
