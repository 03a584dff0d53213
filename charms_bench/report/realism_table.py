"""The table of realism: how far each traffic is from human driving, reference by reference.

Two quantities of all vehicles (`recording.following_counts`), each with three distances
(`statistics.divergence`). The paper reports KL from the human data, on bins it does not state;
here they are 1 m/s and 5 m. Jensen-Shannon uses the same bins, Wasserstein those of the rows. Two
more rows say which distances are possible: the sampling-noise floor of so few recorded drivers, and
the distance of the recorded drivers themselves within the profile's range of speeds.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
import polars as pl

from charms_bench.humans.reference import Reference
from charms_bench.report.number import Number
from charms_bench.report.table import ESTIMATE, Column, Table, long_frame
from charms_bench.runs.cells import TrafficCounts
from charms_bench.runs.suite import Suite
from charms_bench.statistics.divergence import (
    PSEUDO_COUNT,
    js_divergence,
    kl_divergence,
    wasserstein,
)
from charms_bench.statistics.human_sample import around, perfect_samples
from charms_bench.statistics.intervals import resampled_totals
from charms_bench.world.following_bins import BIN, BINS, QUANTITIES, bins_of
from charms_bench.world.scene import Floats

KEYS = ("traffic",)
LONG = {"reference": "group", "metric": "name", **ESTIMATE}
COARSE_BIN = {"speed": 1.0, "dhw": 5.0}
"""Width of the bins of KL and Jensen-Shannon, m/s and m."""
TITLE = {"speed": "Speed while following", "dhw": "Headway at the start of a lane change"}
LABELS = {
    f"{distance}_{quantity}": f"{of}, {what}"
    for distance, of in (("kl", "KL"), ("js", "Jensen-Shannon"), ("wasserstein", "Wasserstein"))
    for quantity, what in (("speed", "speed"), ("dhw", "headway"))
}
DISTANCES = {
    "kl": "Kullback-Leibler divergence of the simulated from the human proportions, KL(human || "
    f"simulated), in nats, with {PSEUDO_COUNT:g} counts added to every bin of both. Where human "
    "drivers do what no simulated vehicle does, it grows with the number of episodes. Bins are "
    f"{COARSE_BIN['speed']:g} m/s and {COARSE_BIN['dhw']:g} m wide",
    "js": "Jensen-Shannon divergence in bits, in the same bins, not smoothed: 0 for the same "
    "proportions, 1 if no bin is shared",
    "wasserstein": "First Wasserstein distance, m/s or m: how far one distribution has to be "
    f"moved, on average, to become the other. Its bins are {BIN:g} m/s and {BIN:g} m wide",
}
"""The definition of each distance."""
FLOOR = "(sampling-noise floor)"
WITHIN_LIMITS = "(speed limits of the profile)"
OVERSHOOT_MPS = 0.4
"""A vehicle leaves the profile's range of speeds by as much in one step of 1/15 s, at 6 m/s²; then
the profile pulls it back."""
NOTE = (
    f"The row {FLOOR} has the median distance of traffic that drives exactly like human drivers, "
    "which is not 0 because few drivers were recorded, and the range of 95 % of such distances. "
    f"The row {WITHIN_LIMITS} has the smallest possible distance of speeds to which the profile "
    "limits vehicles; no traffic model can be nearer, except for the smoothing of KL. A traffic "
    "model is marked as the nearest to human driving if its interval lies below that of every "
    "other traffic model, and the distance of the next nearest lies above the sampling-noise floor."
)
"""What the additional rows are, and which numbers are marked."""


def coarse(counts: Floats, quantity: str) -> Floats:
    """[..., BINS] -> [..., K] counts in the wider bins of a quantity."""
    together = round(COARSE_BIN[quantity] / BIN)
    return np.asarray(counts.reshape(*counts.shape[:-1], -1, together).sum(axis=-1))


def distances(human: Floats, simulated: Floats, quantity: str) -> dict[str, Floats]:
    """Each distance [...] of simulated counts from human ones, both [..., BINS], by metric."""
    of_human, of_simulated = coarse(human, quantity), coarse(simulated, quantity)
    return {
        f"kl_{quantity}": kl_divergence(of_human, of_simulated),
        f"js_{quantity}": js_divergence(of_human, of_simulated),
        f"wasserstein_{quantity}": wasserstein(human, simulated, BIN),
    }


def realism_table(
    suite: Suite, traffics: Sequence[TrafficCounts], references: Sequence[Reference]
) -> Table:
    """The distances of each traffic from each reference, with 95 % intervals.

    The suite's seed is that of the resamples, which are the same for traffics with the same number
    of episodes.
    """
    profile = suite.scene.profile
    limits = (profile.speed_min_mps - OVERSHOOT_MPS, profile.speed_max_mps + OVERSHOOT_MPS)
    records = []
    for quantity in QUANTITIES:
        counts = {each.traffic: each.of_quantity(quantity) for each in traffics}
        totals = {name: each.sum(axis=0).astype(np.float64) for name, each in counts.items()}
        resampled = {name: resampled_totals([each], suite.seed) for name, each in counts.items()}
        n = round(float(np.median([each.sum() for each in totals.values()])))
        for reference in references:
            units = reference.units(quantity)
            if not len(units):
                continue
            human = units.sum(axis=0)
            rng = np.random.default_rng((suite.seed, 1))
            humans = resampled_totals([units], rng)
            rows = {
                name: (
                    distances(human, each, quantity),
                    distances(humans, resampled[name], quantity),
                    round(each.sum()),
                )
                for name, each in totals.items()
            }
            if quantity == "speed":
                nearest, spread = (smallest_distances(each, limits, n) for each in (human, humans))
                rows[WITHIN_LIMITS] = (nearest, spread, n)
            for name, (found, spread, count) in rows.items():
                for metric, value in found.items():
                    interval = around(float(value), spread[metric], len(units))
                    records.append((name, reference.name, metric, float(value), *interval, count))
            if len(units) > 1:
                truth, samples = perfect_samples(units, rng)
                for metric, scored in distances(samples, n * truth, quantity).items():
                    scores = np.quantile(scored, [0.5, 0.025, 0.975]).tolist()
                    records.append((FLOOR, reference.name, metric, *scores, n))
    places = {reference.name: place for place, reference in enumerate(references)}
    order = pl.col("reference").replace_strict(places)
    return from_frame(long_frame(records, KEYS, LONG).sort(order, maintain_order=True), suite)


def smallest_distances(human: Floats, limits: tuple[float, float], n: int) -> dict[str, Floats]:
    """The smallest distances [...] of n speeds within limits from human ones [..., BINS].

    KL and Jensen-Shannon are smallest for the human proportions of the bins within the limits,
    because merging these bins to one does not change them then, and never increases them (Csiszar
    1967). The Wasserstein distance is smallest if every speed beyond a limit moves to it.
    """
    width = round(COARSE_BIN["speed"] / BIN)
    lowest, highest = (int(bins_of(limit)) for limit in limits)
    wide = np.arange(BINS) // width
    inside = (wide >= lowest // width) & (wide <= highest // width)
    clipped = human @ np.eye(BINS)[np.arange(BINS).clip(lowest, highest)]
    counts = human * inside
    total = counts.sum(axis=-1, keepdims=True)
    # The smoothing of KL depends on the total.
    found = distances(human, counts * (n / np.where(total > 0, total, 1.0)), "speed")
    return {**found, "wasserstein_speed": wasserstein(human, clipped, BIN)}


def from_frame(frame: pl.DataFrame, suite: Suite) -> Table:
    """The table of realism from its long frame; the nearest models are marked, see `NOTE`."""
    table = Table.from_frame(
        frame,
        f"{suite.suite}-realism",
        "Distance of traffic models from human driving",
        KEYS,
        LONG,
        _column,
        note=f"{NOTE} {suite.note}".rstrip(),
    )
    names = [row.labels[0] for row in table.rows]
    columns = map(table.column, range(len(table.columns)))
    nearest = [_nearest(dict(zip(names, numbers, strict=True))) for numbers in columns]
    rows = []
    for row in table.rows:
        pairs = zip(row.numbers, nearest, strict=True)
        cells = (replace(number, marked=row.labels[0] == name) for number, name in pairs)
        rows.append(replace(row, cells=tuple(cells)))
    return replace(table, rows=tuple(rows))


def _nearest(column: Mapping[str, Number]) -> str | None:
    """The traffic that is nearest to human driving, if the data separate it; see `NOTE`."""
    perfect = column.get(FLOOR, Number()).high
    ranked = sorted(
        (number.value, name)
        for name, number in column.items()
        if name not in (FLOOR, WITHIN_LIMITS) and number.value is not None
    )
    if len(ranked) < 2 or perfect is None or ranked[1][0] <= perfect:
        return None
    nearest, *others = (name for _, name in ranked)
    end, ends = column[nearest].high, [column[name].low for name in others]
    separated = end is not None and all(low is not None and end < low for low in ends)
    return nearest if separated else None


def _column(reference: str, metric: str) -> Column:
    distance, _, quantity = metric.partition("_")
    return Column(
        name=metric,
        label=LABELS.get(metric, ""),
        definition=DISTANCES.get(distance, "Unknown distance"),
        counted="simulated vehicles, each at a decision",
        interval="from resampled episodes and resampled human recordings, of the distance "
        "expected with as many recordings; for the sampling-noise floor, the range of 95 % of such "
        "distances",
        group=reference,
        quantity=quantity,
        form=".3f",
    )
