"""Planar conflicts in rows at 3 Hz, with 100 m between two decisions."""

import math
from typing import Any

import pytest
from handmade_rows import measure, of_standard

from charms_bench.errors import InputError
from charms_bench.metrics import standard


def episode(*ttc_s: float | None, ending: str = "time") -> Any:
    rows = [{"x": 100.0 * k, "planar_ttc": time} for k, time in enumerate(ttc_s)]
    return {"ending": ending}, rows


def test_a_planar_conflict_lasts_while_the_planar_ttc_is_below_the_threshold() -> None:
    rate = of_standard("planar_conflicts_per_1000km", conflict_ttc_s=1.5)
    assert measure(rate, episode(2.0, 1.2, 0.5, 1.4, None)) == pytest.approx(1 / 400e-6)
    assert measure(rate, episode(1.2, 2.0, 1.2, None, 1.2)) == pytest.approx(3 / 400e-6)
    assert measure(rate, episode(2.0, 1.5, None, 9.0, 3.0)) == 0.0


def test_a_conflict_of_the_warm_up_or_of_a_wreck_does_not_count() -> None:
    after = of_standard(
        "planar_conflicts_per_1000km", warm_up_s=0.5, conflict_ttc_s=1.5
    )  # the first decision is before
    assert measure(after, episode(1.2, 1.2, 2.0, 1.2, 2.0)) == pytest.approx(1 / 400e-6)
    metric = of_standard("planar_conflict_episodes", conflict_ttc_s=1.5)
    crashed = episode(2.0, 0.0, ending="side")
    assert measure(metric, episode(2.0, 1.2), episode(2.0, None), crashed) == pytest.approx(1 / 3)


def test_the_smallest_planar_ttc_is_10_s_where_none_is_recorded() -> None:
    never, once = episode(None, None), episode(None, 4.0, 6.0)
    assert measure(of_standard("planar_ttc_min"), never, once) == pytest.approx((10.0 + 4.0) / 2)
    in_warm_up = episode(3.0)  # an episode without a step after it
    after = of_standard("planar_ttc_min", warm_up_s=0.5)
    assert measure(after, in_warm_up, once) == pytest.approx(4.0)
    assert math.isnan(measure(after, in_warm_up))


def test_a_threshold_beyond_what_is_recorded_is_rejected() -> None:
    with pytest.raises(InputError, match=r"conflict_ttc_s is 12; expected at most 10"):
        standard(conflict_ttc_s=12)
