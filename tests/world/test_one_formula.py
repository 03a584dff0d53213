"""Formulas that have a second body, which is for columns or means something else."""

import math

import numpy as np
import polars as pl
import pytest
from charms_agents.training import rewards
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from scenes import scene_of

from charms_bench.foundation.compiled import compiled
from charms_bench.humans import car_following
from charms_bench.metrics import time_to_collision as of_columns
from charms_bench.world.gaps import (
    is_within,
    required_braking,
    requires_braking,
    time_to_collision,
)
from charms_bench.world.idm_mobil import (
    desired_gap,
    equilibrium_gap,
    free_acceleration,
    interaction,
    speed_ratio,
)
from charms_bench.world.profile import CHARMS, IdmMobilParameters

SPEEDS, GAPS = st.floats(0.0, 40.0), st.floats(1.0, 120.0)
PARAMETERS: IdmMobilParameters = CHARMS.constants(1 / 15).idm_mobil


@compiled
def idm(
    speed: float, leader_speed: float, gap: float, target_speed: float, p: IdmMobilParameters
) -> float:
    """The acceleration with the exponent 4."""
    ratio, most = speed_ratio(speed, target_speed, target_speed), p.acceleration_mps2
    wanted = desired_gap(speed, speed - leader_speed, p)
    return free_acceleration(ratio, 4.0, most) - interaction(wanted, gap, most)


def test_it_is_equation_3() -> None:
    p = PARAMETERS
    wanted = p.jam_distance_m + 20 * p.time_headway_s
    wanted += 20 * 5 / (2 * math.sqrt(p.acceleration_mps2 * p.deceleration_mps2))
    expected = p.acceleration_mps2 * (1 - (20 / 30) ** 4 - (wanted / 50) ** 2)
    assert idm(20.0, 15.0, 50.0, 30.0, p) == pytest.approx(expected)
    assert equilibrium_gap(20.0, p) == p.jam_distance_m + 20 * p.time_headway_s


@settings(derandomize=True, deadline=None)
@given(SPEEDS, SPEEDS, GAPS)
def test_calibrated_drivers_follow_it_with_a_least_gap(v: float, w: float, gap: float) -> None:
    """Their gaps are from bumper to bumper, and they never want less than the jam gap."""
    values = 33.3, 1.6, 2.0, 0.73, 1.67
    speed, headway, jam, a, b = values
    p = PARAMETERS._replace(acceleration_mps2=a, deceleration_mps2=b, time_headway_s=headway)
    p = p._replace(jam_distance_m=jam, least_gap_m=jam)
    found = car_following.idm(v, gap, w, np.array(values))
    assert found == pytest.approx(idm(v, w, gap, speed, p), rel=1e-9, abs=1e-9)


@settings(derandomize=True, deadline=None)
@given(SPEEDS, SPEEDS, GAPS)
def test_the_paper_rewards_its_acceleration_with_a_least_gap(
    v: float, w: float, gap: float
) -> None:
    p = PARAMETERS._replace(
        acceleration_mps2=rewards.IDM_ACCELERATION,
        deceleration_mps2=rewards.IDM_DECELERATION,
        jam_distance_m=rewards.IDM_JAM_DISTANCE_M,
        time_headway_s=rewards.IDM_HEADWAY_S,
        least_gap_m=rewards.IDM_JAM_DISTANCE_M,
    )
    scene = scene_of(x=[gap, 0.0], y=[0.0, 0.0], speed=[w, v])
    found = rewards.expected_acceleration(scene, 0, 1, 0)
    expected = idm(v, w, gap, rewards.IDM_SPEED_MPS, p)
    assert found == pytest.approx(expected, rel=1e-9, abs=1e-9)


@settings(derandomize=True, deadline=None)
@given(GAPS, st.floats(-40.0, 40.0), st.floats(0.1, 10.0))
def test_gaps_are_as_critical_in_columns_and_comparisons_as_in_numbers(
    gap: float, closing: float, limit: float
) -> None:
    columns = pl.DataFrame({"gap": [gap], "closing": [closing]})
    time = of_columns.time_to_collision(pl.col("gap"), pl.col("closing"))
    braking = required_braking(pl.col("gap"), pl.col("closing"))
    time_s, braking_mps2 = columns.select(time=time, braking=braking).row(0)
    expected = float(time_to_collision(gap, closing))
    assert (time_s is None and math.isnan(expected)) or time_s == expected
    assert braking_mps2 == required_braking(gap, closing)
    # Without a division, the last bit can differ.
    assume(closing <= 0 or expected != pytest.approx(limit, rel=1e-12))
    assert is_within(gap, closing, limit) == (expected < limit)
    assume(braking_mps2 != pytest.approx(limit, rel=1e-12))
    assert requires_braking(gap, closing, limit) == (closing > 0 and braking_mps2 > limit)
