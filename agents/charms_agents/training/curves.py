"""The learning curves of all stages: a table, and a figure like the paper's Fig. 3."""

from collections.abc import Mapping
from pathlib import Path

import polars as pl
from matplotlib.figure import Figure
from matplotlib.ticker import EngFormatter

from charms_agents.training.job import StageFolder
from charms_agents.training.settings import TrainingSuite
from charms_bench.report.figures.drawing import panels, save
from charms_bench.world.files import write_bytes


def write_curves(output: Path, suite: TrainingSuite, folders: Mapping[str, StageFolder]) -> None:
    """Writes `curves.csv`, one row per stage and point, and `curves.png` into the run folder.

    The figure has a panel for the returns of stages among installed agents, one for the returns of
    stages among other stages' networks, and one for the losses of learning from human driving.
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
    write_bytes(csv, text.encode())
    titled: dict[str, dict[str, pl.DataFrame]] = {}
    for name, table in tables.items():
        titled.setdefault(_title(name, suite), {})[name] = table
    save(_figure({title: titled[title] for title in sorted(titled)}), png)


def _title(name: str, suite: TrainingSuite) -> str:
    if name in suite.human_stages:
        return "(c) learning from human driving"
    return "(b) among other stages' networks" if suite.needs[name] else "(a) among agents"


def _figure(titled: Mapping[str, Mapping[str, pl.DataFrame]]) -> Figure:
    figure, every = panels(len(titled), 5.6, 4.0)
    for axes, (title, tables) in zip(every, titled.items(), strict=True):
        x, y = ("epoch", "loss") if title.startswith("(c)") else ("steps", "return_mean")
        for name, table in tables.items():
            points = table.drop_nulls(y)
            axes.plot(points[x], points[y], label=name.replace("_", " "), linewidth=1.2)
        axes.set(title=title, xlabel=x, ylabel=y.removesuffix("_mean"))
        axes.xaxis.set_major_formatter(EngFormatter(sep=""))
        axes.legend(frameon=False, fontsize=7, loc="center left", bbox_to_anchor=(1.0, 0.5))
    return figure
