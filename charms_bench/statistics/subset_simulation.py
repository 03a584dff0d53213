"""Probabilities of rare events by subset simulation (Au & Beck 2001, Prob. Eng. Mech. 16).

A level function is positive where the event does not happen, and falls towards 0 as it comes
closer. The probability is a product: of the proportion of points below a first threshold, of that
of these points below a second one, and so on until 0. Below each threshold, Markov chains start
from the points that are already there and move by conditional sampling in standard normal space
(Papaioannou et al. 2015, Prob. Eng. Mech. 41).

Au & Beck choose each threshold from the points that are then counted, which makes the mean of the
estimates too large. Here a pilot chooses the thresholds and the step sizes, and its points are not
counted. The number and the lengths of the chains are fixed too, and every point below a threshold
is as likely as every other to start a chain. The estimate of a run then has no bias, however few
points it has (Del Moral 2004, Feynman-Kac Formulae, theorem 7.4.2; Cérou et al. 2012, Stat.
Comput. 22, algorithm with fixed levels).
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from charms_bench.statistics.intervals import CONFIDENCE, NO_BOUNDS, Bounds, wilson
from charms_bench.world.scene import Floats

Seeds = NDArray[np.uint64]
Level = Callable[[Floats, Seeds], Floats]
"""The level (M,) of M points: at most 0 where the event happens, never NaN. A point has independent
standard normal components (M, D), and a random seed (M,) for all else that it draws,
which a move keeps or draws again."""

LEVEL_PROBABILITY = 0.2
"""The proportion of the pilot's points below the next threshold, p0; 0.1 to 0.3 give nearly the
least variance (Zuev et al. 2012, Comput. Struct. 92)."""
TARGET_ACCEPTANCE = 0.44
"""Proportion of accepted moves that the step size is adapted to (Papaioannou et al. 2015)."""
FIRST_SIZE = 0.6
"""Step size of the pilot's first chains, between 0 and 1."""
MOST_LEVELS = 17
"""A pilot that has not reached the event by then, at about `LEVEL_PROBABILITY ** MOST_LEVELS`,
ends."""


@dataclass(frozen=True)
class SubsetRun:
    """One run of subset simulation, or the pilot of such runs."""

    thresholds: tuple[float, ...]
    """The threshold of each level; that of the last level is 0."""
    sizes: tuple[float, ...]
    """The step size of the chains below each threshold but the last, between 0 and 1."""
    shares: tuple[float, ...]
    """The proportion of each level's points at or below its threshold. That of 0 is the last."""
    acceptance: tuple[float, ...]
    """The proportion of accepted moves that made each level's points; 1 for the first level."""
    evaluations: int
    """How many points the level function was evaluated for."""

    @property
    def probability(self) -> float:
        """The estimate, 0 if no point reached the event; that of a pilot is biased."""
        return math.prod(self.shares)


class _Points(NamedTuple):
    """Points of runs side by side."""

    normal: Floats
    """Components [A, C, D]."""
    seeds: Seeds
    """[A, C]"""
    levels: Floats
    """[A, C]"""


def interval(runs: Sequence[SubsetRun], samples: int) -> Bounds:
    """The 95 % interval of a probability from independent runs with N samples per level.

    The interval is symmetric about the logarithm of the mean, with Student's t. The variance of
    this logarithm is the larger of two estimates: the squared relative standard error of the mean,
    and Cox's variance of a lognormal mean (Olsson 2005, Journal of Statistics Education 13). The
    second is needed when the few runs with the largest estimates are missing. A run that estimates
    0 counts as half the least other estimate in Cox's variance. If at most half of the runs are
    above 0, the interval starts at 0; if none is, there is no interval.

    If the pilot has a single level, all points are independent, and the interval is Wilson's.
    """
    from scipy import special

    found, count = np.array([run.probability for run in runs]), len(runs)
    if all(len(run.thresholds) == 1 for run in runs):
        return wilson(round(found.sum() * samples), count * samples)
    if count < 2 or not found.any():
        return NO_BOUNDS
    mean = float(found.mean())
    logs = np.log(np.where(found > 0, found, found[found > 0].min() / 2))
    spread = float(logs.var(ddof=1))
    lognormal = spread / count + spread**2 / (2 * (count - 1))
    variance = max(lognormal, float(found.var(ddof=1)) / count / mean**2)
    factor = math.exp(float(special.stdtrit(count - 1, (1 + CONFIDENCE) / 2)) * variance**0.5)
    low = mean / factor if np.count_nonzero(found) > count / 2 else 0.0
    return low, min(mean * factor, 1.0)


def pilot_run(level: Level, dimension: int, samples: int, rng: np.random.Generator) -> SubsetRun:
    """Chooses the thresholds and step sizes of `subset_simulation`, which explains the arguments.

    Each threshold is a quantile of the points below the one before, and the step size follows the
    proportion of accepted moves.
    """
    points = _draw(level, (1, samples), dimension, rng)
    thresholds, sizes, acceptance = [_next_threshold(points.levels, math.inf)], [], [1.0]
    proportions = [float((points.levels <= thresholds[0]).mean())]
    chains, size = round(samples * LEVEL_PROBABILITY), FIRST_SIZE
    while thresholds[-1] > 0:
        points = _start(points, thresholds[-1], chains, rng)
        points, accepted, size = _grow(
            level, points, thresholds[-1], size, samples // chains, rng, adapt=True
        )
        is_last = len(thresholds) == MOST_LEVELS - 1
        thresholds.append(0.0 if is_last else _next_threshold(points.levels, thresholds[-1]))
        sizes.append(size)
        proportions.append(float((points.levels <= thresholds[-1]).mean()))
        acceptance.append(float(accepted[0]))
    evaluations = samples + len(sizes) * (samples - chains)
    levels = tuple(thresholds), tuple(sizes), tuple(proportions), tuple(acceptance)
    return SubsetRun(*levels, evaluations)


def _next_threshold(levels: Floats, before: float) -> float:
    """The quantile of levels [1, N], or the next lower level where the quantile stays the same."""
    place = round(levels.size * LEVEL_PROBABILITY) - 1
    threshold = float(np.partition(levels[0], place)[place])
    if threshold == before:
        threshold = float(levels.max(where=levels < before, initial=0.0))
    return max(threshold, 0.0)


def subset_simulation(
    level: Level,
    dimension: int,
    samples: int,
    runs: int,
    pilot: SubsetRun,
    rng: np.random.Generator,
) -> list[SubsetRun]:
    """Estimates the probability that a level is at most 0, in independent runs side by side.

    Args:
        level: The level function.
        dimension: D, the number of normal components.
        samples: N, the points of each level; a multiple of 1 / `LEVEL_PROBABILITY`.
        runs: The number of runs.
        pilot: Has the thresholds and the step sizes. Its random draws are not those of the runs.
        rng: Makes all random draws.
    """
    points = _draw(level, (runs, samples), dimension, rng)
    running, accepted = np.arange(runs), np.ones(runs)
    chains = round(samples * LEVEL_PROBABILITY)
    found: list[list[tuple[float, float]]] = [[] for _ in range(runs)]
    for threshold, size in zip(pilot.thresholds, (*pilot.sizes, None), strict=True):
        is_below = points.levels <= threshold
        for run, proportion, moved in zip(running, is_below.mean(axis=1), accepted, strict=True):
            found[run].append((float(proportion), float(moved)))
        has_reached = is_below.any(axis=1)
        if size is None or not has_reached.any():
            break
        running = running[has_reached]
        points = _start(points, threshold, chains, rng)
        points, accepted, _ = _grow(level, points, threshold, size, samples // chains, rng)
    finished = []
    for levels in found:
        proportions, acceptance = zip(*levels, strict=True)
        evaluations = samples + (len(levels) - 1) * (samples - chains)
        finished.append(
            replace(pilot, shares=proportions, acceptance=acceptance, evaluations=evaluations)
        )
    return finished


def _draw(
    level: Level, shape: tuple[int, int], dimension: int, rng: np.random.Generator
) -> _Points:
    normal, seeds = rng.standard_normal((*shape, dimension)), _draw_seeds(rng, shape)
    return _Points(normal, seeds, _levels(level, normal, seeds))


def _start(points: _Points, threshold: float, chains: int, rng: np.random.Generator) -> _Points:
    """The first points of chains below a threshold, in the runs that have reached it.

    They are a random choice from the points below, without repetition as far as that goes.
    """
    below = points.levels <= threshold
    reached = np.flatnonzero(below.any(axis=1))
    below = below[reached]
    order = np.where(below, rng.random(below.shape), 2.0).argsort(axis=1)
    places = np.arange(chains) % below.sum(axis=1)[:, None]
    at = reached[:, None], np.take_along_axis(order, places, axis=1)
    return _Points(points.normal[at], points.seeds[at], points.levels[at])


def _grow(
    level: Level,
    points: _Points,
    threshold: float,
    size: float,
    length: int,
    rng: np.random.Generator,
    *,
    adapt: bool = False,
) -> tuple[_Points, Floats, float]:
    """Makes chains of `length` points below a threshold from their first points.

    Returns the points of all chains, the proportion of accepted moves (A,), and the step size,
    which follows the accepted moves if it is to adapt.
    """
    normal, seeds, levels = points
    grown = [points]
    moves = np.zeros(len(levels))
    for step in range(1, length):
        kept = math.sqrt(1 - size**2)
        candidate = kept * normal + size * rng.standard_normal(normal.shape)
        keeps = rng.random(seeds.shape) < kept
        new_seeds = np.where(keeps, seeds, _draw_seeds(rng, seeds.shape))
        new_levels = _levels(level, candidate, new_seeds)
        accepted = new_levels <= threshold
        normal = np.where(accepted[..., None], candidate, normal)
        seeds = np.where(accepted, new_seeds, seeds)
        levels = np.where(accepted, new_levels, levels)
        grown.append(_Points(normal, seeds, levels))
        moves += accepted.mean(axis=1) / (length - 1)
        if adapt:
            acceptance = float(accepted.mean())
            size = min(1.0, size * math.exp((acceptance - TARGET_ACCEPTANCE) / math.sqrt(step)))
    joined = (np.concatenate(each, axis=1) for each in zip(*grown, strict=True))
    return _Points(*joined), moves, size


def _draw_seeds(rng: np.random.Generator, shape: tuple[int, ...]) -> Seeds:
    return rng.integers(0, 2**63, shape, dtype=np.uint64)


def _levels(level: Level, normal: Floats, seeds: Seeds) -> Floats:
    """The levels of points [A, C]."""
    return level(normal.reshape(-1, normal.shape[-1]), seeds.ravel()).reshape(seeds.shape)
