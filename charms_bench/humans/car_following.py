"""Car-following models, and drives behind recorded leaders in closed loop."""

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from charms_bench.foundation.compiled import compiled, inlined
from charms_bench.humans.trips import RATE_HZ, Trip
from charms_bench.world.scene import Floats

BRAKING_LIMIT_MPS2 = 9.0
"""No driver brakes harder."""
LEAST_GAP_M = 0.5
"""Models see no smaller gap. In a recording, a vehicle that is hit cannot get out of the way."""


@inlined
def idm(speed: float, gap: float, leader_speed: float, p: Floats) -> float:
    """IDM acceleration, m/s2, Treiber et al. 2000, eq. 3; p is v0, T, s0, a, b."""
    ratio = speed / p[0]
    braking = speed * (speed - leader_speed) / (2 * math.sqrt(p[3] * p[4]))
    crowding = (p[2] + max(0.0, speed * p[1] + braking)) / max(gap, LEAST_GAP_M)
    return float(p[3] * (1 - ratio * ratio * ratio * ratio - crowding * crowding))


@inlined
def fvdm(speed: float, gap: float, leader_speed: float, p: Floats) -> float:
    """Acceleration of the full velocity difference model, m/s2, Jiang et al. 2001, eq. 2.

    The optimal velocity is triangular: (gap - s0) / T from 0 to v0. p is v0, T, s0, the relaxation
    time in s, and the sensitivity to the closing speed in 1/s.
    """
    wanted = min(max((gap - p[2]) / p[1], 0.0), p[0])
    return float((wanted - speed) / p[3] + p[4] * (leader_speed - speed))


class Model(NamedTuple):
    """A car-following model with positive parameters."""

    name: str
    parameters: tuple[str, ...]
    usual: tuple[float, ...]
    """Published parameters, around which a weak prior lies."""
    closed_loop: Callable[..., None]
    """Compiled; see `drive`."""


def _closed_loop(acceleration: Callable[..., float]) -> Callable[..., None]:
    """Drives many parameters behind one leader, compiled; see `drive`."""

    @compiled
    def closed_loop(
        p: Floats,
        lag_s: float,
        noise: Floats,
        start: tuple[float, float],
        leader: tuple[Floats, Floats],
        gaps: Floats,
        speeds: Floats,
    ) -> None:
        dt = 1.0 / RATE_HZ
        for k in range(p.shape[0]):
            gap, speed = start
            x, felt = leader[0][0] - gap, 0.0
            for n in range(gaps.shape[1]):
                gap = leader[0][n] - x
                gaps[k, n], speeds[k, n] = gap, speed
                wanted = acceleration(speed, gap, leader[1][n], p[k])
                felt = wanted if n == 0 or lag_s <= dt else felt + (wanted - felt) * dt / lag_s
                # The engine moves a vehicle by the speed that it has before the step.
                x += speed * dt
                pushed = max(felt + noise[k, n], -BRAKING_LIMIT_MPS2)
                speed = max(speed + pushed * dt, 0.0)

    return closed_loop


IDM = Model(
    "idm",
    ("desired_speed_mps", "time_gap_s", "jam_gap_m", "acceleration_mps2", "deceleration_mps2"),
    (33.3, 1.6, 2.0, 0.73, 1.67),
    _closed_loop(idm),
)
FVDM = Model(
    "fvdm",
    ("desired_speed_mps", "time_gap_s", "jam_gap_m", "relaxation_s", "sensitivity_hz"),
    (33.3, 1.2, 2.0, 5.0, 0.6),
    _closed_loop(fvdm),
)
MODELS = {model.name: model for model in (IDM, FVDM)}


def drive(
    model: Model, trip: Trip, p: Floats, lag_s: float = 0.0, noise: Floats | None = None
) -> tuple[Floats, Floats]:
    """Gaps and speeds (K, n) of K drivers with parameters p (K, P) in place of a trip's driver.

    They start with the recorded gap and speed, and drive behind the recorded leader. `lag_s` is the
    time constant with which the acceleration follows the model's; `noise` (K, n) is added, m/s2.
    """
    shape = (p.shape[0], trip.gap.size)
    gaps, speeds = np.empty(shape), np.empty(shape)
    noise = np.zeros(shape) if noise is None else noise
    start = float(trip.gap[0]), float(trip.speed[0])
    leader = trip.leader_x, trip.leader_speed
    model.closed_loop(p, lag_s, noise, start, leader, gaps, speeds)
    return gaps, speeds
