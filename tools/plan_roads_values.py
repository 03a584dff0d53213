"""What the networks of docs/training-plan-roads.md do, by test, road, traffic and seed."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import plan_roads as plan
import polars as pl
from result_pages import RESULTS
from scipy import special

from charms_bench.errors import RunFolderError
from charms_bench.metrics.collisions import AT_FAULT, ENDED_BADLY, ENDING
from charms_bench.report.markdown import markdown
from charms_bench.report.number import Number
from charms_bench.report.table import Table
from charms_bench.runs.finished_run import open_finished
from charms_bench.statistics.intervals import CONFIDENCE
from charms_bench.world.scene import Floats


def values_of(runs: Path, test: str) -> pl.DataFrame:
    """The values of a test, one row per road, traffic and network; none if it is not driven.

    Crashes of which the rule of fault says nothing count as at fault, and where the ego does not
    reach the goal, its time is the duration.
    """
    try:
        run = open_finished(runs / test)
    except RunFolderError as error:
        print(f"{test}: left out: {error}")
        return pl.DataFrame()
    records = []
    for index in run.finished:
        cell, limit_s = run.cell(index), run.suite.cells[index].scene.duration_s
        ego, _, seed = cell.agent.partition(plan.SEED)
        time = pl.when(ENDING == "goal").then(pl.first("duration_s")).otherwise(limit_s)
        found = {
            "reached": ENDING == "goal",
            "at_fault": ENDED_BADLY & AT_FAULT.fill_null(value=True),
            "crashed": ENDED_BADLY,
            "time_s": time,
            "wrecks": pl.first("traffic_crashed") > 0,
            "imposed_mps2": pl.first("entry_braking_mps2"),
            "lag_gap_m": pl.first("entry_lag_gap_m"),
            "pet_s": pl.first("entry_pet_s"),
        }
        values = cell.episodes.group_by("episode").agg(**found).select(pl.col(*found).mean())
        drivers = pl.concat(part for (part,) in cell.drivers).filter("is_ego")
        per_1000km = drivers["conflicts_by"].sum() / drivers["distance_m"].sum() * 1e6
        known: dict[str, Any] = {"test": test, "road": cell.road, "traffic": cell.traffic}
        known |= {"ego": ego, "seed": int(seed) if seed else None, "conflicts": per_1000km}
        records.append(known | values.row(0, named=True))
    return pl.DataFrame(records, infer_schema_length=None)


def kept(name: str, found: pl.DataFrame, key: str) -> pl.DataFrame:
    """Writes the rows of a CSV file, beside those that it has of other seeds or keys."""
    path = RESULTS / f"{name}.csv"
    before = pl.read_csv(path) if path.exists() else found.clear()
    others = before.join(found, on=[key, "seed"], how="anti", nulls_equal=True)
    every = pl.concat([others, found.select(others.columns)], how="vertical_relaxed")
    every = every.sort([name for name, kind in every.schema.items() if kind != pl.Float64])
    every.write_csv(path)
    return every


def best_trial(runs: Path, test: str) -> int:
    """The "seed" of a test with the largest mean of goal reached minus at fault or undecided."""
    score = (pl.col("reached") - pl.col("at_fault")).mean()
    scores = values_of(runs, test).group_by("seed").agg(score=score)
    return int(scores.sort("score", -pl.col("seed"))["seed"][-1])


def trained(networks: Path) -> pl.DataFrame:
    """Each network of the plan, with its hash and CPU minutes."""
    records = []
    for seed in plan.seeds_of(networks):
        for path in sorted((networks / str(seed) / "networks").glob("*.json")):
            manifest = json.loads(path.read_text(encoding="utf-8"))
            minutes = round(manifest["cpu_s"] / 60, 2)
            found = {"network": path.stem, "seed": seed, "onnx_sha256": manifest["onnx_sha256"]}
            records.append(found | {"CPU minutes": minutes})
    return pl.DataFrame(records)


def mean_of(values: Floats, low: float = -np.inf, high: float = np.inf) -> Number:
    """The mean of seeds with its interval, if there are several, cut to what values can be."""
    n = len(values)
    if n < 2:
        return Number(float(values.mean()) if n else None, n=n)
    mean, t = values.mean(), special.stdtrit(n - 1, (1 + CONFIDENCE) / 2)
    margin = t * values.std(ddof=1) / np.sqrt(n)
    return Number(mean, max(mean - margin, low), min(mean + margin, high), n)


def rates_of_traffic(run: Path) -> pl.DataFrame:
    """How many vehicles of each traffic model collide, and leave their lane, per 1,000 km."""
    finished, records = open_finished(run), []
    collides = pl.sum_horizontal("rear_end_striking", "rear_end_struck", "side").sum()
    for cell in map(finished.cell, finished.finished):
        rows = pl.concat(part for (part,) in cell.drivers).remove("is_ego")
        rate = 1e6 / rows["distance_m"].sum()
        collided, lost = rows.select(collides.alias("both"), pl.sum("crashed")).row(0)
        known = {"traffic": cell.traffic, "road": cell.road}
        records.append(known | {"collided": collided * rate, "left": (lost - collided) * rate})
    return pl.DataFrame(records)


def traffic_table(rates: pl.DataFrame) -> str:
    """A column for each road: vehicles that collide / that leave their lane, per 1,000 km."""
    text = pl.concat_str(pl.col("collided", "left").round().cast(int), separator=" / ")
    wide = rates.with_columns(text=text).pivot("road", index="traffic", values="text")
    return markdown(Table.plain(wide.to_dicts(), ("traffic",), dict.fromkeys(wide.columns[1:], "")))
