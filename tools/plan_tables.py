"""The tables of the plan, for `write_results.py plan NETWORKS RUNS [NAME ...]`.

NETWORKS and RUNS are the folders of `tools/plan.py`. `docs/results` gets `plan-NAME.md` for each
table, and CSV files of the trainings. What RUNS does not hold is left out and named.
"""

import json
from collections.abc import Callable, Sequence
from itertools import count
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl
from plan import ABLATIONS, ALGORITHMS, EGO, SEEDS
from plan_criteria import CHARMS, CONDITIONS, CONFLICTS, RULE, Frames, limits_of
from plan_seeds import OVER, SEED, Columns, Worst, furthest, mean_of, of_seeds, summary
from plan_styles import (
    PCH,
    STYLE_TRAFFIC,
    plan_pch,
    plan_styles,
    styles_frame,
    told_frame,
)
from plan_verdicts import criteria_table, judged, trials_table
from result_pages import RESULTS

from charms_bench.errors import RunFolderError
from charms_bench.report.markdown import markdown
from charms_bench.report.number import Number
from charms_bench.report.preventable_table import crashed
from charms_bench.report.table import Table
from charms_bench.runs.finished_run import FinishedRun, open_finished


def _outside(metric: str) -> Worst:
    return furthest(*limits_of(metric))


DRIVING: Columns = {
    "crashed_at_fault": ("crashed at fault", ".2%", max),
    "crashed_episodes": ("crashed", ".2%", max),
    "speed_mean": ("speed, m/s", ".2f", min),
    "lane_changes_per_km": ("lane changes per km", ".2f", _outside("lane_changes_per_km")),
    "lane_changes_undone": ("undone", ".0%", max),
    "mean_acceleration_std": ("acceleration std, m/s²", ".2f", _outside("mean_acceleration_std")),
    "strong_acceleration_rate": ("above 1.1 m/s²", ".1%", max),
    "acceleration_reversals_per_min": (
        "reversals per minute",
        ".1f",
        _outside("acceleration_reversals_per_min"),
    ),
    "centre_headway_below_1s": ("headway < 1 s", ".1%", _outside("centre_headway_below_1s")),
    CONFLICTS: ("conflicts caused per 1,000 km", ".1f", max),
}
SURVIVORS = {
    "idm_mobil": [RULE],
    "careful": ["Careful until clear", "Careful to standstill"],
    "any": [RULE, "Careful until clear", "Careful to standstill"],
}
"""The egos; one of them has to survive a scenario. By column of `SCENARIOS`."""
SCENARIOS: Columns = {
    "crashed": ("crashed", ".2%", max),
    "at_fault": ("crashed at fault", ".2%", max),
    "idm_mobil": ("crashed where IDM+MOBIL survives", ".2%", max),
    "careful": ("crashed where a careful driver survives", ".2%", max),
    "any": ("crashed where any of them survives", ".2%", max),
}
HAZARDS = {name: SCENARIOS[name] for name in ("crashed", "at_fault", "idm_mobil")}
SCORES = ("closed_loop", "given_scene", "events", "total")
"""Of likeness; the total is the lowest of the others."""
KEPT = {"trainings", "curves"}
"""The values that pages link to."""
CURVE_BYTES = 60_000
CURVE = ("steps", "return_mean", "crashed_share", "epoch", "log_likelihood", "agreement")
"""The columns of learning curves that are kept: of reinforcement, and of learning from humans."""
WORST = f"{CHARMS}, worst seed"


def scenarios(run: FinishedRun) -> pl.DataFrame:
    """How often each ego crashes in each kind of scenario, and where the rules do not.

    All egos meet the same concrete scenarios, without those in which prescribed vehicles collide.
    """
    cells = run.cells()
    has_crashed = {(each.agent, each.traffic): crashed(each) for each in cells}
    records: list[dict[str, Any]] = []
    for cell in cells:
        ego, _, seed = cell.agent.partition(SEED)
        mine = has_crashed[cell.agent, cell.traffic]
        record: dict[str, Any] = {"scenario": cell.traffic, "ego": ego}
        record |= {"seed": int(seed) if seed else None}
        record |= {"scenarios": cell.size, "left_out": cell.left_out, "crashed": mine.mean()}
        record["at_fault"] = cell.episodes["at_fault"].fill_null(False).mean()
        for column, rules in SURVIVORS.items():
            of_rules = [has_crashed.get((rule, cell.traffic)) for rule in rules]
            survived = [~each for each in of_rules if each is not None]
            record[column] = (mine & np.any(survived, axis=0)).mean() if survived else None
        records.append(record)
    return pl.DataFrame(records, infer_schema_length=None).with_columns(
        pl.selectors.float().round_sig_figs(6)
    )


FRAMES: dict[str, tuple[tuple[str, ...], Callable[[FinishedRun], pl.DataFrame]]] = {
    "driving": (tuple(CONDITIONS), lambda run: of_seeds(run, tuple(DRIVING))),
    "r157": (("sealed-r157",), scenarios),
    "hazards": (("sealed-hazards",), scenarios),
    "styles": (("styles",), styles_frame),
    "told": (("styles",), told_frame),
    "style-traffic": (("style-traffic",), lambda run: of_seeds(run, tuple(STYLE_TRAFFIC))),
    "pch": (("pch",), lambda run: of_seeds(run, tuple(PCH))),
    "trials": (("trials",), lambda run: of_seeds(run, tuple(DRIVING))),
}
"""The values of every cell and seed: the tests of `tools/plan.py` that they need, and how."""


def plan_main(frames: Frames) -> str:
    """The main test: every ego in both traffic models."""
    values = frames["driving"].filter(condition="main").sort("traffic", maintain_order=True)
    return summary(values, DRIVING, ("traffic", "ego", OVER)) if len(values) else ""


def plan_conditions(frames: Frames) -> str:
    """Crashes at fault and conflicts caused of the rules and CHARMS, in every condition."""
    values, tables = frames["driving"], []
    rules = dict.fromkeys(values.filter(pl.col("seed").is_null())["ego"])
    for metric in ("crashed_at_fault", CONFLICTS):
        header, form, _ = DRIVING[metric]
        records = []
        for (condition, traffic), part in values.group_by(
            "condition", "traffic", maintain_order=True
        ):
            label, _ = CONDITIONS[str(condition)]
            record: dict[str, Any] = {"condition": label, "traffic": traffic}
            record |= dict(part.select("ego", metric).iter_rows())
            found = part.filter(ego=CHARMS)[metric].to_numpy()
            record |= {CHARMS: mean_of(found, 0.0), WORST: found.max() if found.size else None}
            records.append(record)
        forms = dict.fromkeys([*rules, CHARMS, WORST], form)
        table = markdown(Table.plain(records, ("condition", "traffic"), forms))
        tables.append(f"**{header[0].upper()}{header[1:]}**\n\n{table}")
    return "\n".join(tables)


def plan_scenarios(columns: Columns, values: pl.DataFrame) -> str:
    """The rules and CHARMS in each kind of scenario, and how many scenarios there are."""
    counts = values.group_by("scenario", maintain_order=True).first()
    said = ", ".join(
        f"{kind} {size}" + f" (and {left_out} left out)" * bool(left_out)
        for kind, size, left_out in counts.select("scenario", "scenarios", "left_out").iter_rows()
    )
    by_scenario = pl.concat(values.partition_by("scenario", maintain_order=True))
    table = summary(by_scenario, columns, ("scenario", "ego", OVER))
    return (
        f"{table}\nConcrete scenarios: {said}. Left out are those in which prescribed vehicles "
        "collide with one another.\n"
    )


def plan_ablations(frames: Frames) -> str:
    """What each part of CHARMS changes in the main test: paired differences of the same seeds."""
    driving = frames["driving"].filter(pl.col("condition") == "main")
    egos = ["Before fine-tuning", *(str(each.__doc__)[:-1] for each in ABLATIONS.values())]
    records = []
    for (traffic, ego), without in driving.group_by("traffic", "ego", maintain_order=True):
        if ego not in egos:
            continue
        charms = driving.filter(ego=CHARMS, traffic=traffic)
        pairs = without.join(charms, on="seed", suffix=" of CHARMS")
        record: dict[str, Any] = {
            "traffic model": traffic,
            "ego": ego,
            "seeds": Number(pairs.height),
        }
        for metric, (header, _, _) in DRIVING.items():
            record[header] = mean_of((pairs[metric] - pairs[f"{metric} of CHARMS"]).to_numpy())
        records.append(record)
    forms = {"seeds": ".0f"} | {header: form for header, form, _ in DRIVING.values()}
    return markdown(Table.plain(records, ("traffic model", "ego"), forms))


def plan_likeness(frames: Frames) -> str:
    """The likeness to the drivers of two roads: means over the seeds, or intervals over drivers."""
    records = []
    for (road, ego), rows in frames["likeness"].group_by("road", "ego", maintain_order=True):
        record: dict[str, Any] = {"road": road, "driver": ego}
        record["seeds"] = Number(rows.height if rows.height > 1 else None)
        for score in SCORES:
            values = rows[score].drop_nulls().to_numpy()
            record[score.replace("_", " ")] = mean_of(values, high=1.0)
            if rows.height == 1:
                bounds = rows[f"{score} low"][0], rows[f"{score} high"][0]
                record[score.replace("_", " ")] = Number(rows[score][0], *bounds)
        worst = min(rows["total"].to_list()) if rows.height > 1 else None
        record["total, worst seed"] = Number(worst)
        records.append(record)
    forms = {"seeds": ".0f"} | {each.replace("_", " "): ".2f" for each in SCORES}
    forms["total, worst seed"] = ".2f"
    return markdown(Table.plain(records, ("road", "driver"), forms))


def likeness_scores(runs: Path) -> pl.DataFrame | None:
    """What `charms-bench likeness --half test --json` wrote into `likeness-i24.json`, ...-i75."""
    records: list[dict[str, Any]] = []
    for road in ("I-24", "I-75"):
        file = runs / f"likeness-{road.replace('-', '').lower()}.json"
        for each in json.loads(file.read_text(encoding="utf-8")) if file.exists() else ():
            ego, _, seed = each["label"].partition(SEED)
            if each["kind"] == "traffic":
                continue
            record = {"road": road, "ego": ego, "seed": int(seed) if seed else None}
            for score in SCORES:
                found = each["scores"].get(score) or {}
                names = (("value", score), ("low", f"{score} low"), ("high", f"{score} high"))
                record |= {name: found.get(part) for part, name in names}
            records.append(record)
    return pl.DataFrame(records, infer_schema_length=None) if records else None


def trainings(networks: Path) -> dict[str, pl.DataFrame]:
    """What the manifests say of the networks of the plan, and their learning curves."""
    records, curves = [], []
    for path in sorted(networks.glob("seed-*/*.json")):
        network, seed = path.stem, int(path.parent.name.removeprefix("seed-"))
        if seed not in SEEDS:
            continue
        manifest = json.loads(path.read_text(encoding="utf-8"))
        of_ego = network in ("people", "level_1", EGO.removeprefix("charms_"), EGO)
        is_named = network in (*ALGORITHMS, *ABLATIONS, "paper")
        stages = path.parent / "trainings" / network / "stages.csv"  # those before it, too
        cpu_s = pl.read_csv(stages)["cpu_s"].sum() if stages.exists() else manifest["cpu_s"]
        records.append(
            {
                "network": network,
                "seed": seed,
                "command": network if is_named else "ego" if of_ego else "styles",
                "onnx_sha256": manifest["onnx_sha256"],
                "CPU minutes": cpu_s / 60,
            }
        )
        labels = pl.lit(seed).alias("seed"), pl.lit(network).alias("network")
        curve = pl.read_csv(path.with_suffix(".csv"), infer_schema_length=None)
        curves.append(curve.select(*labels, *(each for each in CURVE if each in curve.columns)))
    if not records:
        return {}
    found = pl.DataFrame(records, infer_schema_length=None).with_columns(
        pl.col("CPU minutes").round(2)
    )
    return {"trainings": found, "curves": pl.concat(curves, how="diagonal_relaxed")}


def plan_trainings(frames: Frames) -> str:
    """How many seeds each network was trained with, by which command, and for how long."""
    found = (
        frames["trainings"]
        .group_by("network", "command")
        .agg(pl.col("seed").count().alias("seeds"), pl.col("CPU minutes").mean())
    )
    rows = found.sort("network").with_columns(pl.format("`{}`", "command").alias("command"))
    forms = {"seeds": ".0f", "CPU minutes": ".1f"}
    return markdown(Table.plain(rows.to_dicts(), ("network", "command"), forms))


def thinned(curves: pl.DataFrame, most_bytes: int = CURVE_BYTES) -> pl.DataFrame:
    """The points of learning curves that fit into a CSV file: every second, third, ... and last."""
    left = (pl.len() - 1 - pl.int_range(pl.len())).over("seed", "network")
    rounded = curves.with_columns(pl.selectors.float().round_sig_figs(4))
    sizes = (rounded.filter(left % step == 0) for step in count(1))
    return next(each for each in sizes if len(each.write_csv()) <= most_bytes)


TABLES: dict[str, tuple[tuple[str, ...], Callable[[Frames], str]]] = {
    "main": (("driving",), plan_main),
    "ablations": (("driving",), plan_ablations),
    "conditions": (("driving",), plan_conditions),
    "likeness": (("likeness",), plan_likeness),
    "r157": (("r157",), lambda frames: plan_scenarios(SCENARIOS, frames["r157"])),
    "sealed-hazards": (("hazards",), lambda frames: plan_scenarios(HAZARDS, frames["hazards"])),
    "styles": (("styles", "told"), lambda frames: plan_styles(frames["styles"], frames["told"])),
    "style-traffic": (
        ("style-traffic",),
        lambda frames: summary(frames["style-traffic"], STYLE_TRAFFIC, ("traffic", OVER)),
    ),
    "pch": (("pch",), lambda frames: plan_pch(frames["pch"])),
    "trials": (("trials",), lambda frames: trials_table(frames["trials"])),
    "trainings": (("trainings", "curves"), plan_trainings),
    "criteria": (tuple(FRAMES), lambda frames: criteria_table(frames["criteria"])),
}
"""By name: the values that a table needs, and what makes it. `criteria` takes all that exist."""


def values_of(runs: Path, frame: str, missing: dict[str, str]) -> pl.DataFrame | None:
    """The values of the tests of a frame; notes the tests that are not in the folder."""
    tests, make = FRAMES[frame]
    found = []
    for test in tests:
        try:
            run = open_finished(runs / test)
        except RunFolderError as error:
            missing[test] = str(error)
            continue
        found.append(make(run).select(pl.lit(test).alias("condition"), pl.all()))
    return pl.concat(found, how="vertical_relaxed") if found else None


def write(networks: Path, runs: Path, *names: Path) -> None:
    """Writes the tables that the names say, by default all."""
    write_tables(networks, runs, RESULTS, [*map(str, names)] or list(TABLES))


def write_tables(networks: Path, runs: Path, output: Path, names: Sequence[str]) -> None:
    """Writes tables, and prints what is left out and why."""
    output.mkdir(parents=True, exist_ok=True)
    needed = dict.fromkeys(frame for name in names for frame in TABLES[name][0])
    frames = trainings(networks) if "trainings" in needed else {}
    if (scores := likeness_scores(runs)) is not None and "likeness" in needed:
        frames["likeness"] = scores
    missing: dict[str, str] = {}
    for frame in (each for each in needed if each in FRAMES):
        if (values := values_of(runs, frame, missing)) is not None:
            frames[frame] = values
    if "criteria" in names:
        frames["criteria"] = judged(frames)
    for frame in KEPT & frames.keys():
        kept = thinned(frames[frame]) if frame == "curves" else frames[frame]
        kept.write_csv(output / f"plan-{frame}.csv")
    for test, why in missing.items():
        print(f"{test}: left out: {why}")
    for name in names:
        needs, make = TABLES[name]
        text = make(frames) if name == "criteria" or frames.keys() >= set(needs) else ""
        tests = [test for frame in needs if frame in FRAMES for test in FRAMES[frame][0]]
        lacks = [test for test in dict.fromkeys(tests) if test in missing]
        if text and lacks and name in ("criteria", "conditions"):
            text += f"\nWithout the runs {', '.join(lacks)}.\n"
        if text:
            (output / f"plan-{name}.md").write_text(text, encoding="utf-8")
        print(f"plan-{name}.md: {'written' if text else 'left out'}")
