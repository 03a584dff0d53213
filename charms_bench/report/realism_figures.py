"""The paper's two figures of realism: speeds while following, headways at lane changes."""

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from charms_bench.engine.following import QUANTITIES
from charms_bench.people.reference import Reference
from charms_bench.report.figures import GREY, panels, save
from charms_bench.report.realism import COARSE_BIN, TITLE, UNIT, coarse
from charms_bench.runs.cells import TrafficCounts
from charms_bench.world.scene import Floats

COLOURS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#000000")
"""Okabe & Ito 2008, which colour-blind readers tell apart."""
EDGE = "#6b7785"
STYLES = ("-", "--", "-.", ":")
SHOWN = 1e-3
"""Bins in which nobody has a greater share are cut off at both ends."""


def draw_realism(
    folder: Path, name: str, traffics: Sequence[TrafficCounts], references: Sequence[Reference]
) -> list[Path]:
    """Draws `<name>-speed.png` and `<name>-dhw.png`, where there is a reference, into a folder."""
    drawn = []
    for quantity in QUANTITIES:
        if people := recorded(quantity, references):
            drawn.append(folder / f"{name}-{quantity}.png")
            save(draw_distributions(quantity, traffics, people), drawn[-1])
    return drawn


def recorded(quantity: str, references: Sequence[Reference]) -> dict[str, Floats]:
    """The counts [BINS] of the references that have the quantity, by their names."""
    people = {each.name: each.counts(quantity) for each in references}
    return {name: counts for name, counts in people.items() if counts is not None}


def draw_distributions(
    quantity: str, traffics: Sequence[TrafficCounts], people: Mapping[str, Floats]
) -> Figure:
    """A panel a reference: its density filled, each traffic's a line, on the bins of KL."""
    width, unit = COARSE_BIN[quantity], UNIT[quantity]
    lines = [_density(traffic.of_quantity(quantity).sum(axis=0), quantity) for traffic in traffics]
    edges = width * np.arange(lines[0].size + 1)
    areas = [_density(counts, quantity) for counts in people.values()]
    used = np.flatnonzero(np.max([*areas, *lines], axis=0) * width > SHOWN)
    figure, axes = panels(len(people), 4.2, 3.9)
    for panel, area, (name, counts) in zip(axes, areas, people.items(), strict=True):
        panel.stairs(area, edges, fill=True, color=GREY, label="people", zorder=1)
        panel.stairs(area, edges, color=EDGE, linewidth=0.8, zorder=1)
        for k, (traffic, line) in enumerate(zip(traffics, lines, strict=True)):
            panel.plot(
                edges[:-1] + width / 2,
                line,
                color=COLOURS[k % len(COLOURS)],
                linestyle=STYLES[k % len(STYLES)],
                label=traffic.traffic,
            )
        panel.set_title(f"{name}: {counts.sum():,.0f} counted", fontsize=10)
        panel.set(xlabel=unit, xlim=(edges[used[0]], edges[used[-1] + 1]))
        # Else a peak, as of a traffic that drives at one speed, presses people to the ground.
        panel.set_yscale("function", functions=(np.sqrt, np.square))
        panel.set_ylim(0, 1.05 * np.max([*areas, *lines]))
    axes[0].set_ylabel(f"share of vehicles per {unit}\n(square-root scale)")
    if len(people) > 1:
        figure.suptitle(TITLE[quantity], fontsize=11)
    named = axes[0].get_legend_handles_labels()
    columns = min(len(named[1]), 1 + len(people))
    figure.legend(
        *named, loc="outside lower center", ncols=min(columns, 3), frameon=False, fontsize=9
    )
    return figure


def _density(counts: Floats, quantity: str) -> Floats:
    summed = coarse(counts, quantity)
    return summed / max(float(summed.sum()), 1.0) / COARSE_BIN[quantity]
