"""When the ego touches another vehicle; vehicles are 5 m long and 2 m wide."""

import math

import naive
import numpy as np
import pytest
from handmade_conduct import vehicles_of
from scenes import scene_of

from charms_bench.recording.planar_ttc import planar_ttc
from charms_bench.world.scene import Scene

QUARTER, EIGHTH = math.pi / 2, math.pi / 4


def ttc(scene: Scene) -> float:
    return planar_ttc(vehicles_of(scene)[0], 0)


def of_two(*vehicles: tuple[float, float, float, float]) -> float:
    """The planar TTC of the first vehicle; each has x, y, speed and heading."""
    x, y, speed, heading = map(list, zip(*vehicles, strict=True))
    return ttc(scene_of(x=x, y=y, speed=speed, heading=heading))


def test_behind_a_leader_it_is_the_time_to_collision() -> None:
    # A gap of 10 m, 5 m/s faster.
    assert of_two((100.0, 4.0, 30.0, 0.0), (115.0, 4.0, 25.0, 0.0)) == pytest.approx(2.0)
    assert of_two((100.0, 4.0, 25.0, 0.0), (115.0, 4.0, 30.0, 0.0)) == math.inf


def test_a_follower_that_closes_in_counts() -> None:
    assert of_two((115.0, 4.0, 25.0, 0.0), (100.0, 4.0, 30.0, 0.0)) == pytest.approx(2.0)


def test_a_vehicle_beside_that_moves_over_counts() -> None:
    # It turns by the angle with sine 0.06, so it moves over at 1.5 m/s. Its front corner is
    # (2 cos + 5 sin) / 2 m beside its centre, and the ego's side 1 m beside the ego's centre.
    angle = math.asin(0.06)
    gap = 4.0 - 1.0 - math.cos(angle) - 2.5 * 0.06
    speed = 25.0 / math.cos(angle)
    found = of_two((100.0, 4.0, 25.0, 0.0), (100.0, 8.0, speed, -angle))
    assert found == pytest.approx(gap / (speed * 0.06))


def test_a_vehicle_that_passes_on_the_next_lane_does_not_count() -> None:
    assert of_two((100.0, 4.0, 35.0, 0.0), (120.0, 8.0, 20.0, 0.0)) == math.inf


def test_a_crossing_vehicle_is_touched_at_its_side() -> None:
    # 20 m away across the road: 1 m and 2.5 m are theirs.
    found = of_two((100.0, 4.0, 0.0, 0.0), (100.0, -16.0, 10.0, QUARTER))
    assert found == pytest.approx((20.0 - 3.5) / 10.0)


def test_rectangles_are_turned_with_their_headings() -> None:
    # The wreck's edge at y = 1 m, where the ego's corner meets it, is 1 + sqrt(2) m before its
    # centre; its corner, where an upright box begins, is 7 / 2 / sqrt(2) m before it.
    found = of_two((100.0, 4.0, 10.0, 0.0), (150.0, 4.0, 0.0, EIGHTH))
    assert found == pytest.approx((50.0 - 2.5 - 1.0 - math.sqrt(2)) / 10.0)
    # Upright boxes would touch here, 3.3 m aside; the rectangles pass each other.
    assert of_two((100.0, 4.0, 10.0, 0.0), (150.0, 7.6, 0.0, EIGHTH)) == math.inf


def test_the_nearest_in_time_counts_and_times_beyond_the_horizon_do_not() -> None:
    near, far = (130.0, 4.0, 20.0, 0.0), (115.0, 4.0, 28.0, 0.0)
    ego = (100.0, 4.0, 30.0, 0.0)
    assert of_two(ego, near, far) == pytest.approx(2.5)
    assert of_two(ego, (115.1, 4.0, 29.0, 0.0)) == math.inf  # 10.1 s
    assert of_two(ego, (114.9, 4.0, 29.0, 0.0)) == pytest.approx(9.9)


def test_vehicles_that_overlap_have_no_time_left() -> None:
    assert of_two((100.0, 4.0, 25.0, 0.0), (104.0, 4.5, 30.0, 0.0)) == 0.0


@pytest.mark.parametrize("seed", range(10))
def test_the_compiled_version_is_the_plain_one(seed: int) -> None:
    # Coordinates are drawn, so none of them decides a case by its last bits.
    rng, found = np.random.default_rng(seed), []
    for _ in range(50):
        n = rng.integers(2, 9)
        turned = rng.choice([0.0, 0.1, math.pi], size=n)
        scene = scene_of(
            x=rng.uniform(0.0, 150.0, n),
            y=rng.uniform(-2.0, 10.0, n),
            heading=turned * rng.uniform(-1.0, 1.0, n),
            speed=rng.uniform(0.0, 40.0, n),
        )
        found.append(ttc(scene))
        assert found[-1] == pytest.approx(naive.planar_ttc(scene, 0), abs=1e-9)
    assert {time == 0.0 for time in found} == {np.isfinite(time) for time in found} == {True, False}
