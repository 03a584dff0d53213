"""How well traffic models find faults, for `write_results.py mutants RUN` of suites/mutants.yaml.

Writes the tables of docs/mutants.md, which says what the numbers are, and the severity of every
driver in every traffic model to `docs/results/mutants.csv`.
"""

import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl
from mutant_measures import (
    Driven,
    distance,
    episodes_until_ordered,
    found,
    of_resamples,
    per_1000_km,
    resampled_means,
    taus,
)
from result_pages import RESULTS, ROOT, keep, table_named

from charms_bench.episodes.avoidability import avoidability, collisions
from charms_bench.episodes.criticality import COLLISION, criticality
from charms_bench.episodes.recorded_cell import RecordedCell
from charms_bench.report.markdown import markdown
from charms_bench.report.table import Table
from charms_bench.runs.finished_run import FinishedRun, open_finished
from charms_bench.world.scene import Floats, Ints

SINCE_S = 3.0
SEARCHED = 40
"""Collisions of each traffic model whose avoidability is searched."""
LADDERS = ("Headway", "Delay", "Blind spot", "Imposed braking")
"""The drivers of a ladder have labels that begin so, from the smallest fault to the largest."""
TOTAL = re.compile(r"^\| (.+?) \| traffic \|.*\| (\S+ \[.+?\]) \|$", re.MULTILINE)


def of_traffic(run: FinishedRun, cells: Sequence[int]) -> Driven:
    """What the drivers of some cells did; all have driven the same episodes."""
    return Driven(*np.stack([_of_cell(run, cell) for cell in cells], axis=-1))


def _of_cell(run: FinishedRun, index: int) -> Floats:
    """[4, E]."""
    scene = run.suite.scene
    since = round(SINCE_S * scene.decision_hz) + 1
    frames = []
    for episodes, steps in run.cell(index).parts:
        late = steps.filter(pl.col("episode").is_in(steps.filter(step=since)["episode"].implode()))
        heads = episodes.filter(pl.col("episode").is_in(late["episode"].implode()))
        frame = episodes.select("episode", "ending", km=pl.col("distance_m") / 1000)
        severity = criticality(heads, late, scene, since)
        from_the_start = criticality(episodes, steps, scene)
        for measured in (
            severity.select("episode", severity="criticality"),
            from_the_start.select("episode", from_the_start="criticality"),
        ):
            frame = frame.join(measured, on="episode", how="left")
        frames.append(frame)
    columns = (
        pl.concat(frames)
        .sort("episode")
        .select(
            pl.col("severity").fill_null(COLLISION),
            "from_the_start",
            "km",
            pl.col("ending").is_in(["rear_end", "side"]).cast(pl.Float64),
        )
    )
    return columns.to_numpy().T


def avoidable(run: FinishedRun, cells: Sequence[int]) -> Floats:
    """[E, 2] by episode: the collisions that were searched, and how many of them are avoidable."""
    first, size = run.suite.seed, run.suite.episodes
    recorded = [RecordedCell(run, cell, ROOT / "suites") for cell in cells]
    every = sorted(
        (seed, place) for place, each in enumerate(recorded) for seed in collisions(each)
    )[:SEARCHED]
    counts = np.zeros((size, 2))
    for place, cell in enumerate(recorded):
        seeds = [seed for seed, at in every if at == place]
        for each in avoidability(cell, seeds, agents=()):
            counts[each.episode - first] += 1, each.verdict == "avoidable"
    return counts


def summary(
    traffics: Mapping[str, Driven],
    searched: Mapping[str, Floats],
    ladders: Mapping[str, Sequence[int]],
    likeness: Mapping[str, str],
) -> tuple[Table, Table]:
    """The table of traffic models, and that of the ladders of each."""
    places = list(ladders.values())
    whole, parts = [], []
    for traffic, driven in traffics.items():
        rng = np.random.default_rng(731_550_000)
        severity, size = driven.severity, len(driven.severity)
        tau = taus(severity.mean(axis=0), places)
        spread = taus(resampled_means(severity, rng), places)
        early = taus(driven.from_the_start.mean(axis=0), places)
        early_spread = taus(resampled_means(driven.from_the_start, rng), places)
        needed = episodes_until_ordered(severity, places, rng)
        again = np.array(
            [
                episodes_until_ordered(severity[rng.integers(size, size=size)], places, rng)
                for _ in range(100)
            ]
        )
        km, is_found = float(driven.distance_km.mean()), found(severity)
        columns: list[dict[str, Any]] = [
            {
                "τ": of_resamples(float(tau[i]), spread[:, i]),
                "km until τ ≥ 0.9": distance(float(needed[i]), again[:, i], km, size),
            }
            for i in range(len(places) + 1)
        ]
        whole.append(
            {
                "traffic model": traffic,
                **columns[-1],
                "faults found, of 16": f"{is_found.sum()}",
                "avoidable collisions per 1,000 km": per_1000_km(driven, searched[traffic], rng),
                "τ with the first 3 s": of_resamples(float(early[-1]), early_spread[:, -1]),
                "likeness": likeness.get(traffic, "–"),
            }
        )
        for i, (ladder, members) in enumerate(ladders.items()):
            sizes = ", ".join(str(k) for k in range(1, 5) if is_found[members[k] - 1])
            row = {"fault": ladder, "traffic model": traffic, **columns[i]}
            parts.append({**row, "sizes found": sizes or "none"})
    parts.sort(key=lambda row: list(ladders).index(row["fault"]))
    return _table(whole, 1), _table(parts, 2)


def _table(records: Sequence[dict[str, Any]], keys: int) -> Table:
    names = list(records[0])
    forms = {name: ",.0f" if "per" in name or "mean" in name else ".2f" for name in names[keys:]}
    return Table.plain(records, tuple(names[:keys]), forms)


def write(folder: Path) -> None:
    """Writes the tables and the severities."""
    run = open_finished(folder)
    egos = [ego.title for ego in run.suite.egos]
    ladders = {
        name: [0, *(k for k, ego in enumerate(egos) if ego.startswith(name))] for name in LADDERS
    }
    cells: dict[str, list[int]] = {}
    for place, each in enumerate(run.suite.cells):
        cells.setdefault(each.traffic.title, []).append(place)
    traffics = {title: of_traffic(run, places) for title, places in cells.items()}
    searched = {title: avoidable(run, places) for title, places in cells.items()}
    rows: list[dict[str, Any]] = []
    for title, driven in traffics.items():
        marks: Ints = np.array([0, *found(driven.severity)], dtype=np.int64)
        error = driven.severity.std(axis=0, ddof=1) / np.sqrt(len(driven.severity))
        rows += [
            {
                "traffic": title,
                "ego": ego,
                "severity": driven.severity[:, k].mean(),
                "standard_error": error[k],
                "severity_from_the_start": driven.from_the_start[:, k].mean(),
                "collisions": int(driven.collided[:, k].sum()),
                "distance_km": driven.distance_km[:, k].sum(),
                "found": int(marks[k]),
            }
            for k, ego in enumerate(egos)
        ]
    frame = pl.DataFrame(rows).with_columns(pl.selectors.float().round_sig_figs(6))
    frame.write_csv(RESULTS / "mutants.csv")
    for title, counts in searched.items():
        print(title, "collisions searched, avoidable:", counts.sum(axis=0))
    likeness = dict(TOTAL.findall(table_named("likeness-i24")))
    whole, parts = summary(traffics, searched, ladders, likeness)
    keep("mutants", markdown(whole))
    keep("mutants-ladders", markdown(parts))
