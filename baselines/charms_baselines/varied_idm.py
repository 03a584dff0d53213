"""IDM+MOBIL drivers that differ from each other: each has drawn its own parameters."""

import numpy as np

from charms_baselines.idm_mobil import drive_block
from charms_bench import DriverModel
from charms_bench.world.compiled import compiled, compiled_of_scenes
from charms_bench.world.profile import IdmMobilParameters
from charms_bench.world.scene import Floats, Ints, Scene, Vehicles

_DIGIT = 128.0
"""A driver's numbers are the digits of its temperament to this base."""


class VariedIdmMobil(DriverModel):
    """IDM+MOBIL with a desired time headway of 0.6 to 2 s and other parameters in wide ranges.

    The ranges are in `_parameters`. They are wider than those of calibrated drivers, because the
    agents that meet these drivers were trained with the profile's constants. The exponent and the
    limit of the acceleration are the profile's.
    """

    def drive(self, scene: Scene, vehicles: Vehicles) -> tuple[Floats, Ints]:
        return _drive(scene, vehicles[0], vehicles[1])


@compiled_of_scenes
def _drive(scene: Scene, rows: Ints, places: Ints) -> tuple[Floats, Ints]:
    targets = scene.target_lane.copy()
    acceleration, target_lane = np.empty(rows.size), np.empty(rows.size, dtype=np.int64)
    for m in range(rows.size):
        own = slice(m, m + 1)
        p = _parameters(scene.temperament[rows[m], places[m]], scene.constants.idm_mobil)
        answers = acceleration[own], target_lane[own]
        drive_block(scene, rows[own], places[own], targets, answers, p)
    return acceleration, target_lane


@compiled
def _parameters(temperament: float, p: IdmMobilParameters) -> IdmMobilParameters:
    """The parameters of a driver; independent of each other and uniform in their ranges."""
    return IdmMobilParameters(
        acceleration_mps2=_drawn(temperament, 0, 1.0, 4.0),
        deceleration_mps2=_drawn(temperament, 1, 2.0, 6.0),
        jam_distance_m=_drawn(temperament, 2, 7.0, 13.0),
        time_headway_s=_drawn(temperament, 3, 0.6, 2.0),
        exponent_low=p.exponent_low,
        exponent_high=p.exponent_high,
        acceleration_limit_mps2=p.acceleration_limit_mps2,
        politeness=_drawn(temperament, 4, 0.0, 0.5),
        lane_change_gain_mps2=_drawn(temperament, 5, 0.1, 0.5),
        imposed_braking_mps2=_drawn(temperament, 6, 1.0, 4.0),
        lane_change_period_s=p.lane_change_period_s,
    )


@compiled
def _drawn(temperament: float, digit: int, low: float, high: float) -> float:
    """A number in a range from the digits of the temperament after the first `digit`."""
    shifted = temperament * _DIGIT**digit
    return float(low + (high - low) * (shifted - np.floor(shifted)))
