"""highway-env's linear vehicles, which accelerate and steer by sums of features times gains.

The gains are those of the speed that is missing, of the leader's speed that is missing, of the gap
that is missing, of the heading and of the lateral position.
"""

from collections.abc import Mapping
from types import MappingProxyType
from typing import NamedTuple

import numpy as np

from charms_bench.foundation.arrays import Floats
from charms_bench.foundation.compiled import clip, compiled, not_zero, wrap_to_pi
from charms_bench.roads.locating import coordinates_of, distance_to, heading_on
from charms_bench.roads.scenes import CONTINUOUS, Here, lane_of, vehicle_of
from charms_bench.world.idm_mobil import equilibrium_gap

TIME_HEADWAY_S = 2.5
"""[`TIME_WANTED`]"""
_STEERING = (1 / 0.2, 1 / 0.2 * (1 / 0.6))
"""[`STEERING_PARAMETERS`]"""
_ACCELERATION = (0.3, 0.3, 2.0)


class LinearType(NamedTuple):
    """The constants of a class of linear vehicles."""

    acceleration: tuple[float, float, float] = _ACCELERATION
    """The gains of a vehicle for which none are drawn [`ACCELERATION_PARAMETERS`]."""
    lane_change_gain_mps2: float = 0.2

    @property
    def gains(self) -> Floats:
        """The gains (3, GAINS) for `Scenes.empty`; all classes draw from the same ranges."""
        acceleration, steering = np.array(_ACCELERATION), np.array(_STEERING)
        around = np.array([0.07, 1.5])
        low = np.concatenate([0.5 * acceleration, steering - around])
        high = np.concatenate([1.5 * acceleration, steering + around])
        return np.array([[*self.acceleration, *_STEERING], low, high - low])


def _merging(gain: float, short: float) -> LinearType:
    """A class with a gain of acceleration at a merge [`MERGE_ACC_GAIN`, `MERGE_VEL_RATIO`]."""
    gains = gain / ((1 - 0.75) * 30), gain / (0.75 * 30), short
    return LinearType(gains, lane_change_gain_mps2=1.0)


LINEAR: Mapping[str, LinearType] = MappingProxyType(
    {
        "LinearVehicle": LinearType(),
        "AggressiveVehicle": _merging(0.8, 0.5),
        "DefensiveVehicle": _merging(1.2, 2.0),
    }
)
"""The linear types of the other vehicles, by highway-env's names of the classes."""


@compiled
def linear_acceleration(here: Here, i: int, j: int, driver: int) -> float:
    """The acceleration that a driver expects of vehicle i behind vehicle j, -1 for none.

    Vehicle i may be the driver's own, another one, an obstacle, or none, which accelerates by 0.
    [`LinearVehicle.acceleration`]
    """
    if i < 0:
        return 0.0
    own, gains, c = vehicle_of(here, i), vehicle_of(here, driver).gains, here.constants
    missing = 0.0 if own.kind <= CONTINUOUS else own.target_speed - own.speed
    closing = short = 0.0
    if j >= 0:
        closing = min(vehicle_of(here, j).speed - own.speed, 0.0)
        short = min(distance_to(here, i, j) - equilibrium_gap(max(own.speed, 0.0), c), 0.0)
    return float(gains[0] * missing + gains[1] * closing + gains[2] * short)


@compiled
def linear_steering(here: Here, i: int) -> float:
    """The steering angle towards the target lane [`LinearVehicle.steering_control`]."""
    vehicle, gains, c = vehicle_of(here, i), vehicle_of(here, i).gains, here.constants
    row, at = lane_of(here, vehicle.target_lane), coordinates_of(here, i, vehicle.target_lane)
    ahead, speed = at.s + vehicle.speed * (0.5 * c.tau_heading), not_zero(vehicle.speed)
    heading = wrap_to_pi(heading_on(here, row, ahead) - vehicle.heading) * vehicle.length / speed
    lateral = -at.r * vehicle.length / (speed * speed)
    angle = gains[3] * heading + gains[4] * lateral
    return clip(angle, -c.steering_limit, c.steering_limit)
