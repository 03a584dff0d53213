"""Every ego in every traffic, as heat maps."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.colors import PowerNorm
from matplotlib.figure import Figure

from charms_bench.report.figures.drawing import heat_map, panels
from charms_bench.report.formatting import write_cells
from charms_bench.report.suite_table import HIGHER_IS_BETTER, MATRICES, NO_DIRECTION
from charms_bench.report.table import Table

COLOURS, WITHOUT_DIRECTION = "Reds", "Blues"
"""Of heat maps in which darker is worse, and of those in which it is only higher."""
SIDE_BY_SIDE = 3


def reading(matrix: Table) -> str:
    """What the colours of a matrix mean."""
    metric = _metric(matrix)
    if metric in NO_DIRECTION:
        return "Darker is higher, which is neither better nor worse."
    scale = " All proportions have one scale of colours." if _is_proportion(metric) else ""
    return f"Darker is worse: {'lower' if metric in HIGHER_IS_BETTER else 'higher'} values.{scale}"


def draw_matrices(matrices: Sequence[Table]) -> Figure:
    """Some of `suite_table.matrices`."""
    egos = [row.labels[0] for row in matrices[0].rows]
    traffics = [column.name for column in matrices[0].columns]
    width, height = 1.6 + 0.75 * len(traffics), 1.8 + 0.45 * len(egos)
    figure, every = panels(len(matrices), width, height, SIDE_BY_SIDE)
    for k, (axes, matrix) in enumerate(zip(every, matrices, strict=True)):
        values = np.array([[n.value for n in row.numbers] for row in matrix.rows], dtype=float)
        texts = [[cell.value for cell in cells] for cells in write_cells(matrix)]
        names = egos if k % SIDE_BY_SIDE == 0 else [""] * len(egos)
        heat_map(axes, values, texts, names, traffics, **_colours(_metric(matrix)))
        axes.set_title(matrix.title, fontsize=9)
    return figure


def _metric(matrix: Table) -> str:
    return matrix.name.rpartition("-")[2]


def _is_proportion(metric: str) -> bool:
    return MATRICES[metric][1] == 100.0


def _colours(metric: str) -> dict[str, Any]:
    """Options of `heat_map`; proportions are in percent, on a root scale for the small ones."""
    colours = WITHOUT_DIRECTION if metric in NO_DIRECTION else COLOURS
    colours += "_r" * (metric in HIGHER_IS_BETTER)
    return {"cmap": colours, "norm": PowerNorm(0.5, 0, 100) if _is_proportion(metric) else None}
