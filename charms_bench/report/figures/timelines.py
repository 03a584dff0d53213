"""A replay over time: the ego's gaps, time to collision, speed and reward."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from charms_bench.episodes.ego_view import EgoView, ego_view
from charms_bench.episodes.replay import Replay
from charms_bench.report.figures.drawing import EDGE, SERIES, panels
from charms_bench.world.scene import Floats, Ints
from charms_bench.world.thresholds import CONFLICT_TTC_S

GAP_SHOWN_M, TTC_SHOWN_S = 60.0, 10.0
"""Larger values lie above the upper edge."""
LEFT, RIGHT = 0.085, 0.975
"""Where time begins and ends, as fractions of the figure's width."""
FADED = {"alpha": 0.45, "linewidth": 2.4}
"""How the other future is drawn, as its vehicles are."""


def draw_timelines(replay: Replay, view: EgoView, other: Replay | None = None) -> Figure:
    """The ego's timelines, one above the other; those of another future are faded."""
    figure, axes = panels(4, 5.6, 1.0, side_by_side=1)
    # Fixed margins: the cursor of the page has to know where the axes are.
    figure.set_layout_engine(None)
    figure.subplots_adjust(LEFT, 0.09, RIGHT, 0.955, hspace=0.28)
    gaps, ttc, speed, reward = axes
    futures = [(replay, view)]
    if other is not None:
        other_view = ego_view(other)
        futures.insert(0, (other, other_view))
        _draw(axes, other, other_view, FADED)
        gaps.plot([], [], color=EDGE, label="what if", **FADED)
    _draw(axes, replay, view, {})
    gaps.plot([], [], color=SERIES[0], label="ahead")
    gaps.plot([], [], color=SERIES[1], linestyle="--", label="behind")
    found = [gap for _, each in futures for gap in (*each.gap_ahead, *each.gap_behind)]
    largest = float(np.nan_to_num(found).max())
    gaps.set(ylim=(0, min(GAP_SHOWN_M, 1.1 * largest) or GAP_SHOWN_M), ylabel="gap, m")
    above = {"loc": "lower right", "bbox_to_anchor": (1, 0.98), "borderaxespad": 0}
    gaps.legend(frameon=False, fontsize=7, ncols=3, **above)
    ttc.axhline(CONFLICT_TTC_S, color=SERIES[6], linestyle=":", linewidth=1)
    ttc.set(ylim=(0, TTC_SHOWN_S), ylabel="TTC, s")
    speed.set_ylabel("speed, m/s")
    reward.set(ylim=(-0.05, 1.05), xlabel="time, s", ylabel="reward")
    reward.xaxis.label.set_size(7.5)
    last = max(float(each.t_s[-1]) for each, _ in futures)
    for panel in axes:
        panel.set_xlim(0, max(last, 1e-9))
        panel.grid(axis="y", linewidth=0.4, alpha=0.4)
        panel.tick_params(labelsize=7)
        panel.yaxis.label.set_size(7.5)
        panel.locator_params(axis="y", nbins=4)
        if panel is not reward:
            panel.set_xticklabels([])
    figure.align_ylabels()
    return figure


def _draw(axes: Sequence[Any], replay: Replay, view: EgoView, look: dict[str, Any]) -> None:
    """Draws the lines of one future."""
    gaps, ttc, speed, reward = axes
    t_s, ahead = replay.t_s, {"color": SERIES[0], **look}
    gaps.plot(t_s, _broken(view.gap_ahead, view.leader), **ahead)
    behind = _broken(view.gap_behind, view.follower)
    gaps.plot(t_s, behind, color=SERIES[1], linestyle="--", **look)
    ttc.plot(t_s, _broken(view.ttc, view.leader), **ahead)
    speed.plot(t_s, replay.speed[:, replay.ego], **ahead)
    reward.step(t_s, view.reward, where="post", **ahead)


def _broken(values: Floats, vehicle: Ints) -> Floats:
    """The values, NaN where the vehicle that they belong to changes."""
    changed = np.diff(vehicle, prepend=vehicle[:1]) != 0
    broken: Floats = np.where(changed, np.nan, values)
    return broken
