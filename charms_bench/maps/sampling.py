"""Polylines through curves, with as few points as an error allows."""

from collections.abc import Callable

import numpy as np

from charms_bench.foundation.arrays import Floats

ERROR_M = 0.005
"""How far a curve may be from its polyline between two points, as it is looked for; maps promise
1 cm."""
VALUE_ERROR_M = 0.01
"""How far widths and heights may be from the straight line between two points."""
LENGTH_ERROR = 5e-4
"""By what part the polyline may be shorter; maps promise 0.1 %."""
MOST_POINTS = 200_000
_INSIDE = np.array([0.25, 0.5, 0.75])
_FINEST_M = 1e-4


class TooManyPointsError(ValueError):
    """A curve turns so tightly that no polyline of `MOST_POINTS` points follows it."""


def stations(curves: Callable[[Floats], Floats], breaks: Floats) -> Floats:
    """The distances (N,) at which polylines through points of curves follow them.

    Args:
        curves: The curves (N, C, 4) at distances (N,): x, y, height and width of each, m.
        breaks: Ascending distances (K,), at least two, which stay; between two of them, the curves
            have no kinks.
    """
    done, waiting = [breaks], np.stack([breaks[:-1], breaks[1:]], axis=1)
    points = breaks.size
    while waiting.size:
        low, high = waiting.T
        inside = low[:, None] + (high - low)[:, None] * _INSIDE
        s = np.concatenate([low[:, None], inside, high[:, None]], axis=1)
        there = curves(s.ravel()).reshape(*s.shape, -1, 4)
        start, end = there[:, :1], there[:, -1:]
        way = end[..., :2] - start[..., :2]
        length = np.maximum(np.hypot(way[..., 0], way[..., 1]), 1e-12)
        aside = there[:, 1:-1, :, :2] - start[..., :2]
        along = (aside * way).sum(axis=-1) / length
        beside = np.abs(aside[..., 0] * way[..., 1] - aside[..., 1] * way[..., 0]) / length
        beyond = np.maximum(np.maximum(-along, along - length), 0.0)
        error = np.hypot(beside, beyond).max(axis=(1, 2)) / ERROR_M
        straight = start[..., 2:] + (end - start)[..., 2:] * _INSIDE[:, None, None]
        values = np.abs(there[:, 1:-1, :, 2:] - straight).max(axis=(1, 2, 3))
        steps = np.diff(there[..., :2], axis=1)
        longer = np.hypot(steps[..., 0], steps[..., 1]).sum(axis=1) - length[:, 0]
        shorter = (longer / LENGTH_ERROR / np.maximum(longer + length[:, 0], 1e-12)).max(axis=1)
        split = np.maximum(np.maximum(error, values / VALUE_ERROR_M), shorter) > 1.0
        split &= high - low > _FINEST_M
        middle = inside[split, 1]
        points += middle.size
        if points > MOST_POINTS:
            raise TooManyPointsError(f"needs more than {MOST_POINTS:,} points")
        done.append(middle)
        halves = [(low[split], middle), (middle, high[split])]
        waiting = np.concatenate([np.stack(each, axis=1) for each in halves])
    return np.unique(np.concatenate(done))


def lengths_of(points: Floats) -> Floats:
    """The lengths (N,) of a polyline (N, 2 or more) up to each of its points, in the plane."""
    steps = np.hypot(*np.diff(points[:, :2], axis=0).T)
    return np.concatenate([[0.0], np.cumsum(steps)])
