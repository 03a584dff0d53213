"""Suites on highway-env's roads: rows, tables, resumed runs and replays."""

import json
import shutil
from collections.abc import Callable
from html import unescape
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import polars as pl
import pytest
from command_line import charms_bench
from hypothesis import given, settings
from hypothesis import strategies as st
from pydantic import ValidationError
from scenes import scene_of

from charms_bench import read_road
from charms_bench.api import open_run
from charms_bench.api.evaluation import run as run_file
from charms_bench.engine.collision_kinds import (
    ANY_ANGLE,
    REAR_END_COS,
    STRIKING,
    note_collisions,
)
from charms_bench.engine.collision_kinds import SIDE_COLLISION as SIDE
from charms_bench.errors import InputError, RunFolderError, SuiteError
from charms_bench.humans.population import read_population
from charms_bench.metrics import ROADS
from charms_bench.roads.defaults import DEFAULTS
from charms_bench.roads.settings import on_road, reject_of_straight_roads
from charms_bench.runs.likeness import standard
from charms_bench.runs.suite import Suite, load_suite
from charms_bench.world.named_road import NamedRoad
from charms_bench.world.road import local_coordinates
from charms_bench.world.scene import SceneSettings

TEXT = """
suite: small-roads
episodes: 3
scene:
  profile: {name: charms, speed_min_mps: 0.0, target_speed_min_mps: 0.0}
egos: [{agent: idm_mobil}, {agent: charms}]
roads: [merge-v0, {name: u-turn-v1, label: Bend}]
traffic_models: [{traffic: environment}, {traffic: {mixture: {human: 0.5, charms: 0.5}}}]
columns: [goal_reached, time_to_goal, entry_lag_gap]
"""


BEND = {"ego": "charms", "road": "Bend", "traffic": "environment"}


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Any:
    folder = tmp_path_factory.mktemp("roads")
    path = folder / "roads.yaml"
    path.write_text(TEXT)
    return run_file(path, folder / "run", workers=1)


def test_tables_have_the_goals_of_every_ego_on_every_road(made: Any) -> None:
    table = made.table.frame().filter(pl.col("metric") == "goal_reached")
    assert table["road"].to_list() == ["merge-v0", "merge-v0", "Bend", "Bend"] * 2
    assert table["traffic"].to_list() == ["environment", "human + charms"] * 4
    assert table["value"].is_between(0, 1).all()
    reached = (made.episodes["ending"] == "goal").sum()
    assert table["value"].sum() * 3 == pytest.approx(reached)
    assert (made.path / "tables" / "small-roads-matrix.md").exists()


def test_recorded_vehicles_are_sent_to_their_own_lanes() -> None:
    with pytest.raises(InputError, match=r"remove scene.recording. Recorded .*start: recorded"):
        reject_of_straight_roads(NamedRoad(name="merge-v0"), ["recording"])


def test_a_straight_road_has_no_goal_to_reach() -> None:
    reached = next(each for each in ROADS.metrics if each.name == "goal_reached")
    rows = pl.DataFrame({"ending": ["time", "time", "goal"], "has_goal": [None, True, True]})
    sums = [row.select(*reached.sums).row(0) for row in rows.iter_slices(1)]
    values = reached.value(np.array([sums[0], np.sum(sums[1:], axis=0)], dtype=float))
    np.testing.assert_array_equal(values, [np.nan, 0.5])


def test_a_replay_is_the_recorded_episode_on_the_network(made: Any, tmp_path: Path) -> None:
    replay = made.replay(1, ego="charms", road="Bend", traffic="environment")
    assert replay.plan is not None
    assert replay.plan.x.shape == replay.x.shape
    start = made.steps.filter(agent="charms", road="Bend", traffic="environment", episode=1, step=1)
    frame = replay.frame_of(1)
    assert replay.x[frame, 0] == pytest.approx(start["x"][0], rel=1e-6)
    # The u-turn begins at (0, 44) and leads to larger x.
    assert replay.plan.x[0, 0] == pytest.approx(0.0, abs=1e-9)
    assert replay.plan.y[0, 0] == pytest.approx(44.0, abs=1e-9)
    replay.animate(tmp_path / "bend.gif")
    assert (tmp_path / "bend.gif").stat().st_size > 10_000


def test_an_episode_that_ends_at_the_goal_is_not_a_collision(made: Any) -> None:
    cases = made.edge_cases(100)
    assert {"goal", "time"} & {case.ending for case in cases}
    for case in cases:
        assert (case.criticality > 4) == (case.ending not in ("goal", "time"))
    listed = made.edge_cases(100, kind="collision")
    assert "goal" not in {case.ending for case in listed}


@pytest.mark.parametrize(
    ("road", "traffic", "vehicle"),
    [("Bend", "environment", None), ("merge-v0", "human + charms", 1)],
)
def test_what_if_changes_nothing_before_its_decision(
    made: Any, road: str, traffic: str, vehicle: int | None
) -> None:
    place = {"ego": "charms", "road": road, "traffic": traffic}
    told = made.what_if(1, 3, "stackelberg", vehicle, **place)
    start = told.start + 1
    assert told.other.agents[vehicle or 0] == "stackelberg"
    for name in ("x", "y", "heading"):
        recorded, other = getattr(told.recorded.plan, name), getattr(told.other.plan, name)
        np.testing.assert_array_equal(recorded[:start], other[:start])
    assert not np.array_equal(told.recorded.plan.x[start + 30], told.other.plan.x[start + 30])


def test_a_planner_takes_over_in_a_recorded_episode(made: Any) -> None:
    told = made.what_if(1, 2, agent="mpc", ego="charms", road="Bend", traffic="environment")
    assert told.other.agents[0] == "mpc"
    assert not np.array_equal(told.recorded.plan.x[told.start + 30], told.other.plan.x[-1])


@pytest.mark.parametrize(
    "describe_as_straight",
    [
        lambda made, path: made.dataset("highd", output=path, **BEND),
        lambda made, path: standard(made.suite, path, read_population("i75")),
    ],
)
def test_what_knows_only_the_straight_road_rejects_others(
    made: Any, tmp_path: Path, describe_as_straight: Callable[[Any, Path], object]
) -> None:
    with pytest.raises(InputError, match=r"straight road, not the road '(merge-v0|u-turn-v1)'"):
        describe_as_straight(made, tmp_path / "new")


def test_the_roads_of_a_suite_are_compared_with_highway_env(made: Any) -> None:
    suite = made.path.parent / "roads.yaml"
    done = charms_bench("verify", "--suite", suite, "--episodes", 2, "--workers", 1, "--json")
    assert done.returncode == 0, done.stderr
    found = {row["case"]: row for row in json.loads(done.stdout)}
    assert [*found] == ["merge-v0", "Bend"]
    for row in found.values():
        assert (row["episodes"], row["differences"], row["largest"]) == (2, [], 0.0)


def test_the_vehicle_from_the_ramp_is_measured_on_merges_only(made: Any) -> None:
    rows = made.episodes.with_columns(is_bend=pl.col("road") == "Bend")
    entries = rows.filter(~pl.col("is_bend"))
    assert rows.filter("is_bend")["entry_lag_gap_m"].null_count() == 12
    assert entries["entry_lag_gap_m"].null_count() < len(entries)
    assert entries["entry_lag_gap_m"].drop_nulls().is_between(0, 100).all()


def test_trajectories_are_those_of_all_vehicles_on_the_network(made: Any) -> None:
    replay = made.replay(1, ego="charms", road="merge-v0", traffic="environment")
    there = replay.plan.present.copy()
    rows = replay.trajectories()
    np.testing.assert_array_equal(replay.plan.present, there)
    vehicles = there & ~replay.plan.is_obstacle
    seen = replay.present & ~replay.plan.is_obstacle  # in the ego's view of the road
    assert there.sum() > rows.height == vehicles.sum() > seen.sum()
    np.testing.assert_array_equal(rows["x"], replay.plan.x[vehicles])
    moved = rows.group_by("vehicle", maintain_order=True).agg(
        (pl.col("x").diff().pow(2) + pl.col("y").diff().pow(2)).sqrt().max().alias("step_m"),
        (pl.col("speed").abs().max() / 15).alias("most_m"),
    )
    assert (moved["step_m"] <= 1.2 * moved["most_m"] + 0.1).all()
    road = replay.plan.road
    for x, y, lane in rows.sample(100, seed=1).select("x", "y", "lane").iter_rows():
        s, beside = local_coordinates(road, lane, x, y)
        assert abs(beside) <= 2.5
        assert -5.0 <= s <= road.lanes["length"][lane] + 5.0


def test_a_commonroad_scenario_has_the_real_lanes(made: Any, tmp_path: Path) -> None:
    replay = made.replay(1, **BEND)
    replay.write_commonroad(tmp_path / "bend.xml")
    table = replay.plan.road.lanes
    root = ElementTree.parse(tmp_path / "bend.xml").getroot()
    assert len(root.findall("lanelet")) == table.size
    read = read_road(tmp_path / "bend.xml")
    lengths = [lane.length for road in read.roads for lane in road.lanes]
    np.testing.assert_allclose(sorted(lengths), sorted(table["length"]), rtol=1e-3)
    for lanelet, row in zip(root.findall("lanelet"), table, strict=True):
        follows = {int(each.get("ref", "0")) - 1 for each in lanelet.findall("successor")}
        first = row["next_roads"]
        roads = replay.plan.road.successors[first : first + row["next_count"]]
        assert {table["first"][lane] for lane in follows} == {*roads.tolist()}
    ego = root.find("planningProblem/initialState/position/point")
    assert ego is not None
    assert float(ego.findtext("y", "")) == pytest.approx(-44.0)
    vehicles = replay.plan.present.any(axis=0) & ~replay.plan.is_obstacle[0]
    assert len(root.findall("dynamicObstacle")) == vehicles.sum()


def test_fault_on_roads_is_in_a_column_of_its_own(made: Any) -> None:
    crashed = pl.col("ending").is_in(["rear_end", "side", "off_road"])
    on_road, others = made.episodes.filter(crashed), made.episodes.filter(~crashed)
    assert made.episodes["at_fault"].is_null().all()
    assert on_road["at_fault_on_road"].null_count() <= 0.05 * on_road.height
    assert others["at_fault_on_road"].is_null().all()
    of_sides = on_road["ending"].is_in(["side", "off_road"])
    assert on_road["struck"].null_count() == of_sides.sum()
    drivers = made.tables["small-roads-drivers"].frame().filter(metric="crashed_at_fault")
    assert {*drivers.drop_nulls("value")["driver"]} == {"environment", "human", "charms"}


@pytest.mark.parametrize(("heading", "kind"), [(0.0, STRIKING), (0.4, STRIKING), (0.5, SIDE)])
def test_vehicles_at_an_angle_collide_at_their_sides(heading: float, kind: int) -> None:
    scene = scene_of(x=[0.0, 4.9], y=[4.0, 4.0], heading=[0.0, heading], crashed=True)
    scene.direction_x[:], scene.direction_y[:] = np.cos(scene.heading), np.sin(scene.heading)
    collision = np.zeros((1, 2), dtype=np.int8)
    for least_cos, expected in ((ANY_ANGLE, STRIKING), (REAR_END_COS, kind)):
        collision[:] = 0
        note_collisions(scene, collision, least_cos)
        assert collision[0, 0] == expected


def test_the_report_does_not_say_that_a_road_has_the_lanes_of_the_scene(made: Any) -> None:
    page = unescape(made.report(made.path / "report.html").read_text(encoding="utf-8"))
    assert "highway-env's roads and vehicles" in page
    assert "density 1" not in page


def test_the_time_to_the_goal_counts_episodes_with_the_goal_only() -> None:
    rows = {"episode": [0, 1, 2], "ending": ["goal", "time", "goal"], "steps": [3, 9, 6]}
    on_roads = {"has_goal": [True] * 3}
    episodes = pl.DataFrame({**rows, "duration_s": [1.0, 3.0, 2.0], **on_roads})
    reached, time = ROADS.metrics[:2]
    sums = episodes.group_by("episode", maintain_order=True).agg(
        *(
            each.cast(pl.Float64).alias(f"{m.name} {k}")
            for m in (reached, time)
            for k, each in enumerate(m.sums)
        )
    )
    totals = sums.fill_null(0.0).sum()
    assert totals["goal_reached 1"].item() / totals["goal_reached 0"].item() == pytest.approx(2 / 3)
    assert totals["time_to_goal 1"].item() / totals["time_to_goal 0"].item() == pytest.approx(1.5)


def test_suites_without_roads_keep_their_fingerprint() -> None:
    suite = Suite.model_validate(
        {
            "suite": "s",
            "episodes": 1,
            "egos": [{"agent": "idm_mobil"}],
            "traffic_models": [{"traffic": "idm_mobil"}],
        }
    )
    assert "roads" not in suite.model_dump(mode="json")
    assert "network" not in suite.model_dump(mode="json")["scene"]


@pytest.mark.parametrize("field", ["lanes", "traffic_vehicles", "density", "ego_slots"])
def test_a_scene_says_nothing_that_a_road_decides(field: str) -> None:
    with pytest.raises(InputError, match=f"merge-v0.*remove scene.{field}"):
        on_road(SceneSettings.model_validate({field: 7}), NamedRoad(name="merge-v0"))


@pytest.mark.parametrize(
    ("road", "scene", "instead"),
    [
        ("exit-v1", "lanes: 3", "lanes_count"),
        ("merge-generic-v1", "traffic_vehicles: 20", "vehicles_count"),
        ("racetrack-v1", "traffic_vehicles: 20", "other_vehicles"),
        ("highway-v0", "density: 1.0", "vehicles_density"),
    ],
)
def test_a_key_for_straight_roads_names_that_of_the_road(
    road: str, scene: str, instead: str, tmp_path: Path
) -> None:
    field = scene.partition(":")[0]
    path = tmp_path / "suite.yaml"
    what = f"scene: {{{scene}}}\negos: [{{agent: idm_mobil}}]\nroads: [{road}]\n"
    path.write_text(f"suite: s\nepisodes: 1\n{what}")
    what = f"remove scene.{field}, or give the road configuration.{instead} instead"
    with pytest.raises(SuiteError, match=what):
        load_suite(path)


def parsed(**keys: object) -> Suite:
    given = {"suite": "s", "episodes": 1, "egos": [{"agent": "idm_mobil"}], **keys}
    return Suite.model_validate(given)


def test_a_road_as_a_traffic_model_says_what_to_write(tmp_path: Path) -> None:
    old = """traffic_models:
  - traffic: {road: merge-v0}
  - traffic: {road: u-turn-v1}
    label: Bend
  - traffic: {road: merge-v0, drivers: human}
"""
    path = tmp_path / "old.yaml"
    path.write_text(f"suite: old\nepisodes: 1\negos: [{{agent: idm_mobil}}]\n{old}")
    with pytest.raises(SuiteError) as raised:
        load_suite(path)
    where, *lines, what = str(raised.value).splitlines()
    assert where.startswith(f"{path}:5: traffic_models[0].traffic.road: a road is no traffic model")
    assert what == "which is every road in every traffic model; use several suites for fewer cells"
    path.write_text(path.read_text().replace(old, "\n".join(lines)))
    titles = [each.title for each in load_suite(path).surroundings]
    assert titles == ["merge-v0", "merge-v0, human", "Bend", "Bend, human"]


@pytest.mark.parametrize(
    ("keys", "durations_s"),
    [
        ({"scene": {"duration_s": 45.0}}, [45.0, 45.0, 7.0]),
        ({}, [45.0, 10.0, 7.0]),  # a merge has no end, a u-turn lasts 10 s
    ],
)
def test_an_episode_is_as_long_as_the_road_says(
    keys: dict[str, object], durations_s: list[float]
) -> None:
    roads = ["merge-v0", "u-turn-v0", {"name": "exit-v0", "duration_s": 7.0}]
    suite = parsed(roads=roads, **keys)
    again = Suite.model_validate(suite.model_dump(mode="json"))
    for each in (suite, again):
        assert [cell.scene.duration_s for cell in each.cells] == durations_s


def test_a_road_has_its_configuration() -> None:
    wide = {"name": "merge-generic-v1", "configuration": {"lanes_count": 5}, "label": "Wide"}
    narrow, wider = parsed(roads=["merge-generic-v1", wide]).cells
    assert (narrow.scene.lanes, wider.scene.lanes) == (2 + 1, 5 + 1)  # with the ramp
    assert [each.surroundings.title for each in (narrow, wider)] == ["merge-generic-v1", "Wide"]


@pytest.mark.parametrize(
    ("roads", "what"),
    [
        (["merge-v0", "merge-v0"], "two roads are called 'merge-v0'; give them different labels"),
        (["merge-v9"], r":4: roads\[0\]: no road named 'merge-v9'.*Did you mean 'merge-v"),
        (
            [{"name": "merge-generic-v0", "configuration": {"lanes": 3}}],
            r":4: roads\[0\]: configuration: no key named 'lanes'",
        ),
        (
            [{"name": "exit-v0", "configuration": {"duration": 9}}],
            "configuration.duration: give duration_s beside the road's name",
        ),
        (
            [{"name": "merge-v0", "configuration": {"controlled_vehicles": 2}}],
            "configuration.controlled_vehicles: 2; this environment has one ego",
        ),
        (["parking-v0"], "no road named 'parking-v0'"),
    ],
)
def test_a_road_that_cannot_be_is_one_message(tmp_path: Path, roads: object, what: str) -> None:
    path = tmp_path / "suite.yaml"
    path.write_text(
        f"suite: s\nepisodes: 1\negos: [{{agent: idm_mobil}}]\nroads: {json.dumps(roads)}"
    )
    with pytest.raises(SuiteError, match=what):
        load_suite(path)


VALUES = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=5),
    lambda inner: st.lists(inner, max_size=2) | st.dictionaries(st.text(max_size=3), inner),
    max_leaves=4,
)


def problem_of(road: dict[str, Any]) -> str:
    """What is wrong with a road; if nothing is, what it has."""
    try:
        return repr(on_road(SceneSettings(), NamedRoad.model_validate(road)).network)
    except (InputError, ValidationError) as error:
        return str(error)


@settings(max_examples=60, deadline=None)
@given(
    name=st.sampled_from(["merge-generic-v1", "roundabout-generic-v0", "racetrack-oval-v0"]),
    drawn=st.data(),
)
def test_any_configuration_is_a_road_or_one_message(name: str, drawn: st.DataObject) -> None:
    keys = st.sampled_from(sorted(DEFAULTS[name]))
    configuration = drawn.draw(st.dictionaries(keys, VALUES, min_size=1, max_size=2))
    assert "configuration" in problem_of({"name": name, "configuration": configuration})


@pytest.mark.parametrize(
    ("keys", "what"),
    [
        ({"traffic_models": [{"traffic": "environment"}]}, "`environment` is that of `roads`"),
        ({"scene": {"road": "merge-v0"}}, "give it as one of the suite's `roads`"),
    ],
)
def test_only_roads_have_an_environment(keys: dict[str, object], what: str) -> None:
    with pytest.raises(ValidationError, match=what):
        parsed(**keys)


def test_pairs_of_egos_are_those_on_the_same_road(made: Any, tmp_path: Path) -> None:
    text = TEXT.split("traffic_models")[0] + "pairs: true\n"
    path = tmp_path / "pairs.yaml"
    path.write_text(text)
    pairs = run_file(path, tmp_path / "run", workers=1).tables["small-roads-pairs"].frame()
    assert pairs["road"].unique(maintain_order=True).to_list() == ["merge-v0", "Bend"]
    assert set(zip(pairs["first"], pairs["second"], strict=True)) == {("idm_mobil", "charms")}


def test_the_road_is_a_key_of_edge_cases_and_comparisons(made: Any) -> None:
    assert {case.road for case in made.edge_cases(100, road="Bend")} == {"Bend"}
    compared = made.compare(egos=("idm_mobil", "charms"), metrics=["speed_mean"])
    assert [row.labels[2:4] for row in compared.rows][::2] == [
        (road, traffic)
        for road in ("merge-v0", "Bend")
        for traffic in ("environment", "human + charms")
    ]


def test_a_folder_in_which_roads_are_traffic_says_how_to_make_it_again(
    made: Any, tmp_path: Path
) -> None:
    old = shutil.copytree(made.path, tmp_path / "old")
    manifest = json.loads((old / "manifest.json").read_text())
    del manifest["suite"]["roads"]
    manifest["suite"]["traffics"] = [{"traffic": {"road": "merge-v0"}, "label": None}]
    (old / "manifest.json").write_text(json.dumps(manifest))
    with pytest.raises(RunFolderError, match=f"`charms-bench run small-roads --output {old}-2` m"):
        open_run(old)
