"""The table of realism: how far each traffic is from human driving, reference by reference.

Two quantities of all vehicles (`engine.following`), each with three distances
(`statistics.divergence`). The paper reports KL from the human data, on bins it does not state;
here they are 1 m/s and 5 m. Jensen-Shannon uses the same bins, Wasserstein those of the rows. Two
more rows say which distances are possible: that of a perfect simulator, from so few recorded
drivers, and that of the recorded drivers themselves within the profile's range of speeds.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
import polars as pl

from charms_bench.engine.following import BIN, BINS, QUANTITIES, bins_of
from charms_bench.people.reference import Reference
from charms_bench.report.suite_table import DIGITS
from charms_bench.report.table import Column, Number, Table, long_schema
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
from charms_bench.world.scene import Floats

KEYS = ("traffic",)
LONG = {
    "reference": "group",
    "metric": "name",
    "value": "value",
    "low": "low",
    "high": "high",
    "n": "n",
}
COARSE_BIN = {"speed": 1.0, "dhw": 5.0}
"""Width of the bins of KL and Jensen-Shannon, m/s and m."""
TITLE = {"speed": "Speed while following", "dhw": "Headway at the start of a lane change"}
DISTANCES = {
    "kl": "Kullback-Leibler divergence of the simulated from the human shares, KL(human || "
    f"simulated), in nats, with {PSEUDO_COUNT:g} counts added to every bin of both. Where people "
    "do what no simulated vehicle does, it grows with the number of episodes. Bins are "
    f"{COARSE_BIN['speed']:g} m/s and {COARSE_BIN['dhw']:g} m wide",
    "js": "Jensen-Shannon divergence in bits, in the same bins, not smoothed: 0 for the same "
    "shares, 1 if no bin is shared",
    "wasserstein": "First Wasserstein distance, m/s or m: how far one distribution has to be "
    f"moved, on average, to become the other. Its bins are {BIN:g} m/s and {BIN:g} m wide",
}
"""What each distance is."""
COUNTED = "simulated vehicles, each at a decision"
"""What n counts."""
RESAMPLED = (
    "from resampled episodes and resampled human recordings, of the distance expected with as many "
    "recordings; for a perfect simulator, the range of 95 % of its distances"
)
PERFECT = "(perfect simulator)"
CLIPPED = "(people, speed clipped)"
NOTE = (
    f"The row {PERFECT} has the median distance of a simulator that drives exactly like people, "
    "which is not 0 because few people were recorded, and the range of 95 % of such distances. The "
    f"row {CLIPPED} has the distance of the recorded people from themselves if their speeds were "
    "kept within the range of the profile; no simulator of this profile can be expected to be "
    "nearer. A traffic is marked as the nearest to human driving if its interval lies below that "
    "of every other traffic, and the distance of the next nearest lies above that range of a "
    "perfect simulator."
)


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
    limits = [int(bins_of(each)) for each in (profile.speed_min_mps, profile.speed_max_mps)]
    records = []
    for quantity in QUANTITIES:
        counts = {each.traffic: each.of_quantity(quantity) for each in traffics}
        simulated = {
            name: (
                each.sum(axis=0).astype(np.float64),
                resampled_totals([each], np.random.default_rng(suite.seed)),
            )
            for name, each in counts.items()
        }
        n = round(float(np.median([totals.sum() for totals, _ in simulated.values()])))
        for reference in references:
            units = reference.units(quantity)
            if not len(units):
                continue
            human = units.sum(axis=0)
            rng = np.random.default_rng((suite.seed, 1))
            humans = resampled_totals([units], rng)
            beside = dict(simulated)
            if quantity == "speed":
                clipped = [_as_many(_clipped(each, *limits), n) for each in (human, humans)]
                beside[CLIPPED] = (clipped[0], clipped[1])
            for name, (totals, resampled) in beside.items():
                spread = distances(humans, resampled, quantity)
                for metric, value in distances(human, totals, quantity).items():
                    interval = around(float(value), spread[metric], len(units))
                    numbers = (float(value), *interval, round(totals.sum()))
                    records.append((name, reference.name, metric, *numbers))
            if len(units) > 1:
                truth, samples = perfect_samples(units, rng)
                for metric, found in distances(samples, n * truth, quantity).items():
                    scores = np.quantile(found, [0.5, 0.025, 0.975]).tolist()
                    records.append((PERFECT, reference.name, metric, *scores, n))
    places = {reference.name: place for place, reference in enumerate(references)}
    rounded = pl.col("value", "low", "high").fill_nan(None).round_sig_figs(DIGITS)
    frame = pl.DataFrame(records, schema=long_schema(KEYS, LONG), orient="row")
    order = pl.col("reference").replace_strict(places)
    return from_frame(frame.with_columns(rounded).sort(order, maintain_order=True), suite)


def _clipped(counts: Floats, lowest: int, highest: int) -> Floats:
    """Counts [..., BINS] with those below and above two bins added to them."""
    return np.asarray(counts @ np.eye(BINS)[np.arange(BINS).clip(lowest, highest)])


def _as_many(counts: Floats, n: int) -> Floats:
    """Counts [..., BINS] scaled to a total, on which the smoothing of KL depends."""
    return np.asarray(counts * (n / counts.sum(axis=-1, keepdims=True)))


def from_frame(frame: pl.DataFrame, suite: Suite) -> Table:
    """The table of realism from its long frame; the nearest traffics are marked, see `NOTE`."""
    table = Table.from_frame(
        frame,
        f"{suite.suite}-realism",
        "Distance of traffics from human driving",
        KEYS,
        LONG,
        _column,
        note=NOTE,
    )
    names = [row.labels[0] for row in table.rows]
    columns = range(len(table.columns))
    nearest = [_nearest(dict(zip(names, table.column(i), strict=True))) for i in columns]
    rows = []
    for row, name in zip(table.rows, names, strict=True):
        cells = (
            replace(number, marked=name == each)
            for number, each in zip(row.numbers, nearest, strict=True)
        )
        rows.append(replace(row, cells=tuple(cells)))
    return replace(table, rows=tuple(rows))


def _nearest(column: Mapping[str, Number]) -> str | None:
    """The traffic that is nearest to human driving, if the data separate it; see `NOTE`."""
    perfect = column.get(PERFECT, Number()).high
    ranked = sorted(
        (number.value, name)
        for name, number in column.items()
        if name not in (PERFECT, CLIPPED) and number.value is not None
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
        definition=DISTANCES.get(distance, "Unknown distance"),
        counted=COUNTED,
        interval=RESAMPLED,
        group=reference,
        quantity=quantity,
        form=".3f",
    )
