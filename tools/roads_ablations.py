"""What makes CHARMS for all roads work, by taking it away; see docs/training-plan-roads.md.

    python tools/roads_ablations.py FOLDER [PART ...]

Trains each variant of `suites/train-roads-self-play.yaml` with five seeds, gives DQN and PPO of
Stable-Baselines3 as many trials as IDM+MOBIL, trains the best with the same seeds, and drives all
of them. A part is a seed, whose variants are trained, or DQN or PPO, so that several processes can
train; without parts, all is done. What is finished in FOLDER is not done again.
`write_results.py roads-ablations FOLDER` writes the table.
"""

import json
import sys
from pathlib import Path

import plan_roads as plan
import polars as pl
import yaml
from plan_roads import SEED
from plan_roads_tables import LIMITS, ROUGH, percentage
from plan_roads_values import best_trial, kept, mean_of, rates_of_traffic, values_of
from result_pages import keep
from roads_variants import COMPLETE, ONE_STYLE, STEPS, STEPS_OF_LEVEL_1, VARIANTS, Document, written

import charms_bench
from charms_bench.report.markdown import markdown
from charms_bench.report.table import Table

SEEDS, TRIAL_SEED, TRIALS, STEPS_OF_TRIALS = range(4070, 4075), 4010, 26, 240_640
PRIOR = "the prior alone, Level-0"
TUNED = "IDM+MOBIL that gives way, tuned"
"""See `roads_tuned`."""
BASELINES = "DQN", "PPO"
"""What learns the style of `ONE_STYLE` in its place."""
AS_TRAFFIC = "ablations-as-traffic"
QUANTITIES = {"reached": "goal reached", "at_fault": "at fault or undecided"}


def networks_of(folder: Path, name: str, seed: int) -> Path:
    """Where the networks of a variant are."""
    return folder.resolve() / f"{name}{SEED}{seed}" / "networks"


def train(folder: Path, part: str) -> None:
    """Trains each variant with a seed, or the best trial of another algorithm with each seed."""
    from roads_baselines import train_baseline  # needs the extra `train`

    if part not in BASELINES:
        for name in VARIANTS:
            file = written(folder, name, int(part))
            charms_bench.train(file, folder / f"{name}{SEED}{part}", workers=1)
        return
    best = chosen_trial(folder, part)
    for seed in SEEDS:
        among, own = (networks_of(folder, each, seed) for each in (ONE_STYLE, part))
        steps = STEPS - STEPS_OF_LEVEL_1
        file = written(folder, ONE_STYLE, seed)
        train_baseline(file, part, best, steps, among, own / "roads")


def chosen_trial(folder: Path, algorithm: str) -> int:
    """The trial with the largest mean of goal reached minus at fault or undecided."""
    from roads_baselines import train_baseline  # needs the extra `train`

    file, egos = written(folder, ONE_STYLE, TRIAL_SEED), list[Document]()
    charms_bench.train(file, folder / f"{ONE_STYLE}{SEED}{TRIAL_SEED}", workers=1, only="level_1")
    among = networks_of(folder, ONE_STYLE, TRIAL_SEED)
    for trial in range(TRIALS):
        network = folder / "trials" / f"{algorithm}-{trial}"
        train_baseline(file, algorithm, trial, STEPS_OF_TRIALS, among, network)
        agent = {"onnx": str(network.with_suffix(".onnx").resolve())}
        egos.append({"agent": agent, "label": f"{algorithm}{SEED}{trial}"})
    run(folder, f"trials-{algorithm}", {"egos": egos, "seed": 931_000_000})
    return best_trial(folder, f"trials-{algorithm}")


def finished(folder: Path) -> list[int]:
    """The seeds of which all networks are there."""
    names = (*VARIANTS, *BASELINES)
    return [
        seed
        for seed in SEEDS
        if all((networks_of(folder, name, seed) / "roads.json").exists() for name in names)
    ]


def drive(folder: Path) -> None:
    """Drives 300 episodes per road with each network, and 150 among each as the traffic."""
    egos, traffics = list[Document](), list[Document]()
    for seed in finished(folder):
        people = {"onnx": str(networks_of(folder, COMPLETE, seed) / "people.onnx")}
        egos.append({"agent": people, "label": f"{PRIOR}{SEED}{seed}"})
        for name in (*VARIANTS, *BASELINES):
            agent = {"onnx": str(networks_of(folder, name, seed) / "roads.onnx")}
            if name in VARIANTS:
                agent["style"] = plan.STYLES[0]
            label = f"{name}{SEED}{seed}"
            egos.append({"agent": agent, "label": label})
            traffics.append({"traffic": {"onnx": agent["onnx"]}, "label": label})
    run(folder, "ablations", {"egos": egos})
    among = {"egos": ["yielding_human"], "traffic_models": traffics, "episodes": 150}
    run(folder, AS_TRAFFIC, {**among, "roads": plan.THREE})


def run(folder: Path, name: str, own: Document) -> None:
    """Runs a suite on the four roads, by default 300 episodes from the first one of the test."""
    roads = [*plan.THREE, plan.INTERSECTION]
    suite = {"suite": name, "seed": 991_000_000, "episodes": 300, "roads": roads, **own}
    suite |= {"scene": {"duration_s": 45}}
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


def collisions(folder: Path) -> str:
    """How many vehicles of each variant collide as traffic, per 1,000 km, by road."""
    label = pl.col("traffic").str.split_exact(SEED, 1).struct
    rates = rates_of_traffic(folder / AS_TRAFFIC).with_columns(
        label[0].alias("variant"), label[1].alias("seed")
    )
    records = dict[str, dict[str, object]]()
    for (variant, road), row in rates.group_by("variant", "road", maintain_order=True):
        own = row.sort("seed")["collided"].to_numpy()
        base = rates.filter(variant=COMPLETE, road=road).sort("seed")["collided"].to_numpy()
        change = mean_of(own - base)
        text = f"{own.mean():.0f}"
        if variant != COMPLETE:
            text += f" ({change.value:+.0f} [{change.low:+.0f}, {change.high:+.0f}])"
        records.setdefault(str(variant), {"variant": variant})[str(road)] = text
    every = [*records.values()]
    return markdown(Table.plain(every, ("variant",), dict.fromkeys(plan.THREE, "")))


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
    if (folder / AS_TRAFFIC).is_dir():
        keep("plan-roads-ablations-traffic", collisions(folder))


if __name__ == "__main__":
    if len(sys.argv) < 2:
        sys.exit("usage: python tools/roads_ablations.py FOLDER [PART ...]")
    where = Path(sys.argv[1])
    where.mkdir(parents=True, exist_ok=True)
    for each in sys.argv[2:] or (*map(str, SEEDS), *BASELINES):
        train(where, each)
    if not sys.argv[2:]:
        drive(where)
