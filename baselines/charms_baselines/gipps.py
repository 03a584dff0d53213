"""Drivers who keep a speed from which they can always stop: Gipps's model (1981)."""

from collections.abc import Mapping
from types import MappingProxyType

import numpy as np

from charms_bench import DriverModel
from charms_bench.world.road import is_reachable, side_lanes
from charms_bench.world.scene import Bools, Floats, Ints, Scene, Vehicles

REACTION_S = 2 / 3
"""tau: a driver's speed answers what it sees after this time [Gipps 1981]."""
CHANGE_PERIOD_S = 1.0
"""Time between two considerations of a lane change."""
GAIN_MPS = 1.0
"""The speed that a lane change must gain."""
STANDSTILL_GAP_M = 2.0
"""The gap between bumpers that is left to a leader that has stopped."""


class Gipps(DriverModel):
    """Gipps's car-following model, and changes to lanes that allow a higher speed.

    A driver approaches its desired speed, and brakes so that it stops behind its leader if that
    brakes as hard as the driver thinks it can [Gipps 1981]. It changes lanes where a lane beside it
    allows `GAIN_MPS` more, if neither it nor its new follower has to brake harder than
    its own braking. A change that has not left the lane is given up if the gap closes.
    """

    parameters: Mapping[str, tuple[float, float]] = MappingProxyType(
        {
            "acceleration_mps2": (1.2, 2.2),
            "braking_mps2": (2.4, 4.4),
            "desired_speed_mps": (24.0, 33.0),
        }
    )

    def drive(self, scene: Scene, vehicles: Vehicles) -> tuple[Floats, Ints]:
        lane, target = scene.lane[vehicles], scene.target_lane[vehicles]
        own = self._speed_on(scene, vehicles, lane)
        changing = target != lane
        target = np.where(changing & ~self._is_free(scene, vehicles, target), lane, target)
        due = ~changing & (scene.timer_s[vehicles] > CHANGE_PERIOD_S)
        scene.timer_s[vehicles] *= ~due
        best = own + GAIN_MPS
        x, y = scene.x[vehicles], scene.y[vehicles]
        for side in _sides(scene, lane):
            speed = self._speed_on(scene, vehicles, side)
            better = due & (speed > best) & self._is_free(scene, vehicles, side)
            for m in np.flatnonzero(better):
                better[m] = is_reachable(scene.road, side[m], x[m], y[m])
            target, best = np.where(better, side, target), np.where(better, speed, best)
        speed = np.minimum(own, self._speed_on(scene, vehicles, target))
        return (speed - scene.speed[vehicles]) / REACTION_S, target

    def _speed_on(self, scene: Scene, vehicles: Vehicles, lane: Ints) -> Floats:
        """The speed (M,) that drivers would have after the reaction time on lanes (M,)."""
        speed = scene.speed[vehicles]
        gain, braking, desired = scene.parameters[vehicles][:, :3].T
        ratio = np.clip(speed / desired, 0.0, None)
        free = speed + 2.5 * gain * REACTION_S * (1 - ratio) * np.sqrt(0.025 + ratio)
        ahead, there = scene.leader(vehicles, lane)
        gap = scene.gap_to(vehicles, ahead)
        safe = _safe_speed(speed, scene.speed[vehicles[0], ahead], gap, braking)
        return np.asarray(np.where(there, np.minimum(free, safe), free))

    def _is_free(self, scene: Scene, vehicles: Vehicles, lane: Ints) -> Bools:
        """Whether the drivers can move to the lanes (M,) without making others brake hard."""
        braking = scene.parameters[vehicles][:, 1]
        speed = scene.speed[vehicles]
        needed = (self._speed_on(scene, vehicles, lane) - speed) / REACTION_S
        behind, follows = scene.follower(vehicles, lane)
        follower = vehicles[0], behind
        gap = scene.gap_to(follower, vehicles[1])
        safe = _safe_speed(scene.speed[follower], speed, gap, braking)
        imposed = (safe - scene.speed[follower]) / REACTION_S
        may_follow = ~follows | ((gap > 0.0) & (imposed >= -braking))
        return np.asarray((needed >= -braking) & may_follow)


def _sides(scene: Scene, lane: Ints) -> tuple[Ints, Ints]:
    """The lanes (M,) to the left and to the right of lanes (M,); -1 where there is no lane."""
    known, which = np.unique(lane, return_inverse=True)
    left, right = np.array([side_lanes(scene.road, each) for each in known])[which].T
    return left, right


def _safe_speed(speed: Floats, leader: Floats, gap: Floats, braking: Floats) -> Floats:
    """The highest speeds (M,) from which drivers stop behind their leaders.

    They take the leaders to brake by (braking + 3) / 2, and by at least 3 m/s2 [b-hat].
    """
    room = 2 * (gap - STANDSTILL_GAP_M) - speed * REACTION_S
    room += leader**2 / np.maximum(3.0, (braking + 3.0) / 2)
    root = np.sqrt(np.maximum((braking * REACTION_S) ** 2 + braking * room, 0.0))
    return np.maximum(root - braking * REACTION_S, 0.0)
