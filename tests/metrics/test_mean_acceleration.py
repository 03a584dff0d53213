"""What the speeds at successive decisions tell of how smoothly a vehicle drives."""

import math
from typing import Any

import numpy as np
import pytest
from handmade_rows import measure, of_standard
from hypothesis import given, settings
from hypothesis import strategies as st
from naive import counts_of_smoothness

from charms_bench.world.scene import SceneSettings

STD, STRONG = "mean_acceleration_std", "strong_acceleration_rate"
REVERSALS, UNDONE = "acceleration_reversals_per_min", "lane_changes_undone"
SHORT = "centre_headway_below_1s"


def at_speeds(*speeds: float, ending: str = "time") -> tuple[dict[str, Any], list[dict[str, Any]]]:
    return {"ending": ending}, [{"speed": speed} for speed in speeds]


def accelerating(*accelerations: float) -> tuple[dict[str, Any], list[dict[str, Any]]]:
    """At three decisions per second."""
    return at_speeds(*(25.0 + np.cumsum([0.0, *accelerations]) / 3))


def test_the_spread_is_that_of_changes_of_speed_per_second() -> None:
    # 1.5, 0 and -1.5 m/s² in one episode and 3 m/s² in another; what is commanded does not count.
    one, other = at_speeds(20.0, 20.5, 20.5, 20.0), at_speeds(30.0, 31.0)
    one[1][2]["acceleration"] = -9.0
    mean = 3.0 / 4
    expected = math.sqrt((1.5**2 + 1.5**2 + 3.0**2) / 4 - mean**2)
    assert measure(of_standard(STD), one, other) == pytest.approx(expected)
    slow = SceneSettings(decision_hz=1)
    assert measure(of_standard(STD), one, settings=slow) == pytest.approx(0.5 * math.sqrt(2 / 3))


def test_strong_is_more_than_the_threshold_either_way() -> None:
    rows = accelerating(1.25, -1.25, 1.0, -1.0, 0.0)
    assert measure(of_standard(STRONG), rows) == pytest.approx(2 / 5)
    assert measure(of_standard(STRONG, strong_mps2=0.9), rows) == pytest.approx(4 / 5)
    assert math.isnan(measure(of_standard(STRONG), at_speeds(20.0), at_speeds(30.0)))


@pytest.mark.parametrize(
    ("accelerations", "reversals"),
    [
        ([1.0, -1.0], 1),
        ([1.0, 0.0, 0.2, -0.2, -1.0], 1),  # whatever lies between
        ([1.0, 0.0, 1.0, 0.2, 1.0], 0),
        ([1.0, -0.25, 1.0], 0),  # not below -0.3
        ([0.25, -1.0, 0.25, -1.0], 0),
        ([1.0, -1.0, 1.0, -1.0, 0.0, 0.0], 3),
    ],
)
def test_a_reversal_passes_from_beyond_one_limit_to_beyond_the_other(
    accelerations: list[float], reversals: int
) -> None:
    minutes = len(accelerations) / 3 / 60
    found = measure(of_standard(REVERSALS), accelerating(*accelerations))
    assert found == pytest.approx(reversals / minutes)


def test_the_direction_of_an_episode_is_not_that_of_the_one_before() -> None:
    assert measure(of_standard(REVERSALS), accelerating(1.0), accelerating(-1.0)) == 0.0


def test_the_direction_of_a_warm_up_and_the_braking_of_a_wreck_count_nothing() -> None:
    # 3, 3, -3, 0 and 0 m/s²; the third one after 1 s. Then the ego is struck.
    struck = at_speeds(30.0, 31.0, 32.0, 31.0, 31.0, 31.0, 40.0, ending="rear_end")
    assert measure(of_standard(REVERSALS), struck) == pytest.approx(60 * 3 / 5)
    assert measure(of_standard(REVERSALS, warm_up_s=1.0), struck) == 0.0
    assert measure(of_standard(STRONG, warm_up_s=1.0), struck) == pytest.approx(1 / 3)
    assert measure(of_standard(STRONG, warm_up_s=1.0, strong_mps2=4.0), struck) == 0.0


def in_lanes(lanes: str, ending: str = "time") -> tuple[dict[str, Any], list[dict[str, Any]]]:
    return {"ending": ending}, [{"lane": int(lane)} for lane in lanes]


@pytest.mark.parametrize(
    ("lanes", "undone"),
    [
        ("0111", 0 / 1),  # counts although it could still be undone
        ("0110", 1 / 2),
        ("010", 1 / 2),
        ("0101", 2 / 3),
        ("0120", 0 / 3),  # the next one leads further
        ("01210", 1 / 4),  # only the one from 1 to 2 is undone by its next
        ("02220", 1 / 2),
        ("0" + "1" * 15 + "0", 1 / 2),  # after 5 s
        ("0" + "1" * 16 + "0", 0 / 2),
    ],
)
def test_a_lane_change_is_undone_if_the_next_one_leads_back_within_5_s(
    lanes: str, undone: float
) -> None:
    assert measure(of_standard(UNDONE), in_lanes(lanes)) == pytest.approx(undone)


def test_other_episodes_warm_ups_and_wrecks_undo_nothing() -> None:
    assert measure(of_standard(UNDONE), in_lanes("011"), in_lanes("100")) == 0.0
    assert measure(of_standard(UNDONE), in_lanes("0110", "side")) == 0.0
    # The change in the warm-up of 1 s does not count; the one that undoes it is not undone itself.
    assert measure(of_standard(UNDONE, warm_up_s=1.0), in_lanes("011000")) == 0.0
    assert math.isnan(measure(of_standard(UNDONE), in_lanes("111")))


def test_5_s_are_as_many_decisions_as_the_rate_says() -> None:
    often = SceneSettings(decision_hz=5)
    at_5_s, later = in_lanes("0" + "1" * 25 + "0"), in_lanes("0" + "1" * 26 + "0")
    assert measure(of_standard(UNDONE), at_5_s, settings=often) == 1 / 2
    assert measure(of_standard(UNDONE), later, settings=often) == 0.0


def number(low: float, high: float) -> st.SearchStrategy[float]:
    return st.floats(low, high, width=32)


DECISIONS = st.lists(
    st.tuples(
        st.one_of(st.sampled_from([24.0, 24.125, 24.25, 24.5, 25.0]), number(0, 40)),
        st.integers(0, 2),
        st.none() | st.sampled_from([24.0, 25.0, 100.0]) | number(0, 150),
    ),
    max_size=60,
)


@settings(max_examples=60, deadline=None, derandomize=True)
@given(
    st.lists(st.tuples(st.booleans(), DECISIONS), min_size=1, max_size=4),
    st.sampled_from([1, 3, 5]),
    st.integers(1, 6),
)
def test_metrics_of_any_rows_are_those_of_plain_loops(
    drawn: list[tuple[bool, list[Any]]], rate: int, first: int
) -> None:
    rows = [
        (
            {"ending": "rear_end" if collides else "time"},
            [{"speed": v, "lane": lane, "leader_distance": d} for v, lane, d in decisions],
        )
        for collides, decisions in drawn
    ]
    expected = counts_of_smoothness(
        [(collides and bool(decisions), decisions) for collides, decisions in drawn], rate, first
    )
    accelerations = expected.pop(STD)
    wanted = {name: a / b if b else math.nan for name, (a, b) in expected.items()}
    wanted[STD] = float(np.std(accelerations)) if accelerations else math.nan
    scene = SceneSettings.model_validate({"decision_hz": rate})
    for name, value in wanted.items():
        warm_up_s = (first - 0.5) / rate if first > 1 else 0.0
        found = measure(of_standard(name, warm_up_s), *rows, settings=scene)
        assert found == pytest.approx(value, rel=1e-4, abs=1e-4, nan_ok=True), name
