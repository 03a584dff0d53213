"""IDM+MOBIL drivers with drawn parameters, against IDM+MOBIL with these parameters."""

import numpy as np
import pytest
from charms_baselines.idm_mobil import IdmMobil
from charms_baselines.varied_idm import VariedIdmMobil
from hypothesis import given, settings
from hypothesis import strategies as st
from scenes import all_vehicles, scene_of

from charms_bench.world.scene import Scene

# Digits to the base 128: 64, 32, 96, 0, 16, 48, 80, each with 64 after it for the last.
DIGITS = (64, 32, 96, 0, 16, 48, 80)
TEMPERAMENT = sum(digit * 128.0 ** -(k + 1) for k, digit in enumerate(DIGITS))


def two(temperament: float, gap_m: float) -> Scene:
    return scene_of(
        x=[0.0, gap_m],
        y=[4.0, 4.0],
        speed=[24.0, 20.0],
        target_speed=[26.0, 20.0],
        temperament=[temperament, temperament],
    )


@settings(derandomize=True, deadline=None, max_examples=50)
@given(st.floats(15.0, 120.0))
def test_a_driver_is_idm_with_the_parameters_that_its_temperament_says(gap_m: float) -> None:
    def share(k: int) -> float:  # the digits from k on, as a number in [0, 1)
        return sum(digit * 128.0 ** -(n + 1) for n, digit in enumerate(DIGITS[k:]))

    scene = two(TEMPERAMENT, gap_m)
    drawn = scene.constants.idm_mobil._replace(
        acceleration_mps2=1 + 3 * share(0),
        deceleration_mps2=2 + 4 * share(1),
        jam_distance_m=7 + 6 * share(2),
        time_headway_s=0.6 + 1.4 * share(3),
        politeness=0.5 * share(4),
        lane_change_gain_mps2=0.1 + 0.4 * share(5),
        imposed_braking_mps2=1 + 3 * share(6),
    )
    same = scene._replace(constants=scene.constants._replace(idm_mobil=drawn))
    found = VariedIdmMobil().drive(scene, all_vehicles(scene))[0][0]
    assert found == pytest.approx(IdmMobil().drive(same, all_vehicles(same))[0][0], abs=1e-6)


def test_drivers_differ() -> None:
    temperaments = np.random.default_rng(0).random(50)
    answers = [
        VariedIdmMobil().drive(scene, all_vehicles(scene))[0][0]
        for scene in (two(temperament, 45.0) for temperament in temperaments)
    ]
    assert np.std(answers) > 0.3
