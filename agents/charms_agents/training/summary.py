"""All finished stages in a table: how long each took, and what came of it."""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import polars as pl

from charms_agents.training.job import StageFolder
from charms_bench.world.files import write_atomically

SCHEMA = pl.Schema(
    {
        "stage": pl.String(),
        "style": pl.String(),
        "steps": pl.Int64(),  # decisions; null for what learns from human driving
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


def write_summary(output: Path, folders: Mapping[str, StageFolder]) -> pl.DataFrame:
    """Writes `stages.csv` into the run folder, a row a stage, and returns it."""
    rows = [_row(name, folder) for name, folder in folders.items()]
    table = pl.DataFrame(rows, schema=SCHEMA)
    path, text = output / "stages.csv", table.write_csv()
    if not path.exists() or path.read_text(encoding="utf-8") != text:
        write_atomically(path, lambda partial: partial.write_text(text, encoding="utf-8"))
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
