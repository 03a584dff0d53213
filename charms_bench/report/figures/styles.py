"""How much the egos of a run differ: the place of each, and the pairs that are distinct."""

import numpy as np
from matplotlib.figure import Figure

from charms_bench.report.figures.drawing import crosses, heat_map, panels, points
from charms_bench.report.table import Table

PLACED = {"speed_mean": "mean speed, m/s", "dhw_mean": "mean headway to the leader, m"}
"""The metrics that place an ego, across and up, with the labels of their axes."""


def draw_places(table: Table) -> Figure:
    """Each ego by its mean speed and headway, as the paper defines them, with 95 % intervals."""
    names = [column.name for column in table.columns]
    places = [names.index(metric) for metric in PLACED]
    figure, (axes,) = panels(1, 5.4, 4.2)
    for k, row in enumerate(table.rows):
        x, y = (row.numbers[i] for i in places)
        if x.value is not None and y.value is not None:
            look = {"elinewidth": 1.0, "markersize": 6.5, "label": row.labels[0], **points(k)}
            crosses(axes, [x], [y], **look)
    axes.set(xlabel=PLACED["speed_mean"], ylabel=PLACED["dhw_mean"])
    figure.legend(loc="outside lower center", ncols=2, frameon=False, fontsize=8)
    return figure


def draw_separations(pairs: Table) -> Figure:
    """In how many metrics each pair of egos differs by more than chance."""
    names = list(dict.fromkeys(row.labels[i] for i in (0, 1) for row in pairs.rows))
    counted = np.full((len(names), len(names)), np.nan)
    for row in pairs.rows:
        first, second = map(names.index, row.labels)
        counted[second, first] = sum(number.marked for number in row.numbers)
    texts = [[f"{count:z.0f}" for count in line] for line in counted]
    figure, (axes,) = panels(1, 5.4, 4.2)
    most = 1.6 * len(pairs.columns)
    heat_map(axes, counted, texts, names, names, cmap="Blues", vmin=0, vmax=most)
    axes.set(xlim=(-0.5, len(names) - 1.5), ylim=(len(names) - 0.5, 0.5))
    return figure
