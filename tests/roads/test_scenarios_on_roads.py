"""Scenarios on roads: where vehicles are placed on lanes, and how prescribed ones move there."""

from typing import Any

import numpy as np
import pytest
from road_simulations import PLACES, simulation

from charms_bench.engine.pile_ups import pile_ups
from charms_bench.engine.simulation import Simulation
from charms_bench.errors import InputError, ScenarioError
from charms_bench.plugins.registry import make_agent
from charms_bench.plugins.specs import TrafficSpec
from charms_bench.roads.engine import RoadEngine
from charms_bench.roads.scenes import NOTHING
from charms_bench.roads.scripts import PlacingOnRoad
from charms_bench.roads.settings import layout_on, on_road
from charms_bench.roads.task import Task
from charms_bench.world.named_road import NamedRoad
from charms_bench.world.placement import place
from charms_bench.world.road import local_coordinates
from charms_bench.world.scenario import Scenario
from charms_bench.world.scene import SceneSettings

EGO = {"lane": 0, "x_m": 50, "speed_mps": 20}
LEADER = {"name": "leader", "lane": 0, "ahead_of": "ego", "gap_m": 60, "speed_mps": 24}


def settings_of(
    road: Any, vehicles: list[dict[str, Any]], ego: dict[str, Any] = EGO, **fields: Any
) -> SceneSettings:
    scenario = Scenario.model_validate({"ego": ego, "vehicles": vehicles, **fields})
    scene = SceneSettings.model_validate({"profile": "roads", "duration_s": 20.0})
    named = NamedRoad.model_validate({"name": road} if isinstance(road, str) else road)
    return on_road(scene, named, None, scenario)


def simulation_of(settings: SceneSettings, scenes: int = 1) -> Simulation:
    traffic = TrafficSpec(scenario=settings.scenario).make()
    agents = {"idm_mobil": make_agent("idm_mobil")}
    return Simulation(settings, scenes, "idm_mobil", traffic, agents, RoadEngine)


def started(road: Any, *vehicles: dict[str, Any], **others: Any) -> Simulation:
    made = simulation_of(settings_of(road, list(vehicles), **others))
    made.reset(np.zeros(1, dtype=np.uint64))
    return made


def table_of(made: Simulation) -> Any:
    """The vehicles of the first scene in the table of the network."""
    return made.engine.episodes.scenes.vehicles[0]  # type: ignore[attr-defined]


def task_of(made: Simulation) -> Task:
    task: Task = made.engine.episodes.task  # type: ignore[attr-defined]
    return task


def frames(made: Simulation, steps: int, vehicle: int = 1) -> Any:
    """The rows [T + 1] of a vehicle, at the start and after each simulation step."""
    found = [table_of(made)[vehicle].copy()]
    for _ in range(steps):
        made.advance()
        found.append(table_of(made)[vehicle].copy())
    return np.array(found)


def test_a_leader_brakes_as_on_the_straight_road() -> None:
    actions = [{"at_s": 3, "acceleration_mps2": -6}]
    found = frames(started("merge-v1", {**LEADER, "actions": actions}), 150)
    t = np.arange(151) / 15
    np.testing.assert_allclose(found["speed"], np.clip(24 - 6 * (t - 3), 0, 24), atol=1e-9)
    # Between the centres there are 60 m and a length of 5 m. A step moves by the speed before it.
    assert found["x"][0] == pytest.approx(50 + 65)
    assert found["x"][-1] - found["x"][0] == pytest.approx(72 + 48 + 24 / 15 / 2, abs=1e-6)


def test_a_cut_in_moves_to_the_lane_beside_it_at_constant_lateral_speed() -> None:
    actions = [{"at_s": 1, "lane": 1, "duration_s": 4}]
    found = frames(started("merge-v1", {**LEADER, "actions": actions}), 120)
    path = 4 * np.clip((np.arange(121) / 15 - 1) / 4, 0, 1)
    np.testing.assert_allclose(found["y"], path, atol=1e-9)
    moving = (path > 0) & (path < 4)
    np.testing.assert_allclose(np.sin(found["heading"][moving]), 1 / 24, atol=1e-9)
    assert set(found["target_lane"][moving]) == {1, 3}  # before and after the ramp begins


def test_a_vehicle_keeps_to_the_middle_of_a_bend() -> None:
    ego = {"lane": 0, "x_m": 20, "speed_mps": 5}
    vehicle = {"name": "other", "lane": 1, "ahead_of": "ego", "gap_m": 20, "speed_mps": 10}
    made = started("racetrack-v1", vehicle, ego=ego)
    found, road = frames(made, 150), task_of(made).layout.network
    beside = [local_coordinates(road, row["lane"], row["x"], row["y"])[1] for row in found]
    np.testing.assert_allclose(beside, 0.0, atol=1e-6)
    step = np.hypot(np.diff(found["x"]), np.diff(found["y"]))
    # Chords are shorter than their arcs, and highway-env's lanes do not quite meet.
    np.testing.assert_allclose(step, 10 / 15, rtol=1e-3)
    assert len(set(found["lane"])) > 1


@pytest.mark.parametrize("destination", ["o0", "o2", "o3"])
def test_a_destination_decides_where_a_vehicle_turns(destination: str) -> None:
    vehicle = {"name": "other", "lane": 0, "x_m": 90, "speed_mps": 10, "destination": destination}
    made = started("intersection-v1", vehicle, ego={**EGO, "road": ["o1", "ir1"]})
    found, lanes = frames(made, 60), list(task_of(made).lanes)
    assert lanes[found["lane"][0]][:2] == ("o1", "ir1")
    assert lanes[found["lane"][-1]][1] == destination


def long_road_of(road: Any) -> list[str]:
    """The nodes of a road of more than 60 m in a file."""
    named, scene = (
        NamedRoad.model_validate(road),
        SceneSettings.model_validate({"profile": "roads"}),
    )
    layout, _ = layout_on(on_road(scene, named))
    lengths = layout.network.lanes["length"]
    return next([a, b] for (a, b, _), lane in layout.lanes.items() if lengths[lane] > 60)


def test_there_is_nobody_but_the_vehicles_of_the_scenario() -> None:
    for road in ("intersection-v1", "merge-v1", {"file": PLACES / "roundabout.json"}):
        where = {} if isinstance(road, str) else {"road": long_road_of(road)}
        many = [
            {**LEADER, "name": f"v{k}", "gap_m": 3 + 6 * k, "speed_mps": 0, "length_m": 4}
            for k in range(4)
        ]
        made = started(road, *many, ego={**EGO, "x_m": 5, **where})
        for _ in range(30):
            made.advance()
        assert (table_of(made)["kind"] != NOTHING)[:5].all()
        others = table_of(made)["kind"][5 : task_of(made).vehicles]
        assert (others == NOTHING).all()


def test_more_vehicles_than_the_road_has_itself_find_room() -> None:
    many = [{**LEADER, "name": f"v{k}", "gap_m": 20 * k + 10} for k in range(12)]
    made = started("merge-v1", *many)
    assert np.diff(table_of(made)["x"][:13]).tolist() == [15.0, *[20.0] * 11]


def test_a_gap_is_measured_along_the_lanes_of_the_way() -> None:
    # Of merge-v1, a leads over 150 m to b, and the ramp joins at b, 150 m after j.
    behind = {**LEADER, "name": "behind", "behind": "leader", "gap_m": 100, "ahead_of": None}
    found = table_of(started("merge-v1", {**LEADER, "gap_m": 120}, behind, ego=EGO))
    assert found["x"][:3].tolist() == [50.0, 50 + 125.0, 50 + 125 - 105.0]


@pytest.mark.parametrize(
    ("ego", "vehicle", "what"),
    [
        ({}, {"lane": 7}, r"lane 7 is not on road \[a, b\]; expected a whole number from 0 to 1"),
        ({"road": ["a", "x"]}, {}, r"no road \[a, x\].*Known: \[a, b\]"),
        ({"destination": "z"}, {}, "no node named 'z'"),
        ({"destination": "j"}, {}, r"no way leads from road \[a, b\] to 'j'"),
        ({"destination": "a"}, {}, r"'a' is where the vehicle's own road \[a, b\] starts"),
        ({}, {"road": ["j", "k"]}, "the gap says where the vehicle is"),
        ({}, {"gap_m": 5000}, "off the road"),
        ({}, {"gap_m": -4}, "overlaps 'ego': 1 m between their centres; expected at least 5 m"),
    ],
)
def test_an_impossible_placement_is_named(
    ego: dict[str, Any], vehicle: dict[str, Any], what: str
) -> None:
    settings = settings_of("merge-v1", [{**LEADER, **vehicle}], {**EGO, **ego})
    assert settings.scenario is not None
    with pytest.raises(ScenarioError, match=what):
        place(settings.scenario, settings, np.arange(1), PlacingOnRoad)


def test_a_distance_ends_where_a_ring_comes_round() -> None:
    # A ring of radius 20 m, and lanes of 4 m, is 126 to 151 m long.
    ego = {"road": ["se", "ex"], "lane": 0, "speed_mps": 8}
    vehicle = {**LEADER, "gap_m": 20, "speed_mps": 8}
    placed = settings_of("roundabout-v1", [vehicle], {**ego, "x_m": 90})
    far = settings_of("roundabout-v1", [vehicle], {**ego, "x_m": 5000})
    assert placed.scenario is not None
    place(placed.scenario, placed, np.arange(1), PlacingOnRoad)
    assert far.scenario is not None
    with pytest.raises(ScenarioError, match="or more than once round it"):
        place(far.scenario, far, np.arange(1), PlacingOnRoad)


def test_the_straight_road_has_no_nodes() -> None:
    ego = {**EGO, "speed_mps": 25, "road": ["a", "b"]}
    scenario = Scenario.model_validate({"ego": ego, "vehicles": [LEADER]})
    with pytest.raises(ScenarioError, match="remove it on the straight road"):
        place(scenario, SceneSettings().of_scenario(scenario), np.arange(1))


def test_a_recorded_start_and_several_egos_leave_no_place_for_a_scenario() -> None:
    with pytest.raises(InputError, match="a scenario has one ego, and the road 2"):
        settings_of("intersection-multi-agent-v1", [LEADER])


def test_a_scenario_on_a_road_continues_from_a_state_as_if_never_interrupted() -> None:
    actions = [
        {"at_s": 2, "acceleration_mps2": -6},
        {"at_s": 1, "lane": 1, "duration_s": 3},
    ]
    vehicles = [{**LEADER, "gap_m": "gap", "actions": actions}]
    vehicles += [{**LEADER, "name": "n", "lane": 1, "gap_m": 5, "agent": "idm_mobil"}]
    settings = settings_of("merge-v1", vehicles, parameters={"gap": [40, 80]})
    original, later = simulation_of(settings, 2), simulation_of(settings, 2)
    original.reset(np.array([4, 5], dtype=np.uint64))
    for _ in range(20):
        original.advance()
    later.restore(original.state())
    for _ in range(60):
        original.advance()
        later.advance()
    for name in ("x", "y", "speed", "heading"):
        found, expected = (getattr(each.engine.state, name) for each in (later, original))
        np.testing.assert_array_equal(found, expected)


def test_prescribed_vehicles_that_collide_are_a_pile_up_on_a_road_too() -> None:
    # At 20 m/s, it drives 400 m in the 20 s until the end.
    wall = {**LEADER, "name": "wall", "ahead_of": "leader", "gap_m": "gap", "speed_mps": 0}
    points = [{"gap": gap} for gap in (5.0, 120.0)]
    settings = settings_of(
        "merge-v1",
        [{**LEADER, "speed_mps": 5}, wall],
        parameters={"gap": [0, 400]},
        points=points,
    )
    assert pile_ups(settings, np.arange(2), RoadEngine).tolist() == [True, False]


@pytest.mark.parametrize("road", ["u-turn-v1", "roundabout-v1", "exit-v1"])
def test_an_ego_that_is_placed_on_its_own_road_still_has_its_route(road: str) -> None:
    placed, plain = table_of(started(road, LEADER))[0], table_of(simulation(road))[0]
    assert plain["route_end"] > plain["route_step"]
    for name in ("route_roads", "route_numbers", "route_step", "route_end", "goal"):
        assert (placed[name] == plain[name]).all(), name
