"""Made-up episodes whose events are correlated, with a known proportion or rate."""

import numpy as np

from charms_bench.world.scene import Floats

STEPS = 60


def beta_binomial(
    proportion: float, occasions: int, correlation: float, episodes: int, rng: np.random.Generator
) -> Floats:
    """[E, 2] occasions and events; each two occasions of an episode have this correlation."""
    within = np.full(episodes, proportion)
    if correlation:
        scale = (1 - correlation) / correlation
        within = rng.beta(proportion * scale, (1 - proportion) * scale, episodes)
    events = rng.binomial(occasions, within)
    return np.stack([np.full(episodes, occasions), events], axis=1).astype(np.float64)


def bursts(proportion: float, mean_steps: float, episodes: int, rng: np.random.Generator) -> Floats:
    """[E, 2] steps, 0 to 60 of which are logged, and events in runs of this mean length.

    A stationary Markov chain: a run ends with probability 1 / mean_steps in each step. Steps at a
    lag of k have the correlation
    (1 - 1 / mean_steps - proportion / (1 - proportion) / mean_steps)^k.
    """
    logged = rng.integers(0, STEPS + 1, episodes)
    starts, ends = proportion / (1 - proportion) / mean_steps, 1 / mean_steps
    draws = rng.random((STEPS, episodes))
    happens = draws[0] < proportion
    events = happens & (logged > 0)
    counted = events.astype(np.int64)
    for step in range(1, STEPS):
        happens = np.where(happens, draws[step] >= ends, draws[step] < starts)
        counted += happens & (step < logged)
    return np.stack([logged, counted], axis=1).astype(np.float64)


def pile_ups(rate: float, largest: int, episodes: int, rng: np.random.Generator) -> Floats:
    """[E, 3] vehicles, distance and events, which come in pile-ups of 1 to `largest` vehicles."""
    distance = rng.uniform(0.2, 1.8, episodes)
    starts = rng.poisson(rate * distance / ((1 + largest) / 2))
    sizes = rng.integers(1, largest + 1, starts.sum())
    events = np.bincount(np.repeat(np.arange(episodes), starts), sizes, minlength=episodes)
    return np.stack([np.full(episodes, 20.0), distance, events], axis=1)


def over_dispersed(rate: float, shape: float, episodes: int, rng: np.random.Generator) -> Floats:
    """[E, 3] vehicles, distance and events, at rates that have a gamma distribution."""
    distance = rng.uniform(0.2, 1.8, episodes)
    events = rng.poisson(rate * distance * rng.gamma(shape, 1 / shape, episodes))
    return np.stack([np.full(episodes, 20.0), distance, events], axis=1)
