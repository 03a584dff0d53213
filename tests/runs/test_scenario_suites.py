"""Suites of scenarios: errors with lines, runs, replays, comparisons, preventable collisions."""

import json
from collections import defaultdict
from dataclasses import replace
from pathlib import Path

import numpy as np
import polars as pl
import pytest
from command_line import charms_bench as command_line

import charms_bench
from charms_bench.engine.simulation import Simulation
from charms_bench.episodes.search import Point, Search
from charms_bench.episodes.severity import margins
from charms_bench.errors import InputError, RunFolderError, SuiteError
from charms_bench.metrics import PAPER, STANDARD
from charms_bench.plugins.specs import AgentSpec
from charms_bench.report.audit import audit_tables
from charms_bench.report.preventable_table import crashed
from charms_bench.report.run_files import write_table
from charms_bench.report.suite_table import from_frame, part_of
from charms_bench.runs.suite import load_suite
from charms_bench.world.parameter_points import values_at
from charms_bench.world.scene import Floats, Ints

SUITE = """\
suite: small
episodes: 12
scene:
  profile: {name: charms, speed_min_mps: 0.0, ego_control_rate: simulation}
  duration_s: 8.0
egos:
  - {agent: careful_human, label: Careful}
  - {agent: level_0, label: Level 0}
traffic_models:
  - label: Braking
    traffic:
      scenario:
        parameters: {gap: [5, 70], braking: [5.5, 9]}
        ego: {lane: 1, speed_mps: 30}
        vehicles:
          - name: leader
            lane: 1
            ahead_of: ego
            gap_m: gap
            speed_mps: 30
            actions: [{at_s: 1, acceleration_mps2: -braking}]
  - {traffic: idm_mobil, label: Traffic}
preventable_by: Careful
"""


DRIVEN = """\
            agent: idm_mobil_varied
            driver_parameters: {time_headway_s: gap / 10}
"""


def written(folder: Path, text: str = SUITE, name: str = "small.yaml") -> Path:
    path = folder / name
    path.write_text(text, encoding="utf-8")
    return path


@pytest.mark.parametrize(
    ("line", "instead", "error"),
    [
        ("gap_m: gap", "gap_m: gap - 30", "19: .*gap_m: .*at the point gap"),
        ("lane: 1\n            ahead", "lane: 4\n            ahead", "17: .*lane: lane 4 is not"),
        ("ahead_of: ego", "ahead_of: egg", "18: .*ahead_of: no vehicle named 'egg'.*'ego'"),
        ("gap: [5, 70]", "gap: [70, 5]", "13: .*gap: range: 70 exceeds 5"),
        ("-braking}", "-brake}", "21: .*acceleration_mps2: no parameter named 'brake'"),
        ("by: Careful", "by: Carefull", "preventable_by: no ego called 'Carefull'"),
        ("by: Careful", "by: [Careful, Careful]", "preventable_by: 'Careful' is given twice"),
        ("by: Careful", "by: [Careful, Level 0, a]", "preventable_by: .*at most 2"),
        ("        ego: {", "        points: grid\n        ego: {", "14: .*points: has 25 points"),
        (
            "        ego: {",
            "        points: [{gap: 80, braking: 6}]\n        ego: {",
            r"14: .*points\[0\].gap: 80 is out of range; expected 5 to 70",
        ),
    ],
)
def test_a_mistake_in_a_scenario_names_its_line(
    tmp_path: Path, line: str, instead: str, error: str
) -> None:
    text = SUITE.replace(line, instead).replace("episodes: 12", "episodes: 30")
    with pytest.raises(SuiteError, match=error):
        load_suite(written(tmp_path, text))


def test_a_scene_of_a_suite_cannot_place_vehicles_itself(tmp_path: Path) -> None:
    scenario = "  scenario: {ego: {lane: 0, speed_mps: 9}, vehicles: [{name: a, lane: 1, x_m: 9, "
    text = SUITE.replace("  duration_s", f"{scenario}speed_mps: 9}}]}}\n  duration_s")
    with pytest.raises(SuiteError, match="give the scenario as a traffic"):
        load_suite(written(tmp_path, text))


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> charms_bench.Run:
    folder = tmp_path_factory.mktemp("scenarios")
    return charms_bench.run(written(folder), folder / "run", workers=1)


def test_each_point_is_an_episode_and_vehicles_start_where_they_are_placed(
    run: charms_bench.Run,
) -> None:
    scenario = run.suite.traffics[0].traffic.scenario
    assert scenario is not None
    gaps = values_at(scenario, np.arange(12))["gap"]
    first = run.steps.filter(
        (pl.col("step") == 1) & (pl.col("traffic") == "Braking") & (pl.col("agent") == "Careful")
    ).sort("episode")
    # In the first third of a second, nobody brakes; vehicles are 5 m long.
    np.testing.assert_allclose(first["leader_distance"], gaps + 5, atol=1e-3)


def test_a_scenario_is_replayed_as_it_was_run(run: charms_bench.Run) -> None:
    replay = run.replay(3, "Level 0", "Braking")
    assert replay.agents == ("level_0", "prescribed")
    scenario = run.suite.traffics[0].traffic.scenario
    assert scenario is not None
    braking = values_at(scenario, np.array([3]))["braking"][0]
    expected = np.clip(30 - braking * (replay.t_s - 1), 0, 30)
    is_intact = ~replay.crashed[:, 1]
    np.testing.assert_allclose(replay.speed[is_intact, 1], expected[is_intact], atol=1e-9)
    assert is_intact.sum() > 30


def test_preventable_collisions_are_those_that_the_careful_driver_avoids(
    run: charms_bench.Run,
) -> None:
    cells = {(cell.agent, cell.traffic): crashed(cell) for cell in run.cells}
    careful, other = cells["Careful", "Braking"], cells["Level 0", "Braking"]
    assert careful.any()
    assert (other & ~careful).any()
    table = run.tables["small-preventable"]
    definitions = {column.name: column.definition for column in table.columns}
    assert definitions["preventable"].endswith("does so and Careful does not")
    numbers = {row.labels: [number.value for number in row.numbers] for row in table.rows}
    found = [other.mean(), (other & ~careful).mean()]
    assert numbers["Level 0", "Braking"][:2] == pytest.approx(found)
    # The careful driver brakes by 0.774 g at most.
    assert numbers["Careful", "Braking"][2] == pytest.approx(0.774 * 9.81, abs=0.01)
    assert numbers["Level 0", "Braking"][3:] == pytest.approx([(other & careful).mean(), 0.0])
    assert numbers["Careful", "Braking"][1] == 0
    assert (run.path / "figures" / "small-preventable.png").stat().st_size > 10_000


def test_of_each_collision_it_is_said_whether_it_is_preventable(run: charms_bench.Run) -> None:
    found = run.edge_cases(50, ego="Level 0", traffic="Braking")
    cells = {(cell.agent, cell.traffic): crashed(cell) for cell in run.cells}
    careful, other = cells["Careful", "Braking"], cells["Level 0", "Braking"]
    words = {True: {True: "no", False: "yes"}, False: {True: None, False: None}}
    expected = [words[bool(other[k])][bool(careful[k])] for k in range(12)]
    assert {case.episode: case.preventable for case in found} == dict(enumerate(expected))
    shown = command_line("edge-cases", run.path, "--ego", "Level 0", "--traffic", "Braking")
    assert "preventable" in shown.stdout.lower()


PILE_UPS = """\
suite: blocked
episodes: 3
scene:
  profile: {name: charms, speed_min_mps: 0.0, ego_control_rate: simulation}
  duration_s: 5.0
egos:
  - {agent: careful_human, label: Careful}
  - {agent: level_0, label: Level 0}
traffic_models:
  - label: Blocked
    traffic:
      scenario:
        parameters: {gap: [5, 900]}
        points: [{gap: 900}, {gap: 20}, {gap: 300}]
        ego: {lane: 1, speed_mps: 30}
        vehicles:
          - {name: leader, lane: 1, ahead_of: ego, gap_m: 40, speed_mps: 28}
          - {name: blocking, lane: 1, ahead_of: leader, gap_m: gap, speed_mps: 0}
preventable_by: Careful
"""
"""The leader reaches the stationary vehicle at the second point alone, and the ego both."""


@pytest.fixture(scope="module")
def blocked(tmp_path_factory: pytest.TempPathFactory) -> charms_bench.Run:
    folder = tmp_path_factory.mktemp("blocked")
    return charms_bench.run(written(folder, PILE_UPS), folder / "run", workers=1)


def test_scenarios_in_which_prescribed_vehicles_collide_are_left_out(
    blocked: charms_bench.Run,
) -> None:
    assert [cell.episodes["episode"].to_list() for cell in blocked.cells] == [[0, 2]] * 2
    assert blocked.edge_cases(kind="collision") == []
    assert blocked.avoidability() == []
    crashes = blocked.compare(egos=("Careful", "Level 0"), metrics=["crashed_episodes"])
    assert crashes.records()[0]["second_value"] == 0.0
    assert blocked.replay(1, "Level 0").crashed[-1].sum() >= 2


def test_how_many_scenarios_are_left_out_stands_with_every_table(
    blocked: charms_bench.Run,
) -> None:
    said = "prescribed vehicles collide with one another: 1 of 3 of Blocked."
    tables = blocked.tables
    for name, column in (("blocked", "metric"), ("blocked-preventable", "share")):
        assert said in tables[name].note
        rows = pl.read_csv(blocked.path / "tables" / f"{name}.csv").filter(
            pl.col(column) == "scenarios_left_out"
        )
        np.testing.assert_allclose(rows.select("value", "n"), [(1 / 3, 3)] * 2, rtol=1e-5)
        assert said in (blocked.path / "tables" / f"{name}.md").read_text(encoding="utf-8")
    assert said in blocked.rescore("paper").note


def test_a_table_of_before_is_audited_with_the_scenarios_that_it_had(
    blocked: charms_bench.Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    whole = replace(blocked._finished, leaves_out=False)
    sets = (PAPER, STANDARD)
    before = pl.concat(part_of(blocked.suite, each, sets) for each in whole.cells())
    write_table(blocked.path, from_frame(before, blocked.suite, sets))
    monkeypatch.setattr("charms_bench.report.audit.module_blobs", lambda: defaultdict(str))
    found = [each for each in audit_tables(blocked.path, blocked.suite) if each.where]
    assert {each.verdict for each in found} == {"unknown"}
    assert "tables/blocked.csv" not in [each.where for each in found]
    blocked.rescore()


def test_a_suite_of_pile_ups_alone_is_rejected_before_it_runs(tmp_path: Path) -> None:
    text = PILE_UPS.replace("{gap: 900}, {gap: 20}, {gap: 300}", "{gap: 5}, {gap: 20}, {gap: 30}")
    with pytest.raises(SuiteError, match=r"Blocked: prescribed vehicles collide .* every concrete"):
        charms_bench.run(written(tmp_path, text), tmp_path / "run", workers=1)
    assert not list((tmp_path / "run").rglob("*.parquet"))


def test_a_pile_up_is_no_failure_of_a_search(tmp_path: Path) -> None:
    text = PILE_UPS.replace("        points: [{gap: 900}, {gap: 20}, {gap: 300}]\n", "")
    text = text.replace("gap: [5, 900]", "gap: [5, 130]").replace("preventable_by: Careful", "")
    suite, folder = written(tmp_path, text), tmp_path / "search"
    made = charms_bench.search(suite, "Level 0", output=folder, budget=40)
    assert (made.failures, made.left_out) == ([], made.simulations)


def test_agents_in_scenarios_are_compared(run: charms_bench.Run) -> None:
    table = run.compare(egos=("Careful", "Level 0"), metrics=["crashed_episodes"])
    assert {"Braking", "Traffic"} <= {label for row in table.rows for label in row.labels}


def test_a_search_finds_failures_that_run_as_a_suite(tmp_path: Path) -> None:
    found = tmp_path / "search" / "found.yaml"
    suite = written(tmp_path)
    made = charms_bench.search(suite, "Level 0", "Braking", found.parent, failures=3, budget=400)
    assert len(made.failures) == 3
    assert made.simulations_to_first is not None
    again = charms_bench.run(found, tmp_path / "again", workers=1)
    cells = {cell.agent: crashed(cell) for cell in again.cells}
    assert cells["Level 0"].tolist() == [True] * 3
    assert cells["Careful"].tolist() == [False] * 3


class Drawing(Search):
    """The ego always collides; the reference driver only from the second episode of failures on."""

    _draws = True

    def _margins(self, agent: AgentSpec, points: list[Point], first: int = 0) -> Floats:
        is_avoided = agent.name == "careful_human" and first == 0
        return np.full((len(points), 1), 1.0 if is_avoided else -1.0)


def test_a_failure_among_agents_that_draw_is_one_in_its_own_episode(tmp_path: Path) -> None:
    suite = load_suite(written(tmp_path))
    (cell,) = (each for each in suite.cells if each.title == "Level 0 in Braking")
    search = Drawing(cell, [suite.egos[0]], tmp_path)
    search.values(np.linspace(0.1, 0.9, 6).reshape(3, 2))
    assert search.preventable_by == [["Careful"]]
    assert len(search.failures) == 1


def test_every_failure_of_the_project_cut_in_is_one_again_and_only_once(tmp_path: Path) -> None:
    found = tmp_path / "search" / "found.yaml"
    suite = Path(__file__).parents[2] / "suites" / "r157.yaml"
    made = charms_bench.search(suite, "Imitation Learning", "Cut-in", found.parent, failures=5)
    points = [tuple(point.values()) for point in made.failures]
    assert len(points) == len(set(points)) == 5
    run = charms_bench.run(found, tmp_path / "run", workers=1)
    table = run.tables["found-preventable"]
    (ego,) = (each for each in table.records() if each["agent"] == "Imitation Learning")
    # Each is preventable by one of the two careful drivers, or by both.
    assert (ego["crashed"], ego["not_preventable"]) == (1.0, 0.0)


def test_a_search_says_under_which_rule_a_failure_is_preventable(tmp_path: Path) -> None:
    found = tmp_path / "search" / "found.yaml"
    suite = Path(__file__).parents[2] / "suites" / "r157.yaml"
    made = charms_bench.search(suite, "IDM+MOBIL", "Cut-in", found.parent, failures=3)
    clear, standstill = made.references[0].title, made.references[1].title
    assert made.preventable_by == [[clear]] * 3
    table = charms_bench.run(found, tmp_path / "run", workers=1).tables["found-preventable"]
    of_agent = {each["agent"]: each for each in table.records()}
    shown = of_agent["IDM+MOBIL"]
    assert (shown["crashed"], shown["preventable"], shown["not_preventable"]) == (1.0, 0.0, 0.0)
    assert shown[f"preventable only by {clear}"] == 1.0
    assert shown[f"preventable only by {standstill}"] == 0.0
    assert of_agent[clear]["crashed"] == 0.0
    assert of_agent[standstill]["crashed"] == 1.0


def test_a_search_without_failures_writes_no_suite(tmp_path: Path) -> None:
    text = SUITE.replace("gap: [5, 70]", "gap: [300, 400]")
    made = charms_bench.search(
        written(tmp_path, text), "Level 0", "Braking", tmp_path / "search", budget=40
    )
    assert made.failures == []
    assert not (tmp_path / "search" / "found.yaml").exists()


def test_a_search_simulates_no_more_points_at_first_than_its_budget(tmp_path: Path) -> None:
    text = SUITE.replace("gap: [5, 70]", "gap: [300, 400]")
    suite, folder = written(tmp_path, text), tmp_path / "search"
    assert charms_bench.search(suite, "Level 0", output=folder, budget=5).simulations == 5


def test_a_scenario_on_a_road_is_searched_and_its_failures_run_there(tmp_path: Path) -> None:
    found = tmp_path / "search" / "found.yaml"
    suite = written(tmp_path, SUITE.replace("egos:", "roads: [merge-v1]\negos:"))
    made = charms_bench.search(suite, "Level 0", "Braking", found.parent, failures=2, budget=200)
    assert made.cell.title == "Level 0 in merge-v1, Braking"
    again = charms_bench.run(found, tmp_path / "again", workers=1)
    cells = {cell.agent: crashed(cell).tolist() for cell in again.cells}
    assert cells == {"Level 0": [True] * 2, "Careful": [False] * 2}


def test_an_agent_beside_the_egos_is_searched_and_shown(tmp_path: Path) -> None:
    suite, folder = written(tmp_path), tmp_path / "found"
    words = ("--agent", "level_0", "--traffic", "Braking", "--failures", 2, "--output", folder)
    made = command_line("search", suite, *words)
    assert made.returncode == 0, made
    assert "level_0 in Braking: 2 failures" in made.stdout
    shown = command_line("show", folder)
    assert "found.yaml" in shown.stdout, shown
    assert len(json.loads(command_line("show", folder, "--json").stdout)["failures"]) == 2
    page = tmp_path / "found.html"
    assert command_line("report", folder, "--output", page).returncode == 0
    assert "Failures of a search: found" in page.read_text(encoding="utf-8")


@pytest.mark.parametrize(
    ("agent", "traffic", "error"),
    [
        ("Level 9", "Braking", "no agent named 'Level 9'.*Did you mean 'Level 0'"),
        ("Level 0", "Brakes", "--traffic: none called 'Brakes' can be searched.*Known: Braking"),
        ("Level 0", "Traffic", "--traffic: none called 'Traffic' can be searched"),
        ("mine.onnx", "Braking", "--ego mine.onnx .*; give a network's file with --agent"),
    ],
)
def test_a_search_names_what_it_can_search(
    tmp_path: Path, agent: str, traffic: str, error: str
) -> None:
    with pytest.raises(InputError, match=error):
        charms_bench.search(written(tmp_path), agent, traffic, tmp_path / "search")


@pytest.mark.parametrize(
    ("instead", "error"),
    [
        (
            "time_headway: 1",
            "22: .*'idm_mobil_varied' has no parameter 'time_headway'. Did you mean ",
        ),
        ("time_headway_s: gap / 10", "22: .*time_headway_s: .* is out of range; expected 0.6 to 2"),
        ("time_headway_s: gap + gip", "22: .*no parameter named 'gip'. Did you mean 'gap'"),
    ],
)
def test_wrong_parameters_of_a_driver_are_rejected_with_their_line(
    tmp_path: Path, instead: str, error: str
) -> None:
    actions = "            actions: [{at_s: 1, acceleration_mps2: -braking}]\n"
    text = SUITE.replace(actions, DRIVEN.replace("time_headway_s: gap / 10", instead))
    with pytest.raises(SuiteError, match=error):
        load_suite(written(tmp_path, text))


def test_an_interrupted_search_continues_without_repeating_simulations(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked = written(tmp_path), "Level 0", "Braking"
    expected = charms_bench.search(*asked, tmp_path / "whole", failures=9, budget=200)
    charms_bench.search(*asked, tmp_path / "search", failures=9, budget=40)
    files = sorted((tmp_path / "search" / "runs").glob("*.json"))
    files[0].write_text("{", encoding="utf-8")
    made: list[int] = []

    def noted(simulation: Simulation, seeds: Ints) -> Floats:
        made.append(seeds.size)
        return margins(simulation, seeds)

    monkeypatch.setattr("charms_bench.episodes.search.margins", noted)
    continued = charms_bench.search(*asked, tmp_path / "search", failures=9, budget=200)
    assert continued.failures == expected.failures
    assert continued.simulations == expected.simulations
    assert 0 < sum(made) < expected.simulations
    found = [tmp_path / name / "found.yaml" for name in ("whole", "search")]
    assert found[0].read_bytes() == found[1].read_bytes()
    everything = [len(list((tmp_path / name / "runs").iterdir())) for name in ("whole", "search")]
    assert everything[0] == everything[1]


def test_a_search_does_not_change_a_folder_with_something_else(tmp_path: Path) -> None:
    path = written(tmp_path, name="found.yaml")
    with pytest.raises(RunFolderError, match=r"is not empty and holds no search"):
        charms_bench.search(path, "Level 0", output=tmp_path, failures=1, budget=40)
    assert path.read_text(encoding="utf-8") == SUITE
    charms_bench.search(path, "Level 0", output=tmp_path / "one", failures=1, budget=40)
    with pytest.raises(RunFolderError, match=r"holds another search: search.seed was 0, now 1"):
        charms_bench.search(path, "Level 0", output=tmp_path / "one", failures=1, seed=1)
