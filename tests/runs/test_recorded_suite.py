"""Suites of recorded scenes: rows, resumed runs, replays and exports, and errors with lines."""

import json
import re
from pathlib import Path

import gymnasium
import numpy as np
import polars as pl
import pytest
from command_line import charms_bench as command_line
from trios import flowing_road, write_trio

import charms_bench.envs  # noqa: F401  # registers the environments
from charms_bench.episodes.avoidability import BUDGET, _Chunk, collisions
from charms_bench.episodes.recorded_cell import find_cell
from charms_bench.errors import InputError, SuiteError
from charms_bench.runs.runner import run as run_suite
from charms_bench.runs.suite import load_suite
from charms_bench.world.recording_folder import read_folder

SUITE = """\
suite: small
episodes: 8
scene:
  recording: people
  profile: {name: charms, speed_min_mps: 0.0, target_speed_min_mps: 0.0}
  simulation_hz: 30
  duration_s: 2.0
egos:
  - {agent: recorded, label: Recorded driver}
  - {agent: imitation, label: Imitation}
traffic_models:
  - {traffic: recorded, label: Replayed}
  - {traffic: {name: recorded_until_deviation}, label: Until}
  - {traffic: idm_mobil, label: Reactive}
"""


def written(folder: Path, text: str = SUITE) -> Path:
    (folder / "people").mkdir(parents=True, exist_ok=True)
    write_trio(folder / "people", flowing_road(10), rate=10)
    (folder / "small.yaml").write_text(text)
    return folder


def rows(run: Path, kind: str) -> pl.DataFrame:
    found = pl.concat(pl.read_parquet(path) for path in sorted(run.glob(f"{kind}/*.parquet")))
    return found.sort(found.columns)


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = written(tmp_path_factory.mktemp("recorded"))
    called = command_line("run", "small.yaml", "--workers", 1, "--output", "run", cwd=folder)
    assert called.returncode == 0, called.stderr
    assert "Recorded driver" in called.stdout
    return folder / "run"


def test_the_recorded_driver_among_replayed_vehicles_never_crashes(run: Path) -> None:
    found = command_line("show", run, "--json").stdout
    assert '"Recorded driver"' in found
    first = min(run.glob("episodes/*.parquet"))  # the first cell
    assert pl.read_parquet(first)["ending"].unique().to_list() == ["time"]


def test_an_audit_simulates_recorded_episodes_again(run: Path) -> None:
    called = command_line("audit", run, "--workers", 1)
    assert called.returncode == 0, called.stdout
    assert "have the same rows" in called.stdout


def test_an_edge_case_names_the_recorded_moment_at_which_it_starts(
    run: Path, tmp_path: Path
) -> None:
    said = command_line("edge-cases", run, "--ego", "Imitation", "--top", 3, "--json").stdout
    for case in json.loads(said):
        ending = r"starts at recording 1, direction 2, vehicle (\d+), frame (\d+)$"
        vehicle, frame = map(int, re.search(ending, case["what"]).groups())
        cell = ("--ego", "Imitation", "--traffic", case["traffic"])
        output = ("--output", tmp_path / "replay.gif")
        assert command_line("replay", run, case["episode"], *cell, *output).returncode == 0
        found = pl.read_parquet(tmp_path / "replay.trajectories.parquet")
        start = found.filter(pl.col("t_s") == 0.0)
        tracks = pl.read_csv(run.parent / "people" / "01_tracks.csv")
        recorded = tracks.filter(pl.col("id") == vehicle, pl.col("frame") == frame)
        assert recorded.height == 1
        speed = abs(recorded["xVelocity"].item())
        assert np.abs(start["speed"].to_numpy() - speed).min() < 0.05


def test_a_replay_has_vehicles_only_while_they_are_there(run: Path, tmp_path: Path) -> None:
    cell = ("--ego", "Imitation", "--traffic", "Replayed")
    called = command_line("replay", run, 0, *cell, "--output", tmp_path / "replay.gif",
                          "--commonroad", tmp_path / "replay.xml")  # fmt: skip
    assert called.returncode == 0, called.stderr
    found = pl.read_parquet(tmp_path / "replay.trajectories.parquet")
    assert found["x"].min() >= 0.0
    times = found.group_by("vehicle").agg(pl.col("t_s").min().alias("first"), pl.len())
    assert (times["first"] > 0).any()
    assert times["len"].max() > times["len"].min()
    text = (tmp_path / "replay.xml").read_text()
    assert text.count("<dynamicObstacle") == times.height
    assert min(float(x) for x in re.findall("<x>(.*?)</x>", text)) > -200.0


def test_exported_episodes_are_recordings_again(run: Path, tmp_path: Path) -> None:
    cell = ("--ego", "Recorded driver", "--traffic", "Replayed")
    called = command_line("dataset", run, "--format", "highd", *cell, "--output", tmp_path / "out")
    assert called.returncode == 0, called.stderr
    again = next(iter(read_folder(tmp_path / "out")))
    (original,) = read_folder(run.parent / "people")
    assert set(again.tracks["length"].unique()) <= set(original.tracks["length"].unique())
    assert again.lanes == original.lanes


def test_another_agent_can_take_over_a_recorded_vehicle(run: Path, tmp_path: Path) -> None:
    cell = ("--ego", "Recorded driver", "--traffic", "Replayed", "--at", 2, "--agent", "idm_mobil")
    output = ("--output", tmp_path / "what_if.html")
    called = command_line("what-if", run, 0, *cell, "--vehicle", 8, *output)
    assert called.returncode == 0, called.stderr
    absent = command_line("what-if", run, 0, *cell, "--vehicle", 14, *output)
    assert absent.returncode == 2
    assert "vehicle 14 is not there before decision 2 of episode 0" in absent.stderr


def test_the_recorded_driver_takes_over_no_vehicle(run: Path, tmp_path: Path) -> None:
    cell = ("--ego", "Imitation", "--traffic", "Replayed", "--at", 2, "--agent", "recorded")
    called = command_line("what-if", run, 0, *cell, "--output", tmp_path / "what_if.html")
    assert called.returncode == 2
    assert "agent 'recorded' puts vehicles where they were recorded" in called.stderr


def test_a_search_for_escapes_starts_at_the_moments_of_the_run(tmp_path: Path) -> None:
    text = SUITE.replace("duration_s: 2.0", "duration_s: 3.0")
    suite = load_suite(written(tmp_path, text) / "small.yaml")
    finished = run_suite(suite, tmp_path / "run", workers=1)
    cell = find_cell(finished, tmp_path, "Recorded driver", "Reactive")
    searched = _Chunk(cell, collisions(cell), BUDGET)
    assert searched._replays
    for k, replayed in enumerate(searched._replays):
        there = replayed.present[0]
        np.testing.assert_array_equal(searched._kept[0].present[k], there)
        np.testing.assert_array_equal(searched._kept[0].x[k, there], replayed.x[0, there])


def test_without_the_recordings_tables_are_shown_but_nothing_is_simulated(tmp_path: Path) -> None:
    folder = written(tmp_path, SUITE.replace("  - {agent: imitation, label: Imitation}\n", ""))
    words = ("run", "small.yaml", "--workers", 1, "--output")
    assert command_line(*words, "run", cwd=folder).returncode == 0
    (folder / "people").rename(folder / "elsewhere")
    assert command_line("show", folder / "run").returncode == 0
    again = command_line(*words, "again", cwd=folder)
    audit = command_line("audit", folder / "run", "--workers", 1)
    assert (again.returncode, audit.returncode) != (0, 0)
    assert "small.yaml:4: scene.recording" in again.stderr
    assert "people: cannot be read: No such file or directory" in again.stderr
    assert "people: cannot be read: No such file or directory" in audit.stdout + audit.stderr
    assert "Traceback" not in again.stderr + audit.stderr


MISTAKES = [
    ("episodes: 8", "episodes: 90", r"small.yaml:2: episodes: the recordings have 27 moments"),
    ("recording: people", "recording: person", r"small.yaml:4: .*person: cannot be read: No such"),
    ("simulation_hz", "lanes: 9\n  simulation_hz", r"scene.lanes: .* less than or equal to 8"),
    ("simulation_hz", "density: 2.0\n  simulation_hz", "density: the recordings decide this"),
]


@pytest.mark.parametrize(("line", "instead", "message"), MISTAKES)
def test_mistakes_lead_to_their_lines(
    tmp_path: Path, line: str, instead: str, message: str
) -> None:
    folder = written(tmp_path, SUITE.replace(line, instead))
    with pytest.raises(SuiteError, match=message):
        load_suite(folder / "small.yaml")


def test_recorded_drivers_need_a_recording(tmp_path: Path) -> None:
    text = SUITE.replace("  recording: people\n", "")
    called = command_line("run", "small.yaml", cwd=written(tmp_path, text))
    assert called.returncode == 2
    assert "agent 'recorded' drives as recorded; give the suite recordings" in called.stderr
    environment = gymnasium.make("charms_bench/Ego-v0", traffic="recorded")
    with pytest.raises(InputError, match="agent 'recorded' drives as recorded; give the scene"):
        environment.reset(seed=0)


def test_a_scenario_and_a_recording_exclude_each_other(tmp_path: Path) -> None:
    scenario = "{scenario: {ego: {lane: 0, speed_mps: 12}, vehicles: [{name: a, lane: 1, x_m: 9, "
    text = SUITE + f"  - {{traffic: {scenario}speed_mps: 12}}]}}}}, label: Placed}}\n"
    with pytest.raises(SuiteError, match=r"scene\.recording both place vehicles; remove one"):
        load_suite(written(tmp_path, text) / "small.yaml")


def test_rare_rejects_recordings(tmp_path: Path) -> None:
    called = command_line("rare", "small.yaml", cwd=written(tmp_path))
    assert called.returncode == 2
    assert "small.yaml:4: scene.recording: rare draws where vehicles start" in called.stderr
