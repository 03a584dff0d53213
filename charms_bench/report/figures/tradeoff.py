"""The trade-off figure: speed against crashes, or density of the traffic against its crashes."""

from collections.abc import Sequence
from itertools import count
from typing import NamedTuple

import numpy as np
from matplotlib.figure import Figure
from matplotlib.text import Annotation
from matplotlib.transforms import Bbox

from charms_bench.metrics.labels import key_label_of
from charms_bench.report.figures.drawing import (
    PAPER,
    any_letters,
    crosses,
    panels,
    points,
    take_text_as_it_is,
)
from charms_bench.report.number import Number
from charms_bench.report.table import Row, Table
from charms_bench.runs.cells import title_of
from charms_bench.runs.suite import Suite

TICKS = (0.0, 0.01, 0.02, 0.05, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 1.0)
FINE_TICKS = (0.001, 0.002, 0.005)
"""More ticks where all proportions are small."""
BACKGROUND = {"facecolor": PAPER, "alpha": 0.7, "edgecolor": "none", "pad": 0.5}
"""Keeps names legible where they lie on points."""


class Tradeoff(NamedTuple):
    """Which metric is drawn against which; of metrics in both sets, those of `standard`."""

    across: str
    across_label: str
    proportion: str
    """A proportion, drawn upwards."""
    proportion_label: str
    named: int
    """The label that points carry: 0 for the agent, 1 for the traffic; the other one colours."""
    part: str = ""
    """A part of the proportion, drawn as a hollow point below it."""


OF_EGOS = Tradeoff(
    across="speed_mean",
    across_label="mean speed, m/s",
    proportion="crashed_episodes",
    proportion_label="crashed episodes; hollow: at fault",
    named=0,
    part="crashed_at_fault",
)
OF_TRAFFICS = Tradeoff(
    across="interaction_density",
    across_label="vehicles within 30 m and a lane of the ego",
    proportion="traffic_crashed",
    proportion_label="crashed vehicles in traffic",
    named=1,
)


def tradeoff_of(suite: Suite) -> Tradeoff:
    """The trade-off that suits the suite: of egos, or of one ego's traffic models."""
    return OF_EGOS if len(suite.egos) > 1 else OF_TRAFFICS


def draw_tradeoff(
    table: Table, tradeoff: Tradeoff, size: Sequence[float] = (8.6, 5.2), is_narrow: bool = False
) -> Figure:
    """The cells of a suite's table with their 95 % intervals; the size is in inches.

    Points carry their names, or numbers of a list if there are several groups. A narrow figure has
    the list and the legend below it, and always numbers.
    """
    groups: dict[str, list[tuple[str, Number, Number]]] = {}
    places = table.places(tradeoff.across, tradeoff.proportion)
    part = table.places(tradeoff.part) or []
    parts: dict[str, list[tuple[float, float]]] = {}
    for row in table.rows if places else ():
        x, y = (row.numbers[i] for i in places or ())
        if x.value is not None and y.value is not None:
            labels = _labels(row)
            name, group = labels[tradeoff.named], labels[1 - tradeoff.named]
            groups.setdefault(group, []).append((name, x, y))
            found_parts = [row.numbers[i].value for i in part]
            parts.setdefault(group, []).extend((x.value, v) for v in found_parts if v is not None)
    names = list(dict.fromkeys(_labels(row)[tradeoff.named] for row in table.rows))
    is_numbered = is_narrow or len(groups) > 1
    lines = 0.2 * (len(names) + len(groups))
    beside = lines + 1.0 if is_numbered else 0.0
    height = size[1] + lines if is_narrow else max(size[1], beside)
    figure, (axes,) = panels(1, size[0], height)
    texts: list[Annotation] = []
    for index, (group, found) in enumerate(groups.items()):
        across, up = ([numbers[i] for _, *numbers in found] for i in (0, 1))
        crosses(axes, across, up, elinewidth=0.8, label=group, **points(index))
        hollow = np.reshape(parts[group], (-1, 2))
        axes.plot(*hollow.T, linestyle="", markerfacecolor="none", **points(index))
        for name, x, y in found:
            label = str(names.index(name) + 1) if is_numbered else name
            texts.append(axes.annotate(label, (x.value, y.value), fontsize=8, bbox=BACKGROUND))
    # Roots, so that the few crashes of good drivers are not all one point.
    axes.set_yscale("function", functions=(lambda y: np.sqrt(np.maximum(y, 0.0)), np.square))
    top = axes.get_ylim()[1]
    axes.set_ylim(0, top)
    ticks = TICKS if top > 0.05 else (*TICKS, *FINE_TICKS)
    axes.set_yticks(sorted(tick for tick in ticks if tick < top))
    axes.margins(x=0.12)
    axes.yaxis.set_major_formatter(lambda proportion, _: f"{100 * proportion:g} %")
    axes.set(
        xlabel=tradeoff.across_label, ylabel=f"{tradeoff.proportion_label}\n(square-root scale)"
    )
    listed = "\n".join(f"{number}  {name}" for number, name in enumerate(names, 1))
    text = {"title": key_label_of(table.keys[1 - tradeoff.named]), "title_fontsize": 8}
    if is_narrow:
        # The list is an axis label, so that the layout leaves room for it.
        axes.set_xlabel(f"{tradeoff.across_label}\n\n{listed}", linespacing=1.5, fontsize=8.5)
        axes.yaxis.label.set_size(8.5)
        if len(groups) > 1:
            axes.legend(**text, fontsize=8, frameon=False, loc="lower left", bbox_to_anchor=(0, 1))
    elif is_numbered:
        place = {"transform": axes.transAxes, "va": "top"}
        axes.text(1.02, 1.0, listed, fontsize=8, linespacing=1.5, **place)
        right = {"loc": "lower left", "bbox_to_anchor": (1.0, 0.0)}
        axes.legend(**text, fontsize=8, frameon=False, **right)
    take_text_as_it_is(figure)
    with any_letters():
        figure.draw_without_rendering()  # only then is it known where points are
    _place(texts)
    return figure


def _labels(row: Row) -> tuple[str, str]:
    """The ego, and the traffic model with its road."""
    return row.labels[0], title_of(row.labels[1:])


def _place(texts: list[Annotation]) -> None:
    """Moves labels up until none lies on another."""
    taken: list[Bbox] = []
    for text in sorted(texts, key=lambda text: text.get_window_extent().y0):
        text.set_anncoords("offset points")
        for up in count(4, step=4):
            text.set_position((5, up))
            box = text.get_window_extent()
            if not any(box.overlaps(other) for other in taken):
                taken.append(box)
                break
