"""Vehicles on a road in a file: where they start and go, lights, levels, and long drives."""

from pathlib import Path

import numpy as np
import pytest

from charms_bench.errors import InputError
from charms_bench.maps.reading import read_road
from charms_bench.roads.episodes import Episodes
from charms_bench.roads.long_drive import long_drive
from charms_bench.roads.map_lanes import levels_of, map_of
from charms_bench.roads.road_from_file import FileRoad
from charms_bench.roads.scenes import IDM, OBSTACLE, place
from charms_bench.roads.stepping import decide
from charms_bench.roads.traffic_renewal import NEAREST_M
from charms_bench.world.named_road import FILE_ROAD, NamedRoad
from charms_bench.world.road import heading_at, local_coordinates, position

PLACES = Path(__file__).parents[2] / "suites" / "places"
NOBODY = np.zeros((1, 0), dtype=np.int64)


def episodes_of(name: str, density: float, count: int = 1) -> tuple[Episodes, FileRoad]:
    road = NamedRoad.model_validate({"file": PLACES / f"{name}.json"})
    config = {"file": str(road.file), "sha256": road.sha256, "density": density}
    episodes = Episodes(FILE_ROAD, count, config)
    assert isinstance(episodes.task, FileRoad)
    episodes.seed(episodes.everyone, np.arange(count, dtype=np.uint64))
    episodes.start(episodes.everyone)
    return episodes, episodes.task


def test_the_others_are_as_many_as_the_density_says() -> None:
    lane_km = sum(lane.length for lane in read_road(PLACES / "motorway.json").lanes) / 1000
    episodes, _ = episodes_of("motorway", density=8.0)
    present = episodes.scenes.vehicles["kind"][0] > OBSTACLE
    assert present.sum() == 1 + round(8.0 * lane_km)


def test_the_ego_can_reach_its_goal_and_is_not_there_yet() -> None:
    episodes, task = episodes_of("town", density=0.0, count=30)
    ego, routes = episodes.scenes.vehicles[:, 0], task.routes
    along = [
        local_coordinates(
            episodes.scenes.road, int(each["lane"]), float(each["x"]), float(each["y"])
        )
        for each in ego
    ]
    way = routes.distance[ego["goal"], ego["lane"]] - [s for s, _ in along]
    # At 13.9 m/s, it drives 278 m in half of the 40 s of an episode.
    assert (way >= NEAREST_M - 0.1).all()
    assert (way <= 13.9 * 20 + 0.1).all()
    assert not task.has_reached_goal(episodes.scenes, ego["lane"]).any()


def test_nobody_enters_a_junction_at_red() -> None:
    episodes, task = episodes_of("signalised-crossing", density=15.0)
    scenes = episodes.scenes
    task.release_egos(scenes)
    table, indices = scenes.vehicles[0], task.indices
    program = {q: (20.0, 45.0) if q % 2 else (42.0, 68.0) for q in range(4)}
    assert {each.id: each.program for each in task.map.signals}["light1"] == (
        (20.0, "green"),
        (25.0, "red"),
    )
    before = {indices[f"to{q}.{n}"]: q for q in range(4) for n in range(2)}
    inside = {k for name, k in indices.items() if name.startswith("j.")}
    entered = 0
    for step in range(5 * 45 * 4):
        was = table["lane"].copy()
        decide(scenes, episodes.everyone, NOBODY, 3, 0.2)
        now, into = (step + 1) / 5 % 45, [*zip(was.tolist(), table["lane"].tolist(), strict=True)]
        for i, (one, other) in enumerate(into):
            if table["kind"][i] == IDM and one in before and other in inside:
                entered += 1
                # Who can no longer stop goes on; that takes less than 4 s.
                q = before[one]
                red = now >= 24.0 if q % 2 else 4.0 <= now < 23.0
                assert not red, f"vehicle {i} entered from {q} at {now:.1f} s"
        task.follow(scenes, episodes.everyone)
    assert entered > 30
    assert program[1] == (20.0, 45.0)


def test_vehicles_on_a_bridge_do_not_collide_with_those_below() -> None:
    road = NamedRoad.model_validate({"file": PLACES / "cloverleaf.json"})
    levels = levels_of(map_of(PLACES / "cloverleaf.json", str(road.sha256)))
    assert levels["0.2.0"] < levels["1.2.0"]
    episodes, _ = episodes_of("cloverleaf", density=0.2)
    scenes = episodes.scenes
    x, y = -0.5 * 3.5, 0.5 * 3.5  # where the inner lanes of headings 0 and 1 cross
    for i, heading in enumerate((0.0, np.pi / 2)):
        place(scenes, 0, i, IDM, x, y, heading, 10.0)
    for _ in range(5):
        decide(scenes, episodes.everyone, NOBODY, 3, 0.2)
    assert not scenes.vehicles["crashed"].any()
    for i, heading in enumerate((0.0, np.pi / 2)):
        place(scenes, 0, i, IDM, x + 300.0 * (1 - i), y, heading, 10.0)
    place(scenes, 0, 1, IDM, x + 302.0, y, 0.0, 10.0)
    decide(scenes, episodes.everyone, NOBODY, 3, 0.2)
    assert scenes.vehicles["crashed"][0, :2].all()


def test_traffic_in_a_town_stays_on_the_road_and_does_not_lock_up() -> None:
    found = long_drive(PLACES / "town.json", vehicles=20, hours=0.1)
    assert (found.off_road, found.freed) == (0, 0)
    assert found.vehicles == 20
    assert found.stationary < 0.2


@pytest.mark.parametrize(("ahead_m", "goes_on"), [(2.0, False), (60.0, True)])
def test_a_lane_change_is_given_up_when_another_vehicle_has_come_beside(
    ahead_m: float, goes_on: bool
) -> None:
    episodes, task = episodes_of("motorway", density=0.2)
    scenes, road = episodes.scenes, episodes.scenes.road
    lane = next(k for k, row in enumerate(road.lanes) if row["right"] >= 0 and row["length"] > 400)
    beside = road.lanes["right"][lane]
    for i, (own, s) in enumerate(((lane, 100.0), (beside, 100.0 + ahead_m))):
        x, y = position(road, own, s, 0.0)
        place(scenes, 0, i, IDM, x, y, heading_at(road, own, s), 10.0)
    task.release_egos(scenes)
    scenes.vehicles["target_lane"][0, 0] = beside
    decide(scenes, episodes.everyone, NOBODY, 3, 0.2)
    assert scenes.vehicles["target_lane"][0, 0] == (beside if goes_on else lane)


def test_a_file_that_has_changed_is_not_driven_on(tmp_path: Path) -> None:
    path = tmp_path / "town.json"
    path.write_bytes((PLACES / "town.json").read_bytes())
    road = NamedRoad.model_validate({"file": path})
    path.write_bytes(path.read_bytes() + b"\n")
    with pytest.raises(InputError, match=r"town\.json: the road has changed since"):
        map_of(path, str(road.sha256))
