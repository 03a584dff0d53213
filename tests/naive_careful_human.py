"""The careful driver of UN R157 at 1 kHz, in plain NumPy: an independent version for tests.

It knows nothing of lanes, engines or observations: every class of scenario gives the positions and
speeds of the other vehicles over time, relative to the centre of the driver's lane.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

HZ = 1000
LENGTH_M, WIDTH_M, LANE_M = 5.0, 2.0, 4.0


class Other(NamedTuple):
    """Another vehicle in R scenarios."""

    x: np.ndarray
    aside: np.ndarray
    """Distance beside the centre of the driver's lane, m."""
    speed: np.ndarray
    braking: np.ndarray
    heading: np.ndarray
    """Rad, positive towards the driver's lane."""


Others = Callable[[float], list[Other]]
"""The other vehicles at a time, nearest first."""


def cut_in(gap: np.ndarray, ego: np.ndarray, closing: np.ndarray, lateral: np.ndarray) -> Others:
    speed = ego - closing

    def others(t: float) -> list[Other]:
        moves = np.minimum(t, LANE_M / lateral)
        # The speed is that along the path.
        x = LENGTH_M + gap + np.sqrt(speed**2 - lateral**2) * moves + speed * (t - moves)
        heading = np.where(t < LANE_M / lateral, np.arcsin(lateral / speed), 0.0)
        return [Other(x, LANE_M - lateral * moves, speed, 0 * gap, heading)]

    return others


def cut_out(gap: np.ndarray, ego: np.ndarray, lateral: np.ndarray) -> Others:
    def others(t: float) -> list[Other]:
        nothing, start = 0 * gap, LENGTH_M + 2 * ego
        moves = np.minimum(t, LANE_M / lateral)
        x = start + np.sqrt(ego**2 - lateral**2) * moves + ego * (t - moves)
        heading = np.where(t < LANE_M / lateral, -np.arcsin(lateral / ego), 0.0)
        leader = Other(x, lateral * moves, ego, nothing, heading)
        return [leader, Other(start + LENGTH_M + gap, nothing, nothing, nothing, nothing)]

    return others


def deceleration(gap: np.ndarray, ego: np.ndarray, braking: np.ndarray, at_s: float) -> Others:
    def others(t: float) -> list[Other]:
        nothing, before = 0 * gap, min(t, at_s)
        braked = np.minimum(t - before, ego / braking)
        x = LENGTH_M + gap + ego * (before + braked) - braking * braked**2 / 2
        speed = ego - braking * braked
        brakes = np.where((t > at_s) & (speed > 0), braking, 0.0)
        return [Other(x, nothing, speed, brakes, nothing)]

    return others


def overlap(dx: np.ndarray, dy: np.ndarray, heading: np.ndarray, margin: np.ndarray) -> np.ndarray:
    """Whether a rectangle at (dx, dy) with a heading overlaps one at the origin without one.

    `margin` (2, R) makes the rectangles longer and wider.
    """
    half = np.array([LENGTH_M, WIDTH_M])[:, None] / 2 + margin / 2
    cos, sin = np.cos(heading), np.abs(np.sin(heading))
    along = np.abs(dx) < half[0] + half[0] * cos + half[1] * sin
    across = np.abs(dy) < half[1] + half[0] * sin + half[1] * cos
    sine = np.sin(heading)
    ahead = np.abs(dx * cos + dy * sine) < half[0] + half[0] * cos + half[1] * sin
    beside = np.abs(dy * cos - dx * sine) < half[1] + half[0] * sin + half[1] * cos
    return along & across & ahead & beside


def crashes(
    others: Others,
    ego: np.ndarray,
    duration_s: float,
    *,
    stops: bool | np.ndarray = False,
    later_s: float | np.ndarray = 0.0,
    ahead_s: float | np.ndarray = 0.0,
) -> np.ndarray:
    """Whether the driver, who starts at x = 0 with the speed `ego`, collides in each scenario.

    If it `stops`, it brakes to a standstill, otherwise while it closes in. `later_s` delays the
    braking. Vehicles that approach each other by some distance within `ahead_s` collide at this
    distance already, as in highway-env. All three can be arrays (R,), a value for each scenario.
    """
    x, v = np.zeros_like(ego), ego.copy()
    perceived, reacted = np.full_like(ego, np.inf), np.full_like(ego, np.inf)
    crashed = np.zeros(ego.shape, dtype=bool)
    for k in range(round(duration_s * HZ)):
        t = k / HZ
        closing = np.zeros_like(ego)
        risk, critical, shown, hidden = (np.zeros_like(crashed) for _ in range(4))
        for other in others(t):
            approach = np.array([np.abs(v - other.speed), other.speed * np.abs(other.heading)])
            crashed |= overlap(other.x - x, -other.aside, other.heading, approach * ahead_s)
            seen = (other.x > x) & (other.aside < LANE_M - 0.375) & ~hidden
            in_lane = other.aside <= 0.375
            hard = seen & in_lane & (other.braking > 5.0)
            slower = seen & (v > other.speed)
            closing = np.where(slower, np.maximum(closing, v - other.speed), closing)
            risk |= slower | hard
            critical |= hard | (slower & (other.x - x - LENGTH_M < 2.0 * (v - other.speed)))
            critical |= slower & shown & in_lane
            shown |= seen & ~in_lane
            hidden |= seen & in_lane
        perceived = np.where(risk, np.minimum(perceived, t), np.inf)
        is_due = critical & (t - perceived >= 0.4)
        reacted = np.where(is_due, np.minimum(reacted, t), reacted)
        pressed = np.clip((t - reacted - 0.75 - later_s) / 0.6, 0.0, 1.0)
        pressed = np.where(((closing > 0) | stops) & np.isfinite(reacted), pressed, 0.0)
        v = np.maximum(0.0, v - 0.774 * 9.81 * pressed / HZ)
        x = x + v / HZ
    return crashed
