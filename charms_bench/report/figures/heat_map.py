"""Every ego in every traffic, as heat maps."""

from collections.abc import Sequence

import numpy as np
from matplotlib.figure import Figure

from charms_bench.report.figures.drawing import heat_map, panels
from charms_bench.report.formatting import write_cells
from charms_bench.report.table import Table

COLOURS = ("Reds", "Blues", "Oranges", "Purples", "Greens", "Greys")
"""Of the matrices of `suite_table.MATRICES`."""
SIDE_BY_SIDE = 3


def draw_matrices(matrices: Sequence[Table], first: int = 0) -> Figure:
    """Some of `suite_table.matrices`, whose first has the place `first`, which chooses colours."""
    egos = [row.labels[0] for row in matrices[0].rows]
    traffics = [column.name for column in matrices[0].columns]
    width, height = 1.6 + 0.75 * len(traffics), 1.8 + 0.45 * len(egos)
    figure, every = panels(len(matrices), width, height, SIDE_BY_SIDE)
    for k, (axes, matrix) in enumerate(zip(every, matrices, strict=True)):
        values = np.array(
            [[n.value for n in each.numbers] for each in matrix.rows], dtype=np.float64
        )
        texts = [[cell.value for cell in cells] for cells in write_cells(matrix)]
        names = egos if k % SIDE_BY_SIDE == 0 else [""] * len(egos)
        heat_map(axes, values, texts, names, traffics, cmap=COLOURS[(first + k) % len(COLOURS)])
        axes.set_title(matrix.title, fontsize=9)
    return figure
