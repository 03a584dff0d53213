"""What makes CHARMS for all roads work, by taking it away; see docs/training-plan-roads.md.

    python tools/roads_ablations.py FOLDER

Trains each variant of `suites/train-roads.yaml`, and DQN and PPO of Stable-Baselines3, with five
seeds and 300,000 steps, and drives them. What is finished in FOLDER is not done again.
`write_results.py roads-ablations FOLDER` writes the table.
"""

import copy
import json
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import plan_roads as plan
import polars as pl
import yaml
from plan_roads import SEED
from plan_roads_tables import LIMITS, ROUGH, percentage
from plan_roads_values import kept, mean_of, values_of
from result_pages import ROOT, keep

import charms_bench
from charms_bench.report.markdown import markdown
from charms_bench.report.table import Table

SEEDS = range(4050, 4055)
STEPS_OF_LEVEL_1, STEPS = 60_000, 300_000
"""The second are those of all stages together."""
Document = dict[str, Any]
COMPLETE, ONE_STYLE, PRIOR = "CHARMS", "one style", "the prior alone, Level-0"
TUNED = "IDM+MOBIL that gives way, tuned"
"""See `roads_tuned`."""
BASELINES = "DQN", "PPO"
"""What learns the style of `ONE_STYLE` in its place."""
QUANTITIES = {"reached": "goal reached", "at_fault": "at fault or undecided"}


def among_level_0(suite: Document) -> None:
    del suite["stages"]["level_1"]
    suite["stages"]["roads"] |= {"traffic": "yielding_human", "steps": STEPS}


def without_svo(suite: Document) -> None:
    styles = suite["stages"]["roads"]["styles"]
    for name in [name for name in styles if not name.endswith("_egoistic")]:
        del styles[name]


def without_prior(suite: Document) -> None:
    for stage in suite["stages"].values():
        del stage["prior"]
    del suite["human"]


def without_brake(suite: Document) -> None:
    suite["actions"].pop()


def one_style(suite: Document) -> None:
    styles = suite["stages"]["roads"]["styles"]
    for name in [*styles][1:]:
        del styles[name]


VARIANTS: dict[str, Callable[[Document], None]] = {
    COMPLETE: lambda suite: None,
    "among Level-0 drivers alone": among_level_0,
    "without SVO": without_svo,
    ONE_STYLE: one_style,
    "without the prior": without_prior,
    "without BRAKE": without_brake,
}


def networks_of(folder: Path, name: str, seed: int) -> Path:
    """Where the networks of a variant are."""
    return folder.resolve() / f"{name}{SEED}{seed}" / "networks"


def train(folder: Path) -> None:
    """Trains each variant and each other algorithm with each seed."""
    from roads_baselines import train_baseline  # needs the extra `train`

    text = (ROOT / "suites" / "train-roads.yaml").read_text(encoding="utf-8")
    for seed in SEEDS:
        for name, change in VARIANTS.items():
            suite = copy.deepcopy(yaml.safe_load(text)) | {"seed": seed}
            stages = suite["stages"]
            stages["level_1"]["steps"] = STEPS_OF_LEVEL_1
            stages["roads"]["steps"] = STEPS - STEPS_OF_LEVEL_1
            change(suite)
            file = folder / f"{name}.yaml"
            file.write_text(yaml.safe_dump(suite, sort_keys=False), encoding="utf-8")
            charms_bench.train(file, folder / f"{name}{SEED}{seed}", workers=1)
            if name == ONE_STYLE:
                for algorithm in BASELINES:
                    networks = [networks_of(folder, each, seed) for each in (name, algorithm)]
                    train_baseline(file, algorithm, networks[0], networks[1] / "roads")


def finished(folder: Path) -> list[int]:
    """The seeds of which all networks are there."""
    names = (*VARIANTS, *BASELINES)
    return [
        seed
        for seed in SEEDS
        if all((networks_of(folder, name, seed) / "roads.json").exists() for name in names)
    ]


def drive(folder: Path) -> None:
    """Drives 300 episodes per road with each network, in the roads' own traffic."""
    egos: list[Document] = []
    for seed in finished(folder):
        people = {"onnx": str(networks_of(folder, COMPLETE, seed) / "people.onnx")}
        egos.append({"agent": people, "label": f"{PRIOR}{SEED}{seed}"})
        for name in (*VARIANTS, *BASELINES):
            agent = {"onnx": str(networks_of(folder, name, seed) / "roads.onnx")}
            if name in VARIANTS:
                agent["style"] = plan.STYLES[0]
            egos.append({"agent": agent, "label": f"{name}{SEED}{seed}"})
    run(folder, "ablations", {"egos": egos})


def run(folder: Path, name: str, own: Document) -> None:
    """Runs a suite on the four roads, by default 300 episodes from the first one of the test."""
    suite = {"suite": name, "seed": 990_000_000, "episodes": 300, **own}
    suite |= {"scene": {"duration_s": 45}, "roads": [*plan.THREE, plan.INTERSECTION]}
    file = folder / f"{name}.yaml"
    file.write_text(yaml.safe_dump(suite, sort_keys=False), encoding="utf-8")
    charms_bench.run(file, folder / name)


def trained(folder: Path) -> pl.DataFrame:
    """The network of each variant and seed, with its hash and CPU minutes."""
    records = []
    for seed in finished(folder):
        for name in (*VARIANTS, *BASELINES):
            files = sorted(networks_of(folder, name, seed).glob("*.json"))
            found = {path.stem: json.loads(path.read_text(encoding="utf-8")) for path in files}
            minutes = sum(each["cpu_s"] for each in found.values()) / 60
            own = {"variant": name, "seed": seed, "onnx_sha256": found["roads"]["onnx_sha256"]}
            records.append(own | {"CPU minutes": round(minutes, 2)})
    names = {"variant": pl.String, "seed": pl.Int64, "onnx_sha256": pl.String}
    return pl.DataFrame(records, names | {"CPU minutes": pl.Float64})


def differences(values: pl.DataFrame) -> str:
    """What each variant does, and its difference from CHARMS, paired by seed, in %."""
    records = []
    order = {name: k for k, name in enumerate((*VARIANTS, *BASELINES, TUNED, PRIOR))}
    roads = {name: k for k, name in enumerate(LIMITS)}
    place = pl.col("road").replace_strict(roads), pl.col("ego").replace_strict(order)
    for (road, ego), row in values.sort(*place).group_by("road", "ego", maintain_order=True):
        complete = values.filter(road=road, ego=COMPLETE).sort("seed")
        record = {"road": road, "variant": ego}
        for name, header in QUANTITIES.items():
            own = row.sort("seed")[name].to_numpy()
            if ego == COMPLETE:
                record[header] = percentage(mean_of(own, 0.0, 1.0), ".1f")
            else:
                change = mean_of(own - complete[name].to_numpy())
                record[header] = f"{100 * own.mean():.1f}"
                record[f"{header}, difference"] = percentage(change, "+.1f")
        records.append(record)
    columns = [name for header in QUANTITIES.values() for name in (header, f"{header}, difference")]
    every = [{**dict.fromkeys(columns, ""), **record} for record in records]
    return markdown(Table.plain(every, ("road", "variant"), dict.fromkeys(columns, "")))


def tables(folder: Path) -> None:
    """Writes what the networks do; what is not in the folder keeps its rows."""
    rough = pl.selectors.float().round_sig_figs(4)
    found = values_of(folder, "ablations").drop("test", "traffic")
    driven = found.with_columns(rough).with_columns(ROUGH)
    wide = driven.pivot("road", index=["ego", "seed"], values=[*QUANTITIES, "time_s"])
    networks = trained(folder).rename({"variant": "ego"})
    wide = wide.join(networks, on=["ego", "seed"], how="left")
    every = kept("plan-roads-ablations", wide, "ego").sort("ego", "seed")
    by_road = [
        every.select("ego", "seed", pl.lit(road).alias("road"),
                     *(pl.col(f"{name}_{road}").alias(name) for name in QUANTITIES))
        for road in LIMITS
    ]  # fmt: skip
    keep("plan-roads-ablations", differences(pl.concat(by_road)))


if __name__ == "__main__":
    if len(sys.argv) != 2:
        sys.exit("usage: python tools/roads_ablations.py FOLDER")
    where = Path(sys.argv[1])
    where.mkdir(parents=True, exist_ok=True)
    train(where)
    drive(where)
