"""The trade-off figure: speed against crashes, or density of a traffic against its crashes."""

from typing import NamedTuple

import numpy as np
from matplotlib.figure import Figure
from matplotlib.text import Annotation
from matplotlib.transforms import Bbox

from charms_bench.episodes.palette import points
from charms_bench.report.figures.drawing import panels, reach, take_text_as_it_is
from charms_bench.report.table import Number, Table
from charms_bench.runs.suite import Suite

TICKS = (0.0, 0.01, 0.02, 0.05, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 1.0)
FINE_TICKS = (0.001, 0.002, 0.005)
"""More ticks where all shares are small."""
BACKGROUND = {"facecolor": "white", "alpha": 0.7, "edgecolor": "none", "pad": 0.5}
"""Keeps names legible where they lie on points."""


class Tradeoff(NamedTuple):
    """Which metric is drawn against which; of metrics in both sets, those of `standard`."""

    across: str
    across_label: str
    share: str
    """A metric that is a share, drawn upwards."""
    share_label: str
    named: int
    """The label that points carry: 0 for the agent, 1 for the traffic; the other one colours."""


OF_EGOS = Tradeoff("speed_mean", "mean speed, m/s", "crashed_episodes", "episodes crashed", 0)
OF_TRAFFICS = Tradeoff(
    "interaction_density",
    "vehicles within 30 m and a lane of the ego",
    "traffic_crashed",
    "vehicles of the traffic that crash in an episode",
    1,
)


def tradeoff_of(suite: Suite) -> Tradeoff:
    """What suits the suite: egos, or the traffics of one ego."""
    return OF_EGOS if len(suite.egos) > 1 else OF_TRAFFICS


def draw_tradeoff(
    table: Table, tradeoff: Tradeoff, width: float = 8.6, height: float = 5.2
) -> Figure:
    """The cells of a suite's table with their 95 % intervals.

    Points carry their names, or numbers of a list if there are several groups.

    Args:
        table: The suite's.
        tradeoff: What is drawn.
        width: Of the figure, inches.
        height: Of the figure, inches.
    """
    groups = _groups(table, tradeoff)
    names = list(dict.fromkeys(row.labels[tradeoff.named] for row in table.rows))
    figure, (axes,) = panels(1, width, height)
    texts: list[Annotation] = []
    for index, (group, found) in enumerate(groups.items()):
        across, up = ([pair[i] for _, pair in found] for i in (0, 1))
        x, y = ([number.value for number in numbers] for numbers in (across, up))
        axes.errorbar(
            x,
            y,
            xerr=reach(across),
            yerr=reach(up),
            linestyle="",
            elinewidth=0.8,
            label=group,
            **points(index),
        )
        for (name, _), *at in zip(found, x, y, strict=True):
            label = name if len(groups) == 1 else str(names.index(name) + 1)
            texts.append(axes.annotate(label, at, fontsize=8, bbox=BACKGROUND))
    # Roots, so that the few crashes of good drivers are not all one point.
    axes.set_yscale("function", functions=(_root, np.square))
    top = axes.get_ylim()[1]
    axes.set_ylim(0, top)
    ticks = TICKS if top > 0.05 else (*TICKS, *FINE_TICKS)
    axes.set_yticks(sorted(share for share in ticks if share < top))
    axes.margins(x=0.12)
    axes.yaxis.set_major_formatter(lambda share, _: f"{100 * share:g} %")
    axes.set(xlabel=tradeoff.across_label, ylabel=f"{tradeoff.share_label}\n(square-root scale)")
    if len(groups) > 1:
        listed = "\n".join(f"{number}  {name}" for number, name in enumerate(names, 1))
        place = {"transform": axes.transAxes, "va": "top"}
        axes.text(1.02, 1.0, listed, fontsize=8, linespacing=1.5, **place)
        axes.legend(
            title=table.keys[1 - tradeoff.named],
            frameon=False,
            fontsize=8,
            title_fontsize=8,
            loc="lower left",
            bbox_to_anchor=(1.0, 0.0),
        )
    take_text_as_it_is(figure)
    figure.draw_without_rendering()  # only then is it known where points are
    _place(texts)
    return figure


def _groups(table: Table, tradeoff: Tradeoff) -> dict[str, list[tuple[str, tuple[Number, Number]]]]:
    """The name and the two numbers of every cell that has both, by what colours them."""
    groups: dict[str, list[tuple[str, tuple[Number, Number]]]] = {}
    if (places := table.places(tradeoff.across, tradeoff.share)) is None:
        return groups
    for row in table.rows:
        x, y = (row.numbers[i] for i in places)
        if x.value is not None and y.value is not None:
            name, group = row.labels[tradeoff.named], row.labels[1 - tradeoff.named]
            groups.setdefault(group, []).append((name, (x, y)))
    return groups


def _place(texts: list[Annotation]) -> None:
    """Moves labels up until none lies on another."""
    taken: list[Bbox] = []
    for text in sorted(texts, key=lambda text: text.get_window_extent().y0):
        up = 4
        while True:
            text.set_position((5, up))
            text.set_anncoords("offset points")
            box = text.get_window_extent()
            if not any(box.overlaps(other) for other in taken):
                break
            up += 4
        taken.append(box)


def _root(shares: np.ndarray) -> np.ndarray:
    root: np.ndarray = np.sqrt(np.maximum(shares, 0.0))
    return root
