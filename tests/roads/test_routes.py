"""Routes over a network of lanes, against ways that were found by hand."""

import numpy as np
import pytest

from charms_bench.roads.routes import LANE_CHANGE_M, Routes, routes_of
from charms_bench.world.road_network import Network, StraightLane, network_of

A, B, C, D, E = range(5)


@pytest.fixture
def fork() -> tuple[Network, Routes]:
    """Two lanes of 100 m, A and B; C of 200 m and D of 50 m follow A, and E of 80 m follows B."""
    lanes = [
        ("0", "1", StraightLane(start=(0, 0), end=(100, 0))),
        ("0", "1", StraightLane(start=(0, 4), end=(100, 4))),
        ("1", "2", StraightLane(start=(100, 0), end=(300, 0))),
        ("1", "3", StraightLane(start=(100, 0), end=(150, 0))),
        ("1", "4", StraightLane(start=(100, 4), end=(180, 4))),
    ]
    road = network_of(lanes)
    return road, routes_of(road, [[C, D], [E], [], [], []], np.array([A, C, D, E]))


def test_a_way_is_the_shortest_one_and_changes_lanes_where_it_has_to(
    fork: tuple[Network, Routes],
) -> None:
    _, routes = fork
    to_c, to_e = 1, 3
    assert routes.following[to_c].tolist() == [C, A, -1, -1, -1]
    assert routes.following[to_e].tolist() == [B, E, -1, -1, -1]
    assert routes.distance[to_c, A] == pytest.approx(100, abs=0.01)
    assert routes.distance[to_c, B] == pytest.approx(100 + LANE_CHANGE_M, abs=0.01)
    assert np.isinf(routes.distance[to_c, [D, E]]).all()


def test_it_is_known_how_far_a_way_leads_without_a_lane_change(
    fork: tuple[Network, Routes],
) -> None:
    _, routes = fork
    to_e = 3
    assert routes.free[to_e, A] == 0.0
    assert np.isinf(routes.free[to_e, B])
