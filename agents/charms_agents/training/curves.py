"""The learning curves of all stages: a table, and a figure like the paper's Fig. 3."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import polars as pl

from charms_agents.training.job import StageFolder
from charms_agents.training.settings import TrainingSuite
from charms_bench.world.files import write_atomically


def write_curves(output: Path, suite: TrainingSuite, folders: Mapping[str, StageFolder]) -> None:
    """Writes `curves.csv`, a row a stage and point, and `curves.png` into the run folder.

    The figure has the returns of stages among agents, those of stages among another stage's
    network, and the losses of what is fine-tuned and of imitation.
    """
    tables = {
        name: pl.read_csv(folders[name].curve_csv, infer_schema_length=None)
        for name in suite.needs
        if name in folders
    }
    long = pl.concat(
        [table.select(pl.lit(name).alias("stage"), pl.all()) for name, table in tables.items()],
        how="diagonal_relaxed",
    )
    csv, png = output / "curves.csv", output / "curves.png"
    text = long.write_csv()
    if png.exists() and csv.exists() and csv.read_text(encoding="utf-8") == text:
        return
    write_atomically(csv, lambda path: path.write_text(text, encoding="utf-8"))
    panels: dict[str, dict[str, pl.DataFrame]] = {}
    for name, table in tables.items():
        panels.setdefault(_panel(name, suite), {})[name] = table
    figure = _figure({title: panels[title] for title in sorted(panels)})
    write_atomically(png, lambda path: figure.savefig(path, format="png", dpi=120))


def _panel(name: str, suite: TrainingSuite) -> str:
    if name in suite.human_stages:
        return "(c) learning from human driving"
    return "(b) among other stages' networks" if suite.needs[name] else "(a) among agents"


def _figure(panels: Mapping[str, Mapping[str, pl.DataFrame]]) -> Any:
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure
    from matplotlib.ticker import EngFormatter

    figure = Figure(figsize=(5.6 * len(panels), 4.0), layout="constrained")
    FigureCanvasAgg(figure)
    (row,) = figure.subplots(1, len(panels), squeeze=False)
    for axes, (title, tables) in zip(row, panels.items(), strict=True):
        x, y = ("epoch", "loss") if title.startswith("(c)") else ("steps", "return_mean")
        for name, table in tables.items():
            points = table.drop_nulls(y)
            axes.plot(points[x], points[y], label=name.replace("_", " "), linewidth=1.2)
        axes.set(title=title, xlabel=x, ylabel=y.removesuffix("_mean"))
        axes.xaxis.set_major_formatter(EngFormatter(sep=""))
        axes.spines[["top", "right"]].set_visible(False)
        axes.legend(frameon=False, fontsize=7, loc="center left", bbox_to_anchor=(1.0, 0.5))
    return figure
