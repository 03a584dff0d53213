"""Probabilities of rare events by subset simulation (Au & Beck 2001, Prob. Eng. Mech. 16).

A level function is positive where the event does not happen, and falls towards 0 as it comes
closer. The probability is a product: of the share of points below a first threshold, of the share
of those below a second one, and so on until 0. Below each threshold, Markov chains start from the
points that are already there and move by adaptive conditional sampling in standard normal space
(Papaioannou et al. 2015, Prob. Eng. Mech. 41). All components have the same step size: step
sizes that follow the spread of the points would depend on the points that they move, which biases
the estimate.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from charms_bench.statistics.intervals import CONFIDENCE, NO_BOUNDS, Bounds, wilson
from charms_bench.world.scene import Floats

Seeds = NDArray[np.uint64]
Level = Callable[[Floats, Seeds], Floats]
"""The level (M,) of M points: at most 0 where the event happens, never NaN. A point has independent
standard normal components (M, D), and a random seed (M,) for all else that it draws,
which a move keeps or draws again."""

SHARE = 0.1
"""The share of points below the next threshold, p0; Au & Beck's choice."""
TARGET_ACCEPTANCE = 0.44
"""Share of accepted moves that the step size is adapted to (Papaioannou et al. 2015)."""
FIRST_SIZE = 0.6
"""Step size of the first chains, between 0 and 1."""
MOST_LEVELS = 12
"""Probabilities below about `SHARE ** MOST_LEVELS` are reported as 0."""


@dataclass(frozen=True)
class SubsetRun:
    """One run of subset simulation."""

    thresholds: tuple[float, ...]
    """The threshold of each level; that of the last level is 0."""
    shares: tuple[float, ...]
    """The share of each level's points at or below its threshold."""
    acceptance: tuple[float, ...]
    """The share of accepted moves that made each level's points; 1 for the first level."""
    evaluations: int
    """How many points the level function was evaluated for."""

    @property
    def probability(self) -> float:
        """The estimate, 0 if no point reached the event."""
        return float(np.prod(self.shares))


def interval(runs: Sequence[SubsetRun], samples: int) -> Bounds:
    """The 95 % interval of a probability from independent runs with N samples per level.

    The estimates are close to lognormal, so this is the interval of a lognormal mean (Cox's method
    with Student's t, Olsson 2005, Journal of Statistics Education 13). If every run ended at its
    first level, all points are independent, and the interval is Wilson's. If a run estimates 0, it
    is Student's interval of the mean, which then starts at 0; if all do, there is none.
    """
    from scipy import special

    found, count = np.array([run.probability for run in runs]), len(runs)
    if all(len(run.shares) == 1 for run in runs):
        return wilson(round(found.sum() * samples), count * samples)
    if count < 2 or not found.any():
        return NO_BOUNDS
    t = float(special.stdtrit(count - 1, (1 + CONFIDENCE) / 2))
    mean = float(found.mean())
    if not found.all():
        return 0.0, mean + t * float(found.std(ddof=1)) / math.sqrt(count)
    logs = np.log(found)
    variance = float(logs.var(ddof=1))
    centre = float(logs.mean()) + variance / 2
    margin = t * math.sqrt(variance / count + variance**2 / (2 * (count - 1)))
    return min(math.exp(centre - margin), mean), max(min(math.exp(centre + margin), 1.0), mean)


def subset_simulation(
    level: Level, dimension: int, samples: int, runs: int, rng: np.random.Generator
) -> list[SubsetRun]:
    """Estimates the probability that a level is at most 0, in independent runs side by side.

    Args:
        level: The level function.
        dimension: D, the number of normal components.
        samples: N, the points of each level; a multiple of 1 / `SHARE`.
        runs: The number of runs.
        rng: Makes all random draws.
    """
    normal = rng.standard_normal((runs, samples, dimension))
    seeds = _draw_seeds(rng, (runs, samples))
    levels = _levels(level, normal, seeds)
    found: list[list[tuple[float, ...]]] = [[] for _ in range(runs)]
    running, size, accepted = np.arange(runs), np.full(runs, FIRST_SIZE), np.ones(runs)
    chains = round(samples * SHARE)
    for number in range(MOST_LEVELS):
        threshold = np.partition(levels, chains - 1, axis=1)[:, chains - 1]
        last = number == MOST_LEVELS - 1
        threshold = np.zeros_like(threshold) if last else np.maximum(threshold, 0.0)
        is_below = levels <= threshold[:, None]
        for run, *step in zip(running, threshold, is_below.mean(axis=1), accepted, strict=True):
            found[run].append(tuple(map(float, step)))
        going = threshold > 0
        if not going.any():
            break
        running, size, threshold = running[going], size[going], threshold[going]
        # A random choice, because more points than chains may lie at a flat part of the level.
        order = np.where(is_below[going], rng.random(is_below[going].shape), 2.0)
        start = np.argpartition(order, chains - 1, axis=1)[:, :chains]
        normal = np.take_along_axis(normal[going], start[..., None], axis=1)
        seeds = np.take_along_axis(seeds[going], start, axis=1)
        levels = np.take_along_axis(levels[going], start, axis=1)
        normal, seeds, levels, accepted, size = _grow(
            level, normal, seeds, levels, threshold, size, samples // chains, rng
        )
    return [_finished(each, samples, chains) for each in found]


def _grow(
    level: Level,
    normal: Floats,
    seeds: Seeds,
    levels: Floats,
    threshold: Floats,
    size: Floats,
    length: int,
    rng: np.random.Generator,
) -> tuple[Floats, Seeds, Floats, Floats, Floats]:
    """Makes chains of `length` points below a threshold (A,), from their first points (A, C).

    Returns the points of all chains, their levels, the share of accepted moves (A,) and the
    adapted step size (A,).
    """
    grown, chains = normal.shape[:2]
    points = tuple(
        np.empty((grown, chains * length, *each.shape[2:]), each.dtype)
        for each in (normal, seeds, levels)
    )
    moves = np.zeros(grown)
    for step in range(length):
        if step:
            kept = np.sqrt(1 - size**2)
            candidate = rng.standard_normal(normal.shape)
            candidate *= size[:, None, None]
            candidate += kept[:, None, None] * normal
            keeps = rng.random(seeds.shape) < kept[:, None]
            new_seeds = np.where(keeps, seeds, _draw_seeds(rng, seeds.shape))
            new_levels = _levels(level, candidate, new_seeds)
            accepted = new_levels <= threshold[:, None]
            np.copyto(normal, candidate, where=accepted[..., None])
            np.copyto(seeds, new_seeds, where=accepted)
            np.copyto(levels, new_levels, where=accepted)
            share = accepted.mean(axis=1)
            moves += share / (length - 1)
            size = np.minimum(1.0, size * np.exp((share - TARGET_ACCEPTANCE) / np.sqrt(step)))
        here = slice(step * chains, (step + 1) * chains)
        for all_points, each in zip(points, (normal, seeds, levels), strict=True):
            all_points[:, here] = each
    return (*points, moves, size)  # type: ignore[return-value]


def _finished(steps: list[tuple[float, ...]], samples: int, chains: int) -> SubsetRun:
    thresholds, shares, acceptance = zip(*steps, strict=True)
    evaluations = samples + (len(steps) - 1) * (samples - chains)
    return SubsetRun(thresholds, shares, acceptance, evaluations)


def _draw_seeds(rng: np.random.Generator, shape: tuple[int, ...]) -> Seeds:
    return rng.integers(0, 2**63, shape, dtype=np.uint64)


def _levels(level: Level, normal: Floats, seeds: Seeds) -> Floats:
    """The levels of points [A, C]."""
    return level(normal.reshape(-1, normal.shape[-1]), seeds.ravel()).reshape(seeds.shape)
