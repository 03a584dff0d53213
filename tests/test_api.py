"""The Python interface: what a script or a notebook gets."""

import subprocess
import sys
from pathlib import Path

import polars as pl
import pytest

import charms_bench
from charms_bench.errors import InputError, RunFolderError

SUITE = """\
suite: small
title: A small suite
episodes: 6
scene: {duration_s: 5.0, traffic_vehicles: 5}
egos:
  - {agent: idm_mobil, label: IDM, paper: {speed_mean: 23.67}}
  - {agent: stackelberg, label: Stackelberg}
traffic_models:
  - traffic: idm_mobil
columns: [speed_mean]
"""


@pytest.fixture(scope="module")
def suite_file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("suite") / "suite.yaml"
    path.write_text(SUITE)
    return path


@pytest.fixture(scope="module")
def run(suite_file: Path) -> charms_bench.Run:
    return charms_bench.run(suite_file, suite_file.parent / "run", workers=1)


def test_rows_of_all_cells_carry_the_labels_of_their_cell(run: charms_bench.Run) -> None:
    counted = run.episodes.group_by("agent", "traffic").len().sort("agent").rows()
    assert counted == [("IDM", "idm_mobil", 6), ("Stackelberg", "idm_mobil", 6)]
    assert run.steps.columns[:3] == ["agent", "traffic", "episode"]
    assert len(run.steps) == run.episodes["steps"].sum()


def test_a_run_opened_from_its_folder_has_the_same_tables(run: charms_bench.Run) -> None:
    opened = charms_bench.open_run(str(run.path))
    assert list(opened.tables) == ["small", "small-drivers"]
    assert opened.table.frame().equals(run.table.frame())
    assert opened.manifest["format"] == 4
    assert [path.name for path in opened.files] == [
        "small-tradeoff.png",
        "small-drivers.md",
        "small.md",
    ]


def test_the_mean_speed_of_a_table_is_that_of_the_rows(run: charms_bench.Run) -> None:
    frame = run.table.select("speed_mean").frame()
    value = frame.filter(agent="IDM", metric_set="standard-5")["value"].item()
    after_warm_up = pl.col("step") > 9  # 3 s
    driving = run.steps.filter((pl.col("agent") == "IDM") & after_warm_up)
    assert run.episodes["ending"].unique().to_list() == ["time"]
    assert value == pytest.approx(driving["speed"].cast(pl.Float64).mean(), rel=1e-5)


def test_two_agents_are_compared_metric_by_metric(run: charms_bench.Run) -> None:
    table = run.compare(egos=("IDM", "Stackelberg"), metrics=["speed_mean"])
    assert [row.labels[:2] for row in table.rows] == [("IDM", "Stackelberg")] * 2


def test_other_thresholds_need_no_simulation(suite_file: Path, tmp_path: Path) -> None:
    made = charms_bench.run(suite_file, tmp_path / "run", episodes=2, seed=9, workers=1)
    table = made.rescore("standard:ttc_s=2")
    assert {column.group for column in table.columns} == {"standard-5(ttc_s=2)"}
    assert made.episodes["episode"].unique().sort().to_list() == [9, 10]
    assert made.tables["small"].frame().equals(table.frame())


def test_an_episode_is_found_and_simulated_again(run: charms_bench.Run) -> None:
    case = run.edge_cases(top=1, ego="Stackelberg")[0]
    replay = run.replay(case.episode, ego=case.ego)
    assert (replay.episode, replay.cell.ego.title) == (case.episode, "Stackelberg")
    assert replay.trajectories()["vehicle"].n_unique() == 6
    with pytest.raises(InputError, match="choose one with --ego and --traffic"):
        run.replay(case.episode)


def test_a_notebook_shows_a_run_and_a_table(run: charms_bench.Run) -> None:
    shown = run._repr_html_()
    assert "Mean speed" in shown
    assert "Stackelberg" in shown
    assert "Acceleration, std" not in shown, "the suite prints other columns"
    assert "Acceleration, std" in run.table._repr_html_()
    assert repr(run).endswith("2 egos x 1 traffic model, 6 episodes each>")


def test_a_report_is_one_file(run: charms_bench.Run, tmp_path: Path) -> None:
    path = run.report(tmp_path / "report.html", top=0)
    assert path.read_text().startswith("<!doctype html>")


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"cluster": "tcp://here:1", "workers": 2}, "a cluster has its own"),
        ({"episodes": 0}, "episodes"),
        ({"workers": -1}, "workers is -1; expected a number above 0"),
        ({"shard_limit_s": 0}, "shard_limit_s is 0; expected a number above 0"),
    ],
)
def test_options_that_cannot_be_used_are_rejected(
    suite_file: Path, tmp_path: Path, options: dict[str, object], message: str
) -> None:
    with pytest.raises(InputError, match=message):
        charms_bench.run(suite_file, tmp_path / "run", **options)  # type: ignore[arg-type]
    assert not (tmp_path / "run").exists()


def test_evaluations_and_trainings_are_told_apart(
    run: charms_bench.Run, suite_file: Path, tmp_path: Path
) -> None:
    training = tmp_path / "train.yaml"
    training.write_text("pipeline: charms\n")
    with pytest.raises(InputError, match=r"is a training suite; use charms_bench\.train"):
        charms_bench.run(training)
    with pytest.raises(InputError, match=r"is not a training suite; use charms_bench\.run"):
        charms_bench.train(suite_file)
    with pytest.raises(RunFolderError, match=r"holds an evaluation; use charms_bench\.open_run"):
        charms_bench.open_training(run.path)
    with pytest.raises(RunFolderError, match="no finished training"):
        charms_bench.open_training(tmp_path)


def test_a_kind_of_episode_that_does_not_exist_is_rejected(run: charms_bench.Run) -> None:
    with pytest.raises(InputError, match="no kind of episode named 'crash'"):
        run.edge_cases(kind="crash")  # type: ignore[arg-type]


def test_a_script_needs_no_guard_of_its_main_module(suite_file: Path, tmp_path: Path) -> None:
    script = tmp_path / "script.py"
    script.write_text(
        "import charms_bench\n"
        f"run = charms_bench.run({str(suite_file)!r}, 'run', episodes=2, workers=1)\n"
        "print('finished', len(run.episodes))\n"
    )
    finished = subprocess.run(
        [sys.executable, script], capture_output=True, text=True, cwd=tmp_path
    )
    assert finished.stdout == "finished 4\n", finished.stderr
