"""What a training writes about its stages: tables, and a figure like the paper's Fig. 3."""

import json
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import polars as pl
from matplotlib.figure import Figure
from matplotlib.ticker import EngFormatter

from charms_agents.training.job import Job
from charms_agents.training.settings import TrainingSuite
from charms_bench.foundation.files import write_bytes
from charms_bench.report.figures.drawing import panels, save
from charms_bench.report.training_tables import ColumnsFile, CurveColumn, StageColumn

COLUMNS = ColumnsFile(
    stages={
        "style": StageColumn(definition="weights of the reward, and the social value orientation"),
        "steps": StageColumn(definition="decisions that the stage was trained on", form=",.0f"),
        "wall_s": StageColumn(unit="s", definition="duration of the stage", form=",.1f"),
        "cpu_s": StageColumn(unit="s", definition="processor time of the stage", form=",.1f"),
        "steps_per_s": StageColumn(
            unit="1/s", definition="decisions per second, learning included", form=",.0f"
        ),
        "return": StageColumn(
            definition="mean return of an episode at the last point of the learning curve, while "
            "exploring",
            form=".1f",
        ),
        "crashed": StageColumn(
            definition="proportion of episodes that ended in a crash at that point", form=".1%"
        ),
        "agreement_before": StageColumn(
            definition="proportion of held-out human decisions that the network also takes, before "
            "it learns from human driving",
            form=".1%",
        ),
        "agreement": StageColumn(definition="the same proportion afterwards", form=".1%"),
        "log_likelihood_before": StageColumn(
            unit="nats",
            definition="mean log-likelihood of held-out human decisions, before the network learns "
            "from human driving",
            form=".3f",
        ),
        "log_likelihood": StageColumn(
            unit="nats", definition="the same log-likelihood afterwards", form=".3f"
        ),
    },
    curves={
        "return_mean": CurveColumn(over="steps", title="return of an episode"),
        "crashed_share": CurveColumn(
            over="steps", title="proportion of episodes crashed", form=".1%"
        ),
        "loss": CurveColumn(over="epoch", title="loss"),
        "agreement": CurveColumn(
            over="epoch", title="agreement with held-out human decisions", form=".1%"
        ),
    },
)
"""Meaning, unit and format of the columns of `stages.csv` and `curves.csv`."""
SCHEMA = pl.Schema(
    {"stage": pl.String(), **dict.fromkeys(COLUMNS.stages, pl.Float64())}
    | {"style": pl.String(), "steps": pl.Int64()}
)
"""The columns of `stages.csv`; those that do not apply to a stage are null."""


def write_summary(output: Path, jobs: Iterable[Job]) -> None:
    """Writes `stages.csv`, one row per stage, and `columns.json`."""
    table = pl.DataFrame([_row(job) for job in jobs], schema=SCHEMA)
    columns = COLUMNS.model_dump_json(indent=2, exclude_defaults=True)
    for name, text in (("stages.csv", table.write_csv()), ("columns.json", columns)):
        path = output / name
        if not path.exists() or path.read_text(encoding="utf-8") != text:
            write_bytes(path, text.encode())


def _row(job: Job) -> dict[str, Any]:
    made = json.loads(job.file(".json").read_text(encoding="utf-8"))
    row = {"stage": job.name, "wall_s": made["wall_s"], "cpu_s": made.get("cpu_s")}
    if "supervised" in made:
        names, points = ("agreement", "log_likelihood"), (("_before", "before"), ("", "after"))
        measured = {f"{name}{end}": made[when][name] for name in names for end, when in points}
        return row | {"style": made["style"], **measured}
    last = made["curve"].get("last", {})
    return row | {
        "style": job.style,
        "steps": made["steps"],
        "steps_per_s": made["steps_per_s"],
        "return": last.get("return_mean"),
        "crashed": last.get("crashed_share"),
    }


def write_curves(output: Path, suite: TrainingSuite, jobs: Mapping[str, Job]) -> None:
    """Writes `curves.csv`, one row per stage and point, and `curves.png` into the run folder.

    The figure has a panel for the returns of stages among installed agents, one for the returns of
    stages among other stages' networks, and one for the losses of learning from human driving.
    """
    tables = {
        name: pl.read_csv(job.file(".csv"), infer_schema_length=None) for name, job in jobs.items()
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
