"""What a road answers, on the straight road and on networks."""

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from charms_bench.testing.exact_maths import worker_environment
from charms_bench.world.road import closest_lane, next_lane, position, side_lanes
from charms_bench.world.road_network import CircularLane, PolyLane, StraightLane, network_of

COMPARISONS = Path(__file__).with_name("highway_env_road.py")
AHEAD = StraightLane(start=(0, 0), end=(100, 0))
BESIDE = StraightLane(start=(0, 4), end=(100, 4))
TURN = CircularLane(center=(100, 20), radius=20.0, start_phase=-np.pi / 2, end_phase=0.0)
FORTH = StraightLane(start=(100, 0), end=(200, 0))


def test_every_lane_of_highway_env_gives_the_same_bits() -> None:
    program = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", str(COMPARISONS)]
    subprocess.run(program, env={**os.environ, **worker_environment()}, check=True)


def test_lanes_between_the_same_nodes_are_neighbours_wherever_they_are_listed() -> None:
    road = network_of([("a", "b", AHEAD), ("b", "c", FORTH), ("a", "b", BESIDE)])
    assert list(road.lanes["y"]) == [0, 4, 0]
    assert [side_lanes(road, lane) for lane in range(3)] == [(-1, 1), (0, -1), (-1, -1)]


def test_a_quarter_turn_ends_beside_its_centre() -> None:
    road = network_of([("a", "b", TURN)])
    length = road.lanes["length"][0]
    assert length == pytest.approx(np.pi / 2 * 20)
    assert position(road, 0, length, 0.0) == pytest.approx((120, 20))
    assert position(road, 0, length, 1.0) == pytest.approx((119, 20))


def test_the_heading_decides_between_lanes_that_cross() -> None:
    up = StraightLane(start=(50, -50), end=(50, 50))
    road = network_of([("a", "b", AHEAD), ("c", "d", up)])
    assert closest_lane(road, 50.5, 0.0, 0.0) == 0
    assert closest_lane(road, 50.5, 0.0, np.pi / 2) == 1


def test_a_route_decides_at_a_fork_and_otherwise_the_first_nearest_lane_follows() -> None:
    road = network_of([("a", "b", AHEAD), ("b", "c", FORTH), ("b", "d", TURN)])
    assert next_lane(road, 0, 2, -1, 100.0, 0.0) == 2
    assert next_lane(road, 0, -1, -1, 100.0, 0.0) == 1


def test_no_lane_follows_at_the_end_of_a_network() -> None:
    road = network_of([("a", "b", AHEAD)])
    assert next_lane(road, 0, -1, -1, 100.0, 0.0) == 0


def test_a_polyline_below_1_m_is_rejected() -> None:
    with pytest.raises(ValueError, match=r"0\.5 m long; expected at least 1 m"):
        network_of([("a", "b", PolyLane(points=((0, 0), (0.5, 0))))])
