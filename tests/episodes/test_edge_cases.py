"""The ranking of a run's episodes, and the commands that show it."""

import json
import re
from pathlib import Path

import polars as pl
import pytest
from command_line import charms_bench

from charms_bench.episodes.edge_cases import edge_cases
from charms_bench.episodes.recorded_cell import find_cells
from charms_bench.runs.finished_run import FinishedRun
from charms_bench.runs.runner import run
from charms_bench.runs.suite import Suite

SUITE = {
    "suite": "small",
    "episodes": 30,
    "scene": {"duration_s": 8.0, "density": 1.5, "traffic_vehicles": 10},
    "egos": [{"agent": "idm_mobil"}, {"agent": "prior_level_k", "label": "[b]Level-k[/b]"}],
    "traffic_models": [{"traffic": "idm_mobil"}],
}


@pytest.fixture(scope="module")
def finished(tmp_path_factory: pytest.TempPathFactory) -> FinishedRun:
    return run(Suite.model_validate(SUITE), tmp_path_factory.mktemp("run") / "small", workers=1)


def test_collisions_come_first_and_then_the_most_critical(finished: FinishedRun) -> None:
    found = edge_cases(find_cells(finished, Path()), 60, None)
    assert [case.rank for case in found] == list(range(1, 61))
    assert [case.criticality for case in found] == sorted(
        (case.criticality for case in found), reverse=True
    )
    ended = [case.ending != "time" for case in found]
    assert ended == sorted(ended, reverse=True)
    stored = pl.concat([cell.episodes for cell in finished.cells()])
    assert sum(ended) == (stored["ending"] != "time").sum() > 0


def test_every_collision_is_told_as_one(finished: FinishedRun) -> None:
    found = edge_cases(find_cells(finished, Path()), 60, "collision")
    verbs = ("hit vehicle", "was hit from behind", "steered", "clipped", "left the road")
    assert found
    assert all(any(verb in case.what for verb in verbs) for case in found)


def test_a_near_miss_is_told_by_its_measured_ttc(finished: FinishedRun) -> None:
    found = edge_cases(find_cells(finished, Path()), 60, "near-miss")
    assert found
    for case in found:
        assert case.ending == "time"
        assert case.ttc_min_s is not None
        assert case.what.startswith(f"TTC {case.ttc_min_s:.1f} s behind vehicle ")


def test_abandoned_lane_changes_are_those_whose_gap_was_taken(finished: FinishedRun) -> None:
    found = edge_cases(find_cells(finished, Path()), 60, "abandoned-lane-change")
    assert found
    for case in found:
        assert case.abandoned_changes > 0
        assert "took the gap" in case.what


def test_top_and_cells_limit_the_list(finished: FinishedRun) -> None:
    found = edge_cases(find_cells(finished, Path())[:1], 3, None)
    assert [case.ego for case in found] == ["idm_mobil"] * 3


def test_the_command_prints_a_line_an_episode_or_json(finished: FinishedRun) -> None:
    shown = charms_bench("edge-cases", finished.folder.path, "--top", 3, columns=160)
    assert shown.returncode == 0, shown.stderr
    cases = json.loads(
        charms_bench("edge-cases", finished.folder.path, "--top", 3, "--json").stdout
    )
    assert [case["rank"] for case in cases] == [1, 2, 3]
    _, *lines = (line for line in shown.stdout.splitlines() if re.search(r"\w", line))
    for case, line in zip(cases, lines[:3], strict=True):  # remarks follow
        assert line.split()[0] == str(case["rank"])
        assert all(text in line for text in (case["ego"], str(case["episode"]), case["what"]))


def test_a_kind_that_did_not_happen_is_no_error(finished: FinishedRun) -> None:
    options = ["--ego", "idm_mobil", "--kind", "collision"]
    result = charms_bench("edge-cases", finished.folder.path, *options)
    assert (result.returncode, "No collision in" in result.stdout) == (0, True)


def test_a_replay_replaces_no_file_beside_the_animation(
    finished: FinishedRun, tmp_path: Path
) -> None:
    (tmp_path / "o.parquet").write_text("mine")
    options = ("--ego", "idm_mobil", "--output", tmp_path / "o.gif")
    assert charms_bench("replay", finished.folder.path, 4, *options).returncode == 0
    assert (tmp_path / "o.parquet").read_text() == "mine"
    assert (tmp_path / "o.trajectories.parquet").exists()


def test_replay_writes_an_animation_trajectories_and_a_scenario(
    finished: FinishedRun, tmp_path: Path
) -> None:
    options = ("--ego", "[b]Level-k[/b]", "--commonroad", tmp_path / "four.xml", "--json")
    result = charms_bench("replay", finished.folder.path, 4, *options)
    assert result.returncode == 0, result.stderr
    made = json.loads(result.stdout)
    animation = Path(made["animation"])
    assert animation == finished.folder.path / "replays" / "b-level-k-b-in-idm_mobil-4.gif"
    assert animation.read_bytes().startswith(b"GIF89a")
    table = pl.read_parquet(made["trajectories"])
    assert table["t_s"].max() == made["duration_s"]
    assert table["vehicle"].n_unique() == 11
    assert made["commonroad"] == str(tmp_path / "four.xml")
    assert (tmp_path / "four.xml").read_text().count("<dynamicObstacle") == 11


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (
            [],
            "choose one with --ego and --traffic. Cells: idm_mobil in",
        ),
        (
            ["--ego", "idm"],
            "no ego called 'idm'. Did you mean 'idm_mobil'? Known: idm_mobil, [b]Level-k[/b].",
        ),
        (["--ego", "idm_mobil", "--output", "a.mp4"], "a.mp4: expected a name that ends in .gif"),
    ],
)
def test_a_mistake_is_one_message_and_exit_code_2(
    finished: FinishedRun, options: list[str], message: str
) -> None:
    result = charms_bench("replay", finished.folder.path, 4, *options)
    assert (result.returncode, result.stdout) == (2, "")
    assert message in result.stderr
    assert "Traceback" not in result.stderr
