import math

import pytest
from handmade_rows import measure, of_standard


def behind(distance: float, closing: float) -> dict[str, float]:
    return {"speed": 30.0, "leader_speed": 30.0 - closing, "leader_distance": distance}


def test_drac_is_the_closing_speed_squared_over_twice_the_gap() -> None:
    hard = ({}, [behind(15.0, 10.0), behind(25.0, 10.0)])  # 100 / 20, 100 / 40
    soft = ({}, [behind(55.0, 10.0), behind(55.0, -10.0)])  # 100 / 100, none
    assert measure(of_standard("drac_max"), hard, soft, ({}, [{}])) == pytest.approx(
        (5.0 + 1.0) / 2
    )
    assert measure(of_standard("drac_above_3_35", drac_mps2=3.35), hard, soft) == pytest.approx(
        1 / 4
    )


def test_a_leader_that_gets_away_requires_no_braking() -> None:
    assert measure(of_standard("drac_max"), ({}, [behind(15.0, -10.0)])) == 0.0
    assert math.isnan(measure(of_standard("drac_max"), ({}, [{}])))


def test_what_no_tyre_can_do_counts_as_9_81() -> None:
    assert measure(of_standard("drac_max"), ({}, [behind(5.5, 10.0)])) == 9.81
