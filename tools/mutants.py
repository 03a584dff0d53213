"""How well traffic models find faults, for `write_results.py mutants RUN`.

The run is one of suites/mutants.yaml or suites/mutants-roads.yaml. Writes the tables of
docs/mutants.md, which says what the numbers are, and the severity of every driver in every traffic
model to a CSV file with the name of the suite in `docs/results`.
"""

import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl
from mutant_measures import Driven, found, ordered, per_1000_km, sizes_found
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
LADDERS = ("Headway", "Delay", "Blind spot", "Imposed braking", "Gap acceptance")
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
    whole, parts = [], []
    for traffic, driven in traffics.items():
        rng = np.random.default_rng(731_550_000)
        columns, early = ordered(driven, [*ladders.values()], rng)
        is_found = found(driven.severity)
        whole.append(
            {
                "traffic model": traffic,
                **columns[-1],
                "faults found, of 16": f"{is_found.sum()}",
                "avoidable collisions per 1,000 km": per_1000_km(driven, searched[traffic], rng),
                "τ with the first 3 s": early,
                "likeness": likeness.get(traffic, "–"),
            }
        )
        for i, (ladder, members) in enumerate(ladders.items()):
            row = {"fault": ladder, "traffic model": traffic, **columns[i]}
            parts.append({**row, "sizes found": sizes_found(is_found, members)})
    parts.sort(key=lambda row: list(ladders).index(row["fault"]))
    return _table(whole, 1), _table(parts, 2)


def on_roads(
    driven: Mapping[tuple[str, str], Driven], ladders: Mapping[str, Sequence[int]]
) -> Table:
    """The table of the traffic models on each road, and on all roads together.

    Episodes with the same seed on all roads are one there.
    """
    every = dict(driven)
    for traffic in dict.fromkeys(traffic for _, traffic in driven):
        parts = [each for (_, model), each in driven.items() if model == traffic]
        severity, start, km, collided = (np.stack(each) for each in zip(*parts, strict=True))
        means = severity.mean(axis=0), start.mean(axis=0)
        every["all", traffic] = Driven(*means, km.sum(axis=0), collided.any(axis=0))
    rows = []
    for (road, traffic), each in every.items():
        rng = np.random.default_rng(732_550_000)
        columns, _ = ordered(each, [*ladders.values()], rng)
        is_found = found(each.severity)
        of_ladders = {
            name.lower(): sizes_found(is_found, members) for name, members in ladders.items()
        }
        whole = {**columns[-1], "faults found, of 16": f"{is_found.sum()}"}
        rows.append({"road": road, "traffic model": traffic, **whole, **of_ladders})
    return _table(rows, 2)


def _table(records: Sequence[dict[str, Any]], keys: int) -> Table:
    names = list(records[0])
    forms = {name: ",.0f" if "per" in name or "mean" in name else ".2f" for name in names[keys:]}
    return Table.plain(records, tuple(names[:keys]), forms)


def write(folder: Path) -> None:
    """Writes the tables and the severities."""
    run = open_finished(folder)
    egos = [ego.title for ego in run.suite.egos]
    every = {name: [k for k, ego in enumerate(egos) if ego.startswith(name)] for name in LADDERS}
    ladders = {name: [0, *members] for name, members in every.items() if members}
    cells: dict[tuple[str, str], list[int]] = {}
    for place, each in enumerate(run.suite.cells):
        road = each.road.title if each.road else ""
        cells.setdefault((road, each.traffic.title), []).append(place)
    driven = {key: of_traffic(run, places) for key, places in cells.items()}
    rows: list[dict[str, Any]] = []
    for (road, title), each in driven.items():
        marks: Ints = np.array([0, *found(each.severity)], dtype=np.int64)
        error = each.severity.std(axis=0, ddof=1) / np.sqrt(len(each.severity))
        rows += [
            {
                **({"road": road} if road else {}),
                "traffic": title,
                "ego": ego,
                "severity": each.severity[:, k].mean(),
                "standard_error": error[k],
                "severity_from_the_start": each.from_the_start[:, k].mean(),
                "collisions": int(each.collided[:, k].sum()),
                "distance_km": each.distance_km[:, k].sum(),
                "found": int(marks[k]),
            }
            for k, ego in enumerate(egos)
        ]
    frame = pl.DataFrame(rows).with_columns(pl.selectors.float().round_sig_figs(6))
    frame.write_csv(RESULTS / f"{run.suite.suite}.csv")
    if run.suite.roads:
        keep("mutants-roads", markdown(on_roads(driven, ladders)))
        return
    searched = {title: avoidable(run, places) for (_, title), places in cells.items()}
    for title, counts in searched.items():
        print(title, "collisions searched, avoidable:", counts.sum(axis=0))
    likeness = dict(TOTAL.findall(table_named("likeness-i24")))
    traffics = {title: each for (_, title), each in driven.items()}
    whole, parts = summary(traffics, searched, ladders, likeness)
    keep("mutants", markdown(whole))
    keep("mutants-ladders", markdown(parts))
