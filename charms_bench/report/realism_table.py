"""The table of realism: how far each traffic is from human driving, reference by reference.

Two quantities of all vehicles (`engine.following`), each with three distances
(`statistics.divergence`). The paper reports KL from the human data, on bins it does not state;
here they are 1 m/s and 5 m. Jensen-Shannon uses the same bins, Wasserstein those of the rows.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import polars as pl

from charms_bench.engine.following import BIN, QUANTITIES
from charms_bench.people.reference import Reference
from charms_bench.report.definitions import RESAMPLED
from charms_bench.report.suite_table import DIGITS
from charms_bench.report.table import Column, Table, long_schema
from charms_bench.runs.cells import TrafficCounts
from charms_bench.runs.suite import Suite
from charms_bench.statistics.divergence import (
    PSEUDO_COUNT,
    js_divergence,
    kl_divergence,
    wasserstein,
)
from charms_bench.statistics.intervals import CONFIDENCE, resampled_totals
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
COUNTED = (
    "simulated vehicles, each at a decision. The interval is that of the simulation alone; the "
    "uncertainty of the human data, which is large where few people were recorded, is not in it"
)
"""What n counts."""


def coarse(counts: Floats, quantity: str) -> Floats:
    """[..., BINS] -> [..., K] counts in the wider bins of a quantity."""
    together = round(COARSE_BIN[quantity] / BIN)
    return np.asarray(counts.reshape(*counts.shape[:-1], -1, together).sum(axis=-1))


def distances(human: Floats, simulated: Floats, quantity: str) -> dict[str, Floats]:
    """Each distance [...] of simulated counts [..., BINS] from human ones [BINS], by metric."""
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
    records = []
    for quantity in QUANTITIES:
        for traffic in traffics:
            counts = traffic.of_quantity(quantity)
            totals = counts.sum(axis=0)
            resampled = resampled_totals([counts], np.random.default_rng(suite.seed))
            for reference in references:
                human = reference.counts(quantity)
                if human is None:
                    continue
                spread = distances(human, resampled, quantity)
                for metric, value in distances(human, totals, quantity).items():
                    numbers = (float(value), *_interval(spread[metric]), round(totals.sum()))
                    records.append((traffic.traffic, reference.name, metric, *numbers))
    places = {reference.name: place for place, reference in enumerate(references)}
    rounded = pl.col("value", "low", "high").fill_nan(None).round_sig_figs(DIGITS)
    frame = pl.DataFrame(records, schema=long_schema(KEYS, LONG), orient="row")
    order = pl.col("reference").replace_strict(places)
    return from_frame(frame.with_columns(rounded).sort(order, maintain_order=True), suite)


def _interval(values: Floats) -> tuple[float, float]:
    """The percentiles of resampled values; NaN if none is defined."""
    values = values[~np.isnan(values)]
    tail = (1 - CONFIDENCE) / 2
    low, high = np.quantile(values, [tail, 1 - tail]) if values.size else (np.nan, np.nan)
    return float(low), float(high)


def from_frame(frame: pl.DataFrame, suite: Suite) -> Table:
    """The table of realism from its long frame; the smallest distances are marked."""
    table = Table.from_frame(
        frame,
        f"{suite.suite}-realism",
        "Distance of traffics from human driving",
        KEYS,
        LONG,
        _column,
        note="The traffic nearest to human driving is marked.",
    )
    known = [[n.value for n in table.column(i)] for i in range(len(table.columns))]
    least = [min((each for each in column if each is not None), default=None) for column in known]
    rows = []
    for row in table.rows:
        cells = (
            replace(number, marked=number.value is not None and number.value == smallest)
            for number, smallest in zip(row.numbers, least, strict=True)
        )
        rows.append(replace(row, cells=tuple(cells)))
    return replace(table, rows=tuple(rows))


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
