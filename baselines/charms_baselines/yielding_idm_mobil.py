"""IDM+MOBIL that also gives way where ways cross and merge, by the rule of `yielding_human`.

It approaches a stop line with IDM, as behind a stationary leader that is one jam distance beyond
the line, so that it stops at the line.
"""

import numpy as np
from pydantic import ValidationError

from charms_baselines.idm_mobil import IdmMobil
from charms_baselines.yielding_human import stop_lines
from charms_bench import DriverModel
from charms_bench.errors import InputError, problem_in
from charms_bench.foundation.arrays import Floats, Ints
from charms_bench.foundation.compiled import clip, compiled_of_scenes
from charms_bench.world.idm_mobil import (
    desired_gap,
    free_acceleration,
    interaction,
    speed_ratio,
)
from charms_bench.world.profile import IdmMobilConstants
from charms_bench.world.scene import Scene, Vehicles


class YieldingIdmMobil(DriverModel):
    """IDM+MOBIL with gap acceptance at junctions; without them, it is IDM+MOBIL.

    Args:
        critical: The critical headways, as a proportion of the Highway Capacity Manual's.
        constants: Constants of IDM and MOBIL in place of the profile's, such as `time_headway_s`.

    Raises:
        InputError: `critical` is out of range, or there is no such constant, or it cannot have that
            value.
    """

    def __init__(self, critical: float = 1.0, **constants: float) -> None:
        if not 0 <= critical <= 10:
            raise InputError(f"yielding_idm_mobil: critical is {critical}; expected 0 to 10")
        try:
            IdmMobilConstants.model_validate(constants)
        except ValidationError as error:
            raise InputError(f"yielding_idm_mobil: {problem_in(error)}") from error
        self._critical, self._constants = critical, constants

    def drive(self, scene: Scene, vehicles: Vehicles) -> tuple[Floats, Ints]:
        idm_mobil = scene.constants.idm_mobil._replace(**self._constants)
        seen = scene._replace(constants=scene.constants._replace(idm_mobil=idm_mobil))
        acceleration, target_lane = IdmMobil().drive(seen, vehicles)
        if scene.junctions is not None:
            gaps = stop_lines(scene, vehicles, self._critical)
            _wait(seen, vehicles[0], vehicles[1], gaps, acceleration)
        return acceleration, target_lane


@compiled_of_scenes
def _wait(scene: Scene, rows: Ints, places: Ints, gaps: Floats, acceleration: Floats) -> None:
    """Lowers accelerations (M,) before the stop lines, at gaps (M,), m."""
    p = scene.constants.idm_mobil
    for m in range(rows.size):
        b, i = rows[m], places[m]
        if gaps[m] == np.inf or scene.crashed[b, i]:
            continue
        speed, target_speed = scene.speed[b, i], scene.target_speed[b, i]
        exponent = p.exponent_low + scene.temperament[b, i] * (p.exponent_high - p.exponent_low)
        ratio = speed_ratio(speed, target_speed, scene.road.speed_limit)
        free = free_acceleration(ratio, exponent, p.acceleration_mps2)
        wanted, distance = desired_gap(speed, speed, p), gaps[m] + p.jam_distance_m
        stopping = free - interaction(wanted, distance, p.acceleration_mps2)
        limit = p.acceleration_limit_mps2
        acceleration[m] = clip(min(acceleration[m], stopping), -limit, limit)
