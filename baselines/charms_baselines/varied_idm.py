"""IDM+MOBIL drivers that differ from each other: each has drawn its own parameters."""

from collections.abc import Mapping
from types import MappingProxyType
from typing import ClassVar

import numpy as np

from charms_baselines.idm_mobil import IdmMobil, drive_block
from charms_bench import DriverModel
from charms_bench.foundation.compiled import compiled, compiled_of_scenes
from charms_bench.world.profile import IdmMobilParameters
from charms_bench.world.scene import Floats, Ints, Scene, Vehicles


class VariedIdmMobil(DriverModel):
    """IDM+MOBIL with a desired time headway of 0.6 to 2 s and other parameters in wide ranges.

    The ranges are wider than those of calibrated drivers, because the agents that meet these
    drivers were trained with the profile's constants. All other constants are the profile's.
    """

    highway_env_class: ClassVar[str] = IdmMobil.highway_env_class
    parameters: Mapping[str, tuple[float, float]] = MappingProxyType(
        {
            "acceleration_mps2": (1.0, 4.0),
            "deceleration_mps2": (2.0, 6.0),
            "jam_distance_m": (7.0, 13.0),
            "time_headway_s": (0.6, 2.0),
            "politeness": (0.0, 0.5),
            "lane_change_gain_mps2": (0.1, 0.5),
            "imposed_braking_mps2": (1.0, 4.0),
        }
    )

    def drive(self, scene: Scene, vehicles: Vehicles) -> tuple[Floats, Ints]:
        return _drive(scene, vehicles[0], vehicles[1])


@compiled_of_scenes
def _drive(scene: Scene, rows: Ints, places: Ints) -> tuple[Floats, Ints]:
    targets = scene.target_lane.copy()
    acceleration, target_lane = np.empty(rows.size), np.empty(rows.size, dtype=np.int64)
    for m in range(rows.size):
        own = slice(m, m + 1)
        p = _constants(scene.parameters[rows[m], places[m]], scene.constants.idm_mobil)
        answers = acceleration[own], target_lane[own]
        drive_block(scene, rows[own], places[own], targets, answers, p)
    return acceleration, target_lane


@compiled
def _constants(parameters: Floats, p: IdmMobilParameters) -> IdmMobilParameters:
    """The constants of a driver with `VariedIdmMobil.parameters`."""
    return IdmMobilParameters(
        acceleration_mps2=parameters[0],
        deceleration_mps2=parameters[1],
        jam_distance_m=parameters[2],
        time_headway_s=parameters[3],
        exponent_low=p.exponent_low,
        exponent_high=p.exponent_high,
        acceleration_limit_mps2=p.acceleration_limit_mps2,
        politeness=parameters[4],
        lane_change_gain_mps2=parameters[5],
        imposed_braking_mps2=parameters[6],
        lane_change_period_s=p.lane_change_period_s,
        least_gap_m=p.least_gap_m,
    )
