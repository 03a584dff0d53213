"""What the documentation says of runs: their commits, their episodes, training and reproduction."""

import json
from collections import Counter
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from textwrap import fill

import polars as pl
from reproduction import compared, side_by_side, with_verdicts
from result_pages import RESULTS, ROOT

from charms_bench import open_run
from charms_bench.episodes.avoidability import Avoidability
from charms_bench.plugins.registry import AGENTS, plugins
from charms_bench.report.avoidability_table import in_words, rescuers_table
from charms_bench.report.markdown import markdown
from charms_bench.report.table import Table
from charms_bench.report.training_tables import stored_training
from charms_bench.runs.resumable_folder import RunFolder


def made_at(run: Path) -> str:
    """The commits of all runs; a CSV file has the commit and the hash of the suite of each."""
    columns, kept = ["run", "commit", "suite_sha256"], RESULTS / "runs.csv"
    rows = pl.read_csv(kept, infer_schema=False).rows() if kept.exists() else []
    known = {name: (name, *others) for name, *others in rows}
    for path in run.parent.glob("*/manifest.json"):
        manifest, name = json.loads(path.read_text(encoding="utf-8")), path.parent.name
        if manifest.get("commit"):
            known[name] = (name, manifest["commit"], manifest.get("suite_sha256", ""))
    found = sorted(known.values())
    pl.DataFrame(found, schema=columns, orient="row").write_csv(kept)
    made = dict.fromkeys(each[1] for each in found)
    commits = f"commit{'s' * (len(made) > 1)} " + ", ".join(f"`{each[:7]}`" for each in made)
    return (
        f"The {len(found)} runs were made with {commits}. [A CSV file](results/runs.csv) "
        "has the commit and the hash of the suite of each, as in its `manifest.json`.\n"
    )


def edges(run: Path) -> str:
    """The first of the most critical episodes of the suite `ego`, and how to see one."""
    found = open_run(run, ROOT / "suites").edge_cases(2)
    listed = "rank ego           traffic   episode criticality what happened"
    for case in found:
        listed += f"\n{case.rank:4} {case.ego:13} {case.traffic:9} {case.episode:7} "
        listed += f"{case.criticality:11.2f} {case.what}"
    first = f'charms-bench replay runs/ego {found[0].episode} --ego "{found[0].ego}"'
    replayed = f"This command replays the first of these episodes:\n\n```sh\n{first}\n```\n"
    return f"```text\n{listed}\n```\n\n{replayed}"


def avoidability(run: Path) -> str:
    """How late CHARMS could have avoided its collisions of the suite `ego`, and who avoids them."""
    ours = {name for name, each in plugins(AGENTS).items() if each.distribution == "charms-bench"}
    found = [
        replace(
            each,
            avoided_by=tuple(name for name in each.avoided_by if name in ours),
            hit_by=tuple(name for name in each.hit_by if name in ours),
        )
        for each in open_run(run, ROOT / "suites").avoidability(ego="CHARMS")
    ]
    return how_late(found, RunFolder(run).suite().scene.decision_hz)


def how_late(found: Sequence[Avoidability], decision_hz: int) -> str:
    """The words and tables of `avoidability`."""
    decisions = Counter(
        each.step - each.last_step + 1 for each in found if each.last_step is not None
    )
    since = "time from the last decision with an escape, s"
    records = [
        {"decisions": count, since: count / decision_hz, "collisions": collisions}
        for count, collisions in sorted(decisions.items())
    ]
    late = Table.plain(records, ("decisions",), {since: ".2f", "collisions": ".0f"})
    return f"{fill(in_words(found), 100)}\n\n{markdown(late)}\n{markdown(rescuers_table(found))}"


def fine_tuning(run: Path) -> str:
    """What learning from human driving did to each style; nothing if no stage learnt from it."""
    table = stored_training(run).stages
    assert table is not None
    records = [each for each in table.records() if each["agreement"] is not None]
    for each in records:
        each["style"] = each["stage"].removeprefix("charms_").replace("_", " ")
    forms = {"agreement_before": ".1%", "agreement": ".1%"}
    forms |= {"log_likelihood_before": ".3f", "log_likelihood": ".3f"}
    headers = ("agreement before", "after", "log-likelihood before", "after ")
    return markdown(Table.plain(records, ("style",), forms).named(*headers))


def training_time(run: Path) -> str:
    """The processor time of each stage that learns by reinforcement."""
    table = stored_training(run).stages
    assert table is not None
    records = [each for each in table.records() if each["steps"] is not None]
    for each in records:
        each["minutes"] = each["cpu_s"] and each["cpu_s"] / 60
        each["stage"] = each["stage"].replace("_", " ")
    return markdown(Table.plain(records, ("stage",), {"steps": ",.0f", "minutes": ".1f"}))


def reproduction(run: Path) -> str:
    """The results of the authors' networks and ours beside the paper's; nothing without ours."""
    name = run.name.removeprefix("released-")
    if not (run.parent / name).is_dir():
        return ""
    numbers = RESULTS / f"reproduction-{name}.csv"
    with_verdicts(compared(run, run.parent / name)).write_csv(numbers)
    return side_by_side(pl.read_csv(numbers))
