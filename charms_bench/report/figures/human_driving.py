"""Traffic models and human driving: speeds while following, headways at lane changes."""

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.figure import Figure

from charms_bench.humans.reference import Reference
from charms_bench.report.figures.drawing import EDGE, GREY, panels, series
from charms_bench.report.realism_table import COARSE_BIN, TITLE, coarse
from charms_bench.runs.cells import TrafficCounts
from charms_bench.world.scene import Floats

UNIT = {"speed": "m/s", "dhw": "m"}
SHOWN = 1e-3
"""Bins in which no traffic and no reference has a greater proportion are cut off at both ends."""


def recorded(quantity: str, references: Sequence[Reference]) -> dict[str, Floats]:
    """The counts [BINS] of the references that have the quantity, by their names."""
    people = {each.name: each.counts(quantity) for each in references}
    return {name: counts for name, counts in people.items() if counts is not None}


def draw_quantity(
    quantity: str, traffics: Sequence[TrafficCounts], people: Mapping[str, Floats]
) -> Figure:
    """A panel per reference: its density filled, each traffic's as a line, on the bins of KL."""
    width, unit = COARSE_BIN[quantity], UNIT[quantity]
    lines = [_density(traffic.of_quantity(quantity).sum(axis=0), quantity) for traffic in traffics]
    edges = width * np.arange(lines[0].size + 1)
    areas = [_density(counts, quantity) for counts in people.values()]
    used = np.flatnonzero(np.max([*areas, *lines], axis=0) * width > SHOWN)
    figure, axes = panels(len(people), 4.2, 3.9)
    for panel, area, (name, counts) in zip(axes, areas, people.items(), strict=True):
        panel.stairs(area, edges, fill=True, color=GREY, label="human drivers", zorder=1)
        panel.stairs(area, edges, color=EDGE, linewidth=0.8, zorder=1)
        for k, (traffic, line) in enumerate(zip(traffics, lines, strict=True)):
            panel.plot(edges[:-1] + width / 2, line, label=traffic.traffic, **series(k))
        panel.set_title(f"{name}: {counts.sum():,.0f} counted", fontsize=10)
        panel.set(xlabel=unit, xlim=(edges[used[0]], edges[used[-1] + 1]))
        # On a linear scale, the peak of traffic at one speed would hide the human drivers.
        panel.set_yscale("function", functions=(np.sqrt, np.square))
        panel.set_ylim(0, 1.05 * np.max([*areas, *lines]))
    axes[0].set_ylabel(f"proportion of vehicles per {unit}\n(square-root scale)")
    if len(people) > 1:
        figure.suptitle(TITLE[quantity], fontsize=11)
    named = axes[0].get_legend_handles_labels()
    columns = min(len(named[1]), 1 + len(people), 3)
    figure.legend(*named, loc="outside lower center", ncols=columns, frameon=False, fontsize=9)
    return figure


def _density(counts: Floats, quantity: str) -> Floats:
    summed = coarse(counts, quantity)
    return summed / max(float(summed.sum()), 1.0) / COARSE_BIN[quantity]
