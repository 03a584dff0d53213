"""A replay over time: the ego's gaps, time to collision, speed and reward."""

import numpy as np
from matplotlib.figure import Figure

from charms_bench.episodes.ego_view import EgoView
from charms_bench.episodes.replay import Replay
from charms_bench.report.figures.drawing import SERIES, panels
from charms_bench.world.scene import Floats, Ints
from charms_bench.world.thresholds import CONFLICT_TTC_S

GAP_SHOWN_M, TTC_SHOWN_S = 60.0, 10.0
"""Larger values lie above the upper edge."""
LEFT, RIGHT = 0.085, 0.99
"""Where time begins and ends, as shares of the figure's width."""


def draw_timelines(replay: Replay, view: EgoView) -> Figure:
    """The ego's timelines, one above the other."""
    figure, axes = panels(4, 5.6, 1.0, side_by_side=1)
    # Fixed margins: the cursor of the page has to know where the axes are.
    figure.set_layout_engine(None)
    figure.subplots_adjust(LEFT, 0.09, RIGHT, 0.955, hspace=0.28)
    t_s, ego = replay.t_s, replay.ego
    gaps, ttc, speed, reward = axes
    gaps.plot(t_s, _broken(view.gap_ahead, view.leader), color=SERIES[0], label="ahead")
    behind = _broken(view.gap_behind, view.follower)
    gaps.plot(t_s, behind, color=SERIES[1], linestyle="--", label="behind")
    largest = float(np.nan_to_num([view.gap_ahead, view.gap_behind]).max())
    gaps.set(ylim=(0, min(GAP_SHOWN_M, 1.1 * largest) or GAP_SHOWN_M), ylabel="gap, m")
    above = {"loc": "lower right", "bbox_to_anchor": (1, 0.98), "borderaxespad": 0}
    gaps.legend(frameon=False, fontsize=7, ncols=2, **above)
    ttc.plot(t_s, _broken(view.ttc, view.leader), color=SERIES[0])
    ttc.axhline(CONFLICT_TTC_S, color=SERIES[6], linestyle=":", linewidth=1)
    ttc.set(ylim=(0, TTC_SHOWN_S), ylabel="TTC, s")
    speed.plot(t_s, replay.speed[:, ego], color=SERIES[0])
    speed.set_ylabel("speed, m/s")
    reward.step(t_s, view.reward, where="post", color=SERIES[0])
    reward.set(ylim=(-0.05, 1.05), xlabel="time, s", ylabel="reward")
    reward.xaxis.label.set_size(7.5)
    for panel in axes:
        panel.set_xlim(0, max(float(t_s[-1]), 1e-9))
        panel.grid(axis="y", linewidth=0.4, alpha=0.4)
        panel.tick_params(labelsize=7)
        panel.yaxis.label.set_size(7.5)
        panel.locator_params(axis="y", nbins=4)
        if panel is not reward:
            panel.set_xticklabels([])
    figure.align_ylabels()
    return figure


def _broken(values: Floats, vehicle: Ints) -> Floats:
    """The values, NaN where the vehicle that they belong to changes."""
    changed = np.diff(vehicle, prepend=vehicle[:1]) != 0
    broken: Floats = np.where(changed, np.nan, values)
    return broken
