"""The measures of docs/mutants.md, of severities by episode and driver; the page defines them."""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from charms_bench.report.number import Number
from charms_bench.world.scene import Bools, Floats

ORDERED = 0.9
"""A larger Kendall's tau counts as the right order."""
OF_RESAMPLES = 0.95
FOUND = 2.95
"""Standard errors of a found difference: 5 %, two-sided, corrected for 16 drivers (Bonferroni)."""


class Driven(NamedTuple):
    """What the drivers did in a traffic model; the first has no fault."""

    severity: Floats
    """[E, D] by episode and driver."""
    from_the_start: Floats
    """[E, D] the same with the first 3 s."""
    distance_km: Floats
    """[E, D]."""
    collided: Bools
    """[E, D]."""


def kendalls_tau(severity: Floats) -> Floats:
    """Kendall's tau-a between the order of K severities [..., K] and their places."""
    first, second = np.triu_indices(severity.shape[-1], 1)
    return np.asarray(np.sign(severity[..., second] - severity[..., first]).mean(axis=-1))


def taus(severity: Floats, ladders: Sequence[Sequence[int]]) -> Floats:
    """[..., L + 1] of severities [..., D]: the tau of each ladder, and the mean of these."""
    each = np.stack([kendalls_tau(severity[..., list(ladder)]) for ladder in ladders], axis=-1)
    return np.concatenate([each, each.mean(axis=-1, keepdims=True)], axis=-1)


def resampled_means(values: Floats, rng: np.random.Generator) -> Floats:
    """[2000, ...] means of values [E, ...] over resampled episodes."""
    size = len(values)
    counts = rng.multinomial(size, np.full(size, 1 / size), size=2000)
    return np.tensordot(counts, values, axes=1) / size


def episodes_until_ordered(
    severity: Floats,
    ladders: Sequence[Sequence[int]],
    rng: np.random.Generator,
    resamples: int = 400,
) -> Floats:
    """[L + 1] of severities [E, D]: how many episodes put each ladder, and their mean, in order.

    It is the smallest of 60 numbers of resampled episodes, from 10 (or E) to E, from which on
    tau is at least 0.9 in 95 % of the resamples; infinite if there is none.
    """
    sizes = np.unique(np.geomspace(min(10, len(severity)), len(severity), 60).round().astype(int))
    drawn = severity[rng.integers(len(severity), size=(resamples, len(severity)))]
    means = np.cumsum(drawn, axis=1)[:, sizes - 1] / sizes[:, None]
    # Rounding may leave a mean of four taus just below 0.9.
    ordered = (taus(means, ladders) >= ORDERED - 1e-9).mean(axis=0) >= OF_RESAMPLES
    from_here = np.logical_and.accumulate(ordered[::-1])[::-1]
    return np.where(from_here.any(axis=0), sizes[from_here.argmax(axis=0)], np.inf)


def found(severity: Floats) -> Bools:
    """[D - 1] of severities [E, D]: which drivers are worse than the first one, beyond chance."""
    difference = severity[:, 1:] - severity[:, :1]
    error = difference.std(axis=0, ddof=1) / np.sqrt(len(difference))
    return np.asarray(difference.mean(axis=0) / np.maximum(error, 1e-12) > FOUND)


def per_1000_km(driven: Driven, searched: Floats, rng: np.random.Generator) -> Number:
    """Avoidable collisions per 1,000 km: the rate of collisions times the avoidable proportion."""
    columns = driven.collided.sum(axis=1), driven.distance_km.sum(axis=1) / 1000
    sums = np.column_stack([*columns, searched])
    if not sums[:, 0].any():
        return Number(0.0, None, None, len(sums))

    def rate(means: Floats) -> Floats:
        avoidable = means[..., 3] / np.maximum(means[..., 2], 1e-12)
        return np.asarray(avoidable * means[..., 0] / means[..., 1])

    low, high = np.quantile(rate(resampled_means(sums, rng)), [0.025, 0.975])
    return Number(float(rate(sums.mean(axis=0))), low, high, len(sums))


def of_resamples(value: float, resampled: Floats) -> Number:
    """A value with the percentiles of its resamples."""
    return Number(value, *np.quantile(resampled, [0.025, 0.975]).tolist())


def distance(episodes: float, resampled: Floats, km: float, most: int) -> str:
    """Episodes with the interval of their number, in km; `most` episodes are not exceeded."""

    def text(number: float) -> str:
        return f"{number * km:,.0f}" if number <= most else f"above {most * km:,.0f}"

    low, high = np.quantile(resampled, [0.025, 0.975], method="nearest")
    return f"{text(episodes)} [{text(low)}, {text(high)}]"


def ordered(
    driven: Driven, places: Sequence[Sequence[int]], rng: np.random.Generator
) -> tuple[list[dict[str, Any]], Number]:
    """The columns of each ladder and of their mean, and the mean's τ with the first 3 s."""
    severity, size = driven.severity, len(driven.severity)
    tau = taus(severity.mean(axis=0), places)
    spread = taus(resampled_means(severity, rng), places)
    early = taus(driven.from_the_start.mean(axis=0), places)
    early_spread = taus(resampled_means(driven.from_the_start, rng), places)
    needed = episodes_until_ordered(severity, places, rng)
    again = np.array(
        [
            episodes_until_ordered(severity[rng.integers(size, size=size)], places, rng)
            for _ in range(100)
        ]
    )
    km = float(driven.distance_km.mean())
    columns = [
        {
            "τ": of_resamples(float(tau[i]), spread[:, i]),
            "km until τ ≥ 0.9": distance(float(needed[i]), again[:, i], km, size),
        }
        for i in range(len(places) + 1)
    ]
    return columns, of_resamples(float(early[-1]), early_spread[:, -1])


def sizes_found(is_found: Bools, members: Sequence[int]) -> str:
    """Which sizes of a fault are found, from the smallest, 1."""
    return ", ".join(str(k) for k in range(1, len(members)) if is_found[members[k] - 1]) or "none"
