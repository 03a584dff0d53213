"""highway-env's linear vehicles, which accelerate and steer by sums of features times gains.

The gains are those of the speed that is missing, of the leader's speed that is missing, of the gap
that is missing, of the heading and of the lateral position.
"""

from collections.abc import Mapping
from importlib import import_module
from typing import Any

import numpy as np

from charms_bench.foundation.arrays import Floats
from charms_bench.foundation.compiled import clip, compiled, not_zero, wrap_to_pi
from charms_bench.roads.locating import coordinates_of
from charms_bench.roads.scenes import CONTINUOUS, Here, lane_of, vehicle_of
from charms_bench.world.idm_mobil import equilibrium_gap
from charms_bench.world.lane_geometry import line_heading


def linear_type(config: Mapping[str, Any]) -> Any:
    """highway-env's class of the other vehicles if they are linear; None if they are not."""
    module: Any = import_module("highway_env.vehicle.behavior")
    kind = getattr(module, config["other_vehicles_type"].rpartition(".")[2])
    return kind if issubclass(kind, module.LinearVehicle) else None


def constants_of(kind: Any) -> dict[str, float]:
    """The values of `IdmMobilParameters` in which a class differs from `IDMVehicle`."""
    gain = float(kind.LANE_CHANGE_MIN_ACC_GAIN)
    return {"time_headway_s": float(kind.TIME_WANTED), "lane_change_gain_mps2": gain}


def gains_of(kind: Any) -> Floats:
    """The gains (3, GAINS) for `Scenes.empty`."""
    ranges = np.concatenate([kind.ACCELERATION_RANGE, kind.STEERING_RANGE], axis=1)
    own = np.concatenate([kind.ACCELERATION_PARAMETERS, kind.STEERING_PARAMETERS])
    return np.array([own, ranges[0], ranges[1] - ranges[0]])


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
        ahead, lane = vehicle_of(here, j), own.lane
        distance = coordinates_of(here, j, lane).s - coordinates_of(here, i, lane).s
        closing = min(ahead.speed - own.speed, 0.0)
        short = min(distance - equilibrium_gap(max(own.speed, 0.0), c), 0.0)
    return float(gains[0] * missing + gains[1] * closing + gains[2] * short)


@compiled
def linear_steering(here: Here, i: int) -> float:
    """The steering angle towards the target lane [`LinearVehicle.steering_control`]."""
    vehicle, gains, c = vehicle_of(here, i), vehicle_of(here, i).gains, here.constants
    row, at = lane_of(here, vehicle.target_lane), coordinates_of(here, i, vehicle.target_lane)
    ahead, speed = at.s + vehicle.speed * (0.5 * c.tau_heading), not_zero(vehicle.speed)
    heading = wrap_to_pi(line_heading(row, ahead) - vehicle.heading) * vehicle.length / speed
    lateral = -at.r * vehicle.length / (speed * speed)
    angle = gains[3] * heading + gains[4] * lateral
    return clip(angle, -c.steering_limit, c.steering_limit)
