"""Every ego against every traffic: who is good in whose company, as matrices."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import polars as pl
from matplotlib.figure import Figure

from charms_bench.report.figures import INK, panels, save
from charms_bench.world.files import write_atomically
from charms_bench.world.scene import Floats

SHOWN = {
    "crashed_episodes": ("Egos crashed, % of episodes", 100.0, "{:.1f}", "Reds"),
    "speed_mean": ("Mean speed of egos, m/s", 1.0, "{:.1f}", "Blues"),
    "traffic_crashed": ("Traffic crashed, % of vehicles an episode", 100.0, "{:.1f}", "Oranges"),
}
"""Metrics of the set `standard`: title, factor, form and colours of each."""


def write_matrices(markdown: Path, figure: Path, long: pl.DataFrame) -> None:
    """Writes the matrices of a table, egos down and traffics across.

    Args:
        markdown: The file to read, with 95 % intervals.
        figure: The heat maps' file.
        long: `tables.LONG_SCHEMA`.

    Raises:
        InputError: A file cannot be written.
    """
    egos, traffics, found = _found(long)
    text = "\n".join(_markdown(metric, found[metric], egos, traffics) for metric in SHOWN)
    write_atomically(markdown, lambda path: path.write_bytes(text.encode()))
    save(draw_matrices(long), figure)


def draw_matrices(long: pl.DataFrame, metrics: Sequence[str] = tuple(SHOWN)) -> Figure:
    """The matrices of a table as heat maps, side by side; of some of `SHOWN`."""
    egos, traffics, found = _found(long)
    drawing, row = panels(len(metrics), 1.6 + 0.75 * len(traffics), 1.8 + 0.45 * len(egos))
    for axes, metric in zip(row, metrics, strict=True):
        title, factor, form, colours = SHOWN[metric]
        values = found[metric]["value"] * factor
        corners = (np.arange(len(traffics) + 1) - 0.5, np.arange(len(egos) + 1) - 0.5)
        axes.pcolormesh(*corners, values, cmap=colours)
        axes.invert_yaxis()
        axes.spines[:].set_visible(False)
        axes.set_xticks(range(len(traffics)), traffics, rotation=30, ha="right", fontsize=8)
        axes.set_yticks(range(len(egos)), egos if axes is row[0] else [], fontsize=8)
        axes.set_title(title, fontsize=9)
        dark = np.nanmin(values) + 0.6 * np.ptp(values[~np.isnan(values)])
        for (i, j), value in np.ndenumerate(values):
            colour = "white" if value > dark else INK
            axes.text(j, i, form.format(value), ha="center", va="center", color=colour, fontsize=8)
    return drawing


def _found(
    long: pl.DataFrame,
) -> tuple[list[str], list[str], dict[str, dict[str, Floats]]]:
    """Egos, traffics, and the matrices by metric and number."""
    standard = long.filter(pl.col("metric_set").str.starts_with("standard-"))
    egos = standard["agent"].unique(maintain_order=True).to_list()
    traffics = standard["traffic"].unique(maintain_order=True).to_list()
    found = {
        metric: {
            name: _matrix(standard.filter(metric=metric), name, egos, traffics)
            for name in ("value", "low", "high")
        }
        for metric in SHOWN
    }
    return egos, traffics, found


def _matrix(rows: pl.DataFrame, name: str, egos: list[str], traffics: list[str]) -> Floats:
    """One number of a metric, (egos, traffics); NaN where there is none."""
    matrix = np.full((len(egos), len(traffics)), np.nan)
    for agent, traffic, value in rows.select("agent", "traffic", name).iter_rows():
        if value is not None:
            matrix[egos.index(agent), traffics.index(traffic)] = value
    return matrix


def _markdown(metric: str, numbers: dict[str, Floats], egos: list[str], traffics: list[str]) -> str:
    title, factor, form, _ = SHOWN[metric]
    lines = [
        f"## {title}",
        "",
        "| ego \\ traffic | " + " | ".join(_escaped(name) for name in traffics) + " |",
        "|---|" + "---:|" * len(traffics),
    ]
    for i, ego in enumerate(egos):
        cells = []
        for j in range(len(traffics)):
            value, low, high = (numbers[name][i, j] * factor for name in ("value", "low", "high"))
            interval = "" if np.isnan(low) else f" [{form.format(low)}, {form.format(high)}]"
            cells.append("–" if np.isnan(value) else form.format(value) + interval)
        lines.append(f"| {_escaped(ego)} | " + " | ".join(cells) + " |")
    return "\n".join(lines) + "\n"


def _escaped(text: str) -> str:
    return text.replace("|", "\\|")
