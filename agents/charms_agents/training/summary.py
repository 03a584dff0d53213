"""The table `stages.csv` of all finished stages, with their times and results."""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import polars as pl

from charms_agents.training.job import StageFolder
from charms_bench.report.training_tables import ColumnsFile, CurveColumn, StageColumn
from charms_bench.world.files import write_bytes

SCHEMA = pl.Schema(
    {
        "stage": pl.String(),
        "style": pl.String(),
        "steps": pl.Int64(),  # decisions; null for stages that learn from human driving
        "wall_s": pl.Float64(),
        "steps_per_s": pl.Float64(),
        "return": pl.Float64(),  # of the learning curve's last point, exploring
        "crashed": pl.Float64(),  # share of episodes there
        "agreement_before": pl.Float64(),  # with held-out human decisions
        "agreement": pl.Float64(),
        "log_likelihood_before": pl.Float64(),  # of held-out human decisions
        "log_likelihood": pl.Float64(),
    }
)
COLUMNS = ColumnsFile(
    stages={
        "style": StageColumn(definition="weights of the reward, and the social value orientation"),
        "steps": StageColumn(definition="decisions that the stage was trained on", form=",.0f"),
        "wall_s": StageColumn(unit="s", definition="duration of the stage", form=",.1f"),
        "steps_per_s": StageColumn(
            unit="1/s", definition="decisions per second, learning included", form=",.0f"
        ),
        "return": StageColumn(
            definition="mean return of an episode at the last point of the learning curve, while "
            "exploring",
            form=".1f",
        ),
        "crashed": StageColumn(
            definition="share of episodes that ended in a crash at that point", form=".1%"
        ),
        "agreement_before": StageColumn(
            definition="share of held-out human decisions that the network also takes, before it "
            "learns from human driving",
            form=".1%",
        ),
        "agreement": StageColumn(definition="the same share afterwards", form=".1%"),
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
        "crashed_share": CurveColumn(over="steps", title="share of episodes crashed", form=".1%"),
        "loss": CurveColumn(over="epoch", title="loss"),
        "agreement": CurveColumn(
            over="epoch", title="agreement with held-out human decisions", form=".1%"
        ),
    },
)
"""Meaning, unit and format of the columns of `stages.csv` and `curves.csv`."""


def write_summary(output: Path, folders: Mapping[str, StageFolder]) -> pl.DataFrame:
    """Writes `stages.csv`, one row per stage, and `columns.json`; returns the stages."""
    rows = [_row(name, folder) for name, folder in folders.items()]
    table = pl.DataFrame(rows, schema=SCHEMA)
    columns = COLUMNS.model_dump_json(indent=2, exclude_defaults=True)
    for name, text in (("stages.csv", table.write_csv()), ("columns.json", columns)):
        path = output / name
        if not path.exists() or path.read_text(encoding="utf-8") != text:
            write_bytes(path, text.encode())
    return table


def _row(name: str, folder: StageFolder) -> dict[str, Any]:
    made = json.loads(folder.manifest.read_text(encoding="utf-8"))
    row = {"stage": name, "wall_s": made["wall_s"]}
    if "supervised" in made:
        before, after = made["before"], made["after"]
        return row | {
            "style": made["style"],
            "agreement_before": before["agreement"],
            "agreement": after["agreement"],
            "log_likelihood_before": before["log_likelihood"],
            "log_likelihood": after["log_likelihood"],
        }
    last = made["curve"].get("last", {})
    return row | {
        "style": f"{made['style']['weights']['name']}, {made['style']['svo']}",
        "steps": made["steps"],
        "steps_per_s": made["steps_per_s"],
        "return": last.get("return_mean"),
        "crashed": last.get("crashed_share"),
    }
