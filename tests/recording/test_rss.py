"""RSS distances against numbers worked out by hand and ad-rss-lib's, and who is too close."""

import numpy as np
import pytest
from handmade_conduct import DT, conduct

from charms_bench.recording.rss import safe_distance, safe_side_distance


@pytest.mark.parametrize(
    ("behind", "ahead", "expected"),
    [
        (20.0, 20.0, 65.78125),  # 20 + 1.75 + 23.5^2 / 8 - 20^2 / 16
        (30.0, 20.0, 147.03125),  # 30 + 1.75 + 33.5^2 / 8 - 20^2 / 16
        (0.0, 0.0, 3.28125),  # 1.75 + 3.5^2 / 8
        (22.0, 33.0, 36.96875),  # 22 + 1.75 + 25.5^2 / 8 - 33^2 / 16
        (0.0, 33.0, 0.0),
    ],
)
def test_the_safe_distance_is_that_of_the_formula(
    behind: float, ahead: float, expected: float
) -> None:
    assert safe_distance(behind, ahead) == pytest.approx(expected, abs=1e-12)


@pytest.mark.parametrize(
    ("one", "other", "expected"),
    [
        (0.0, 0.0, 0.35),  # margin 0.1, and twice 0.1 + 0.2^2 / 1.6
        (1.0, 0.0, 2.225),  # 0.1 + 1.1 + 1.2^2 / 1.6 + 0.125
        (1.0, 1.0, 4.1),
        (-1.0, 0.0, 0.1),  # moves away by 0.9 in the response time, and then further
        (-1.0, 1.0, 1.2),  # 0.1 - 0.9 + 1.1 + 0.9
    ],
)
def test_the_safe_side_distance_is_that_of_the_formula(
    one: float, other: float, expected: float
) -> None:
    assert safe_side_distance(one, other) == pytest.approx(expected, abs=1e-12)
    assert safe_side_distance(other, one) == safe_side_distance(one, other)


def test_too_close_along_the_road_counts_for_both() -> None:
    # Centres 70, 70.9 and 69 m apart at 20 m/s are gaps of 65, 65.9 and 64 m; 65.78 m is safe.
    x = [[0.0, 60.0], [0.0, 70.0], [0.0, 70.9], [0.0, 69.0]]
    rear, front = conduct(x=x, speed=20.0)
    assert rear["rss_by_s"] == front["rss_to_s"] == pytest.approx(2 * DT)
    assert rear["rss_to_s"] == front["rss_by_s"] == 0.0


def test_a_vehicle_on_the_next_lane_is_dangerous_only_while_it_drifts_closer() -> None:
    # Side gap 2 m: 0.35 m is safe when both keep their lanes, 2.225 m when one drifts at 1 m/s.
    drift = float(np.arcsin(1.0 / 20.0))
    heading = [[0.0, 0.0], [0.0, 0.0], [0.0, -drift], [0.0, drift]]
    rear, front = conduct(x=[[0.0, 30.0]] * 4, y=[4.0, 8.0], heading=heading, speed=20.0)
    assert rear["rss_by_s"] == front["rss_to_s"] == pytest.approx(DT)


def test_two_lanes_away_is_not_looked_at() -> None:
    rear, _ = conduct(x=[[0.0, 10.0]] * 2, y=[0.0, 8.0], speed=20.0)
    assert rear["rss_by_s"] == 0.0


def test_a_wreck_ahead_is_a_danger_but_no_longer_suffers() -> None:
    fields = {"crashed": [False, True], "collision": [0, 2]}
    rear, wreck = conduct(x=[[0.0, 30.0]] * 3, speed=[20.0, 0.0], **fields)
    assert rear["rss_by_s"] == pytest.approx(2 * DT)
    assert wreck["rss_to_s"] == 0.0
