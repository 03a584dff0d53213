"""Where lanes cross and merge."""

import numpy as np
import pytest

from charms_bench.maps.conflicts import conflicts_of
from charms_bench.maps.road_map import MapLane, MapRoad


def road(name: str, *points: tuple[float, ...], then: tuple[str, ...] = ()) -> MapRoad:
    """A road of one lane through points x, y and perhaps z."""
    table = np.array([(*each, 0.0)[:3] for each in points])
    lane = MapLane(name, np.column_stack([table, np.full(len(table), 3.5)]), successors=then)
    return MapRoad(f"{name} start", f"{name} end", (lane,))


EAST = road("east", (0, 0), (100, 0))


@pytest.mark.parametrize(("height", "expected"), [(0.0, 1), (2.9, 1), (10.9, 0)])
def test_lanes_at_different_levels_do_not_conflict(height: float, expected: int) -> None:
    north = road("north", (30, -40, height), (30, 60, height))
    found = conflicts_of([EAST, north], {("north", "east")})
    assert len(found) == expected
    for each in found:
        assert (each.lanes, each.at, each.gives_way) == (("east", "north"), (30, 40), "north")


def test_a_ramp_conflicts_only_where_it_is_low() -> None:
    ramp = road("ramp", (20, -5, 0), (20, 5, 0), (80, 5, 6), (80, -5, 6))
    assert [each.at for each in conflicts_of([EAST, ramp], set())] == [(20, 5)]


def test_lanes_that_join_merge_and_lanes_that_part_do_not_conflict() -> None:
    roads = [
        road("one", (0, 0), (50, 0), then=("on",)),
        road("other", (0, -20), (50, 0), then=("on",)),
        road("on", (50, 0), (100, 0), then=("left", "right")),
        road("left", (100, 0), (150, -20)),
        road("right", (100, 0), (150, 20)),
    ]
    (found,) = conflicts_of(roads, set())
    assert (found.lanes, found.kind) == (("one", "other"), "merging")
    assert found.at == pytest.approx((50, np.hypot(50, 20)), abs=1e-3)


def test_lanes_that_lie_on_each_other_do_not_cross_but_lanes_that_change_sides_do() -> None:
    x = np.linspace(0, 100, 41)
    wavy = road("wavy", *zip(x.tolist(), (0.004 * np.sin(x)).tolist(), strict=True))
    assert conflicts_of([EAST, wavy], set()) == []
    slanting = road("slanting", (0, -1), (100, 1))
    (found,) = conflicts_of([EAST, slanting], set())
    assert found.at == pytest.approx((50, 50), abs=0.02)
    back = road("back", (100, -1), (0, 1))
    (found,) = conflicts_of([EAST, back], set())
    assert found.at == pytest.approx((50, 50), abs=0.02)


def test_two_lanes_can_cross_twice() -> None:
    bow = road("bow", (20, -10), (50, 20), (80, -10))
    assert [each.at[0] for each in conflicts_of([EAST, bow], set())] == [30, 70]
