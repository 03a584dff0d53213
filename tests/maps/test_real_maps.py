"""Maps that people drive on: all are read, and the rules of highway-env's roads hold on them."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from handmade_maps import same

from charms_bench.errors import MapError
from charms_bench.maps.conflicts import conflicts_of
from charms_bench.maps.reading import read_road
from charms_bench.maps.road_file import write_road
from charms_bench.maps.road_map import RoadMap
from charms_bench.roads.layout import Layout
from charms_bench.world.road import (
    closest_lane,
    distance,
    heading_at,
    local_coordinates,
    next_lane,
    position,
)

DATA = Path(__file__).parents[3] / "shared" / "data"
MAPS = DATA / "maps"
pytestmark = pytest.mark.skipif(not MAPS.is_dir(), reason="needs ../shared/data/maps, road maps")
SUFFIXES = {".xodr", ".xml"}
FAULTY = {"esmini_highway_merge.xodr": "leads to lane -3 at the end of road '4'"}
SOME = (
    "opendrive/carla_town04.xodr",
    "opendrive/esmini_velodrome.xodr",
    "opendrive/esmini_e6mini-lht.xodr",
    "opendrive/esmini_soderleden.xodr",
    "sumo/mcity.net.xml",
    "sumo/cloverleaf.net.xml",
    "sumo/interaction_merging.net.xml",
    "commonroad/DEU_A9-3_1_T-1.xml",
    "../ngsim_commonroad/USA_Peach-4_1_T-1.xml",
)
LOOKED_AT = 40
"""Lanes of each map."""
POSE_ERROR_M = 0.15
"""How far a metre's chord of a polyline is from a lane at kinks and tight turns."""


def files() -> list[Path]:
    folders = [MAPS, DATA / "ngsim_commonroad"]
    every = sorted(path for folder in folders for path in folder.rglob("*"))
    return [path for path in every if path.suffix in SUFFIXES]


@pytest.mark.slow
def test_all_maps_are_read_but_for_one_that_links_to_no_lane(tmp_path: Path) -> None:
    rejected = {}
    for path in files():
        try:
            found = read_road(path)
        except MapError as error:
            rejected[path.name] = str(error)
            continue
        check_network(found)
        write_road(found, tmp_path / "road.json")
        assert same(found, read_road(tmp_path / "road.json"))
    assert len(files()) > 80
    assert rejected.keys() == FAULTY.keys()
    for name, what in FAULTY.items():
        assert what in rejected[name]


def check_network(found: RoadMap) -> None:
    """Asserts that a network's lanes follow each other as those of the map, and nothing else."""
    network = Layout(found.edges()).network
    road_of = {lane.id: k for k, road in enumerate(found.roads) for lane in road.lanes}
    linked = {(road_of[lane.id], road_of[each]) for lane in found.lanes for each in lane.successors}
    starts: dict[str, list[int]] = {}
    for k, road in enumerate(found.roads):
        starts.setdefault(road.start, []).append(k)
    follows = {(k, j) for k, road in enumerate(found.roads) for j in starts.get(road.end, ())}
    assert follows == linked
    assert len(network.lanes) == len(road_of)


@pytest.mark.parametrize("name", SOME)
def test_positions_and_following_lanes_are_found_on_the_network(name: str) -> None:
    found = read_road(MAPS / name)
    check_network(found)
    layout = Layout(found.edges())
    network = layout.network
    lanes = [
        (layout.lanes[road.start, road.end, k], lane)
        for road in found.roads
        for k, lane in enumerate(road.lanes)
    ]
    number = {lane.id: k for k, lane in lanes}
    assert np.array_equal(sorted(number.values()), np.arange(len(lanes)))
    for k, lane in lanes[:: max(1, len(lanes) // LOOKED_AT)]:
        row = network.lanes[k]
        assert row.length == pytest.approx(lane.length, rel=1e-3)
        middle = row.length / 2
        x, y = position(network, k, middle, 0.0)
        along, aside = local_coordinates(network, k, x, y)
        assert abs(along - middle) < POSE_ERROR_M
        assert abs(aside) < POSE_ERROR_M
        nearest = closest_lane(network, x, y, heading_at(network, k, middle))
        assert distance(network, nearest, x, y) <= distance(network, k, x, y)
        end_x, end_y = lane.points[-1, :2].tolist()
        followers = [number[each] for each in lane.successors]
        if followers:
            assert next_lane(network, k, -1, -1, end_x, end_y) in followers
        for follower in followers:
            first = int(network.lanes[follower].first)
            chosen = next_lane(network, k, first, follower - first, end_x, end_y)
            # If a road has another number of lanes, highway-env takes the nearest that follows.
            assert chosen in followers


def test_roads_above_each_other_do_not_conflict() -> None:
    found = read_road(MAPS / "opendrive/carla_town04.xodr")
    chosen = [road for road in found.roads if road.lanes[0].id.split(".")[0] in ("39", "47")]
    assert conflicts_of(chosen, set()) == []
    flat = [
        replace(
            road,
            lanes=tuple(replace(lane, points=lane.points * (1, 1, 0, 1)) for lane in road.lanes),
        )
        for road in chosen
    ]
    assert len(conflicts_of(flat, set())) > 0
    names = {each.split(".")[0] for conflict in found.conflicts for each in conflict.lanes}
    assert not names & {"39", "47"}


def test_a_town_of_t_junctions_has_three_crossings_and_three_merges_at_each() -> None:
    facts = read_road(MAPS / "opendrive/carla_town01.xodr").facts()
    assert facts["junctions"] == 12
    assert (facts["crossing_conflicts"], facts["merging_conflicts"]) == (36, 36)
