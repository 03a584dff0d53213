"""Draws crashes of a run on roads, for people who judge them.

    python tools/crash_pictures.py RUN OUT

OUT/K.png shows crash K four times, without what the rule of fault says: where the ego (green) and
the others were, with their speeds in m/s and the ways of the last 4 s. Surfaces with the right of
way are darker where the road says who has it. OUT/crashes.csv has what the rule says. The crashes
are drawn at random, each road as often as the others.
"""

import argparse
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import polars as pl

import charms_bench
from charms_bench.episodes.replay import Replay
from charms_bench.roads.episodes import episodes_of_agents
from charms_bench.world.plan_view import lines_of

BEFORE_S = (2.0, 1.0, 0.4, 0.0)
TRAIL_S, RADIUS_M = 4.0, 32.0
SHADES = ["0.90", "0.80", "0.70", "0.62", "0.54"]


def draw(replay: Replay, path: Path) -> None:
    """Draws the moments before the first collision of the ego."""
    plan, hz = replay.plan, replay.settings.simulation_hz
    assert plan is not None
    assert replay.settings.network is not None
    last = int(np.argmax(plan.crashed[:, 0]))
    known = episodes_of_agents(replay.settings.network, 1, hz)
    ranks = known.task.ranks(known.scenes)
    levels = np.unique(ranks[ranks >= 0]).tolist()
    figure, panels = plt.subplots(1, len(BEFORE_S), figsize=(24, 6.6), layout="constrained")
    for before, axes in zip(BEFORE_S, panels, strict=True):
        now = max(last - round(before * hz), 0)
        surfaces = lines_of(plan.road).surfaces
        for lane in np.argsort(ranks, kind="stable").tolist():
            shade = SHADES[1 + levels.index(ranks[lane])] if ranks[lane] >= 0 else SHADES[0]
            axes.fill(*surfaces[lane].T, shade, lw=0)
        for line in (*plan.lines.continuous, *plan.lines.striped):
            axes.plot(*line.T, color="white", lw=1)
        for k in np.nonzero(plan.present[now])[0].tolist():
            colour = "tab:green" if k == 0 else "black" if plan.is_obstacle[now, k] else "tab:blue"
            colour = "tab:red" if plan.crashed[now, k] and now < last else colour
            trail = slice(max(now - round(TRAIL_S * hz), 0), now + 1)
            there = plan.present[trail, k]
            axes.plot(plan.x[trail, k][there], plan.y[trail, k][there], color=colour, lw=1)
            half = plan.length[now, k] / 2, plan.width[now, k] / 2
            cos, sin = np.cos(plan.heading[now, k]), np.sin(plan.heading[now, k])
            corners = np.array([(1, 0), (0.4, 1), (-1, 1), (-1, -1), (0.4, -1)]) * half
            centre = np.array([plan.x[now, k], plan.y[now, k]])
            outline = corners @ np.array([(cos, sin), (-sin, cos)]) + centre
            axes.fill(*outline.T, colour, ec="black", lw=0.6)
            place = plan.x[now, k] + 2.5, plan.y[now, k] - 2.5
            axes.text(*place, f"{plan.speed[now, k]:.1f}", fontsize=9, clip_on=True)
        x, y = plan.x[last, 0], plan.y[last, 0]
        axes.set(xlim=(x - RADIUS_M, x + RADIUS_M), ylim=(y + RADIUS_M, y - RADIUS_M))
        axes.set(aspect="equal", xticks=[], yticks=[])
        axes.set_title(f"{(last - now) / hz:.1f} s before" if now < last else "collision")
    figure.savefig(path, dpi=50)
    plt.close(figure)


def main(run: Path, out: Path, count: int, seed: int) -> None:
    """Draws crashes of a run."""
    opened = charms_bench.open_run(run)
    crashes = opened.episodes.filter(pl.col("ending").is_in(["rear_end", "side"]))
    crashes = crashes.sort("road", "agent", "traffic", "episode").sample(
        fraction=1.0, shuffle=True, seed=seed
    )
    crashes = crashes.with_columns(turn=pl.int_range(pl.len()).over("road")).sort(
        "turn", maintain_order=True
    )
    drawn = crashes.head(count).sample(fraction=1.0, shuffle=True, seed=seed)
    out.mkdir(parents=True)
    for k, row in enumerate(drawn.iter_rows(named=True)):
        where = {"ego": row["agent"], "traffic": row["traffic"], "road": row["road"]}
        draw(opened.replay(row["episode"], **where), out / f"{k}.png")
    kept = ["road", "agent", "traffic", "episode", "ending", "at_fault_on_road"]
    drawn.select(kept).with_row_index("crash").write_csv(out / "crashes.csv")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("run", type=Path)
    parser.add_argument("out", type=Path)
    parser.add_argument("--count", type=int, default=60)
    parser.add_argument("--seed", type=int, default=0)
    given = parser.parse_args()
    main(given.run, given.out, given.count, given.seed)
