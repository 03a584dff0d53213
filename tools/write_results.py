"""Writes the tables of the readme and the documentation: `python tools/write_results.py RUNS`.

RUNS holds the run folders of the suites by their names, `RUNS/ego` and so on, and that of the
training as `RUNS/train`. Each gives a file in `docs/results`, which then replaces the text between
`<!-- results: NAME -->` and `<!-- end of results -->` wherever that stands. What RUNS does not
hold stays as it is. The tables of docs/reproduction.md compare `RUNS/released-ego` with `RUNS/ego`,
and so on. CSV files beside them hold the numbers of long tables. `RUNS/rare` is what
`charms-bench rare suites/rare.yaml --output RUNS/rare` made, and `rare_comparison` names others.
"""

import json
import re
import sys
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from textwrap import fill

import polars as pl
from rare_comparison import rare_comparison, rare_estimate
from reproduction import compared, side_by_side, with_verdicts
from transfer import transfer_numbers, transfer_table, with_worst

from charms_bench import open_run
from charms_bench.cli.evaluations import HEADLINE_WIDTH
from charms_bench.episodes.avoidability import Avoidability
from charms_bench.plugins.registry import AGENTS, plugins
from charms_bench.report.avoidability_table import in_words, rescuers_table
from charms_bench.report.headline import headline
from charms_bench.report.html.table import written
from charms_bench.report.markdown import markdown
from charms_bench.report.stored import RunTables, stored_tables
from charms_bench.report.suite_table import matrices
from charms_bench.report.table import Column, Row, Table
from charms_bench.report.terminal import fitting
from charms_bench.report.training_tables import stored_training
from charms_bench.runs.cells import title_of
from charms_bench.runs.resumable_folder import RunFolder

ROOT = Path(__file__).parent.parent
RESULTS = ROOT / "docs" / "results"
BLOCK = re.compile(r"(<!-- results: ([a-z0-9-]+) -->\n\n).*?(<!-- end of results -->)", re.DOTALL)
EGO = {
    "episodes crashed": ("crashed_episodes", ".1%"),
    "crashed at fault": ("crashed_at_fault", ".1%"),
    "collision rate": ("collision_rate", ".4f"),
    "TTC < 3 s": ("ttc_below_3s", ".3f"),
    "speed, m/s": ("speed_mean", ".2f"),
    "acceleration std, m/s²": ("acc_std", ".3f"),
    "yaw std": ("yaw_std", ".4f"),
    "harsh": ("harsh_acc_rate", ".4f"),
    "harsh, all decisions": ("harsh_acc_rate_all_steps", ".4f"),
    "conflicts per 1,000 km": ("conflicts_per_1000km", ",.0f"),
    "planar conflicts per 1,000 km": ("planar_conflicts_per_1000km", ",.0f"),
    "lane changes per km": ("lane_changes_per_km", ".2f"),
}
"""The columns of a table in the documentation: what metric each shows, and how (`Column.form`)."""
CRASHED = {"crashed episodes": ("crashed_episodes", ".1%")}
NOT_IN_README = "CHARMS best response"
DENSE = "transfer-density-2-0"
"""The run of the readme's agents at twice the density."""
STYLES = {
    "speed, m/s": ("speed_mean", ".2f"),
    "speed std": ("speed_std", ".2f"),
    "acceleration": ("acc_mean", ".3f"),
    "acceleration std": ("acc_std", ".3f"),
    "headway, m": ("dhw_mean", ".1f"),
    "headway std": ("dhw_std", ".1f"),
    "harsh": ("harsh_acc_rate", ".4f"),
    "episodes crashed": ("crashed_episodes", ".1%"),
    "crashed at fault": ("crashed_at_fault", ".1%"),
    "conflicts per 1,000 km": ("conflicts_per_1000km", ",.0f"),
    "planar conflicts per 1,000 km": ("planar_conflicts_per_1000km", ",.0f"),
    "lane changes per km": ("lane_changes_per_km", ".2f"),
}
TRAFFIC = {
    "vehicles crashed in 20 s": ("traffic_crashed", ".1%"),
    "per 1,000 km": ("traffic_crashes_per_1000km", ",.0f"),
    "interaction density": ("interaction_density", ".2f"),
}
EGO_STD = {"ego's speed std": ("speed_std", ".2f")}
EGO_TTC = {"ego's TTC < 3 s, closing": ("ttc_below_3s_closing", ".4f")}
ENVIRONMENT = {**TRAFFIC, **EGO_STD, **EGO_TTC}
EDGE_CASES = {
    "aborted lane changes": ("gaps_lost_per_1000km", ",.1f"),
    "conflicts": ("conflicts_to_per_1000km", ",.1f"),
    "near misses": ("near_misses_to_per_1000km", ",.1f"),
    "hard braking": ("hard_braking_to_per_1000km", ",.1f"),
    "traffic: aborted lane changes": ("traffic_gaps_lost_per_1000km", ",.1f"),
    "traffic: conflicts": ("traffic_conflicts_to_per_1000km", ",.1f"),
    "traffic: crashes": ("traffic_crashes_per_1000km", ",.1f"),
}
PCH = {**TRAFFIC, "ego's speed, m/s": ("speed_mean", ".2f"), **EGO_STD}


def of_suite(columns: Mapping[str, tuple[str, str]], run: Path) -> str:
    """The table of a suite, an agent or a traffic per row."""
    return markdown(shown(tables_of(run).metrics, columns))


def ego(run: Path) -> str:
    """The table of egos, with the worst of the conditions of the folder `suites/transfer`."""
    return markdown(with_worst(shown(tables_of(run).metrics, EGO), run.parent))


def readme(run: Path) -> str:
    """The table that `charms-bench run` prints, and the crashes in traffic twice as dense."""
    table = headline(RunFolder(run).suite(), tables_of(run))
    table = table.take(range(len(fitting(table, HEADLINE_WIDTH))))
    rows = tuple(row for row in table.rows if row.labels != (NOT_IN_README,))
    dense = shown(tables_of(run.parent / DENSE).metrics, CRASHED)
    crashed = {row.labels: cell.value for row, (cell,) in written(dense)}
    listed = ", ".join(
        f"{row.labels[0]} {crashed[row.labels]}" for row in rows if row.labels in crashed
    )
    words = f"At twice the density, these proportions of the episodes end in a crash: {listed}."
    return f"{markdown(replace(table, rows=rows))}\n{fill(words, 100)}\n"


def merge(run: Path) -> str:
    """The table that `charms-bench run` prints, and the worst episode of the readme's policy."""
    worst = open_run(run).edge_cases(ego="mine", top=1)[0]
    table = headline(RunFolder(run).suite(), tables_of(run))
    return f"{markdown(table)}\n> Episode {worst.episode}: {worst.what}\n"


def tables_of(run: Path) -> RunTables:
    return stored_tables(run, RunFolder(run).suite())


def rates(columns: Mapping[str, tuple[str, str]], run: Path) -> str:
    """The table of a suite, every value with its interval."""
    return markdown(chosen(tables_of(run).metrics, columns))


def shown(table: Table, columns: Mapping[str, tuple[str, str]]) -> Table:
    """A suite's table with these columns, of which only shares keep their intervals."""
    table = chosen(table, columns)
    rows = []
    for row in table.rows:
        numbers = (
            number if column.form.endswith("%") else replace(number, low=None, high=None)
            for number, column in zip(row.numbers, table.columns, strict=True)
        )
        rows.append(Row(row.labels, tuple(numbers)))
    return replace(table, rows=tuple(rows))


def chosen(table: Table, columns: Mapping[str, tuple[str, str]]) -> Table:
    """A suite's table with these columns, each from the first set that has the metric.

    Keys that are all the same are left out.
    """
    names = [column.name for column in table.columns]
    table = table.take([names.index(metric) for metric, _ in columns.values()])
    described = tuple(Column(header, form=form) for header, (_, form) in columns.items())
    return replace(table, columns=described).without_constant_keys()


def realism(run: Path) -> str:
    """How far each traffic is from each reference, the nearest in bold, and the suite's note."""
    table = tables_of(run).realism
    assert table is not None
    what = {"speed": "speed", "dhw": "headway"}
    chosen = table.take([i for i, each in enumerate(table.columns) if each.name.startswith("js_")])
    headers = [f"{what[each.quantity]}, {each.group.upper()}" for each in chosen.columns]
    return f"{markdown(chosen.named(*headers))}\n{RunFolder(run).suite().note}\n"


def crossplay(run: Path) -> str:
    """The matrices of crashes at fault and of speeds; a CSV file has all of them."""
    found = matrices(tables_of(run).metrics)
    numbers = [
        (matrix.title, *row.labels, column.name, number.value, number.low, number.high)
        for matrix in found
        for row in matrix.rows
        for column, number in zip(matrix.columns, row.numbers, strict=True)
    ]
    columns = ["metric", "ego", "traffic model", "value", "low", "high"]
    pl.DataFrame(numbers, schema=columns, orient="row").write_csv(RESULTS / "crossplay.csv")
    shown = [each for each in found if each.name.endswith(("crashed_at_fault", "speed_mean"))]
    return "\n".join(f"**{matrix.title}**\n\n{markdown(matrix)}" for matrix in shown)


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


def roads(run: Path) -> str:
    """What the egos reach on each road: roads down, egos across; then on roads among agents."""
    table, parts = tables_of(run).metrics, []
    rows_of = (*table.rows, *tables_of(run.with_name("roads-traffic")).metrics.rows)
    shown = {
        "goal_reached": ("Episodes with the goal reached, %", 100.0),
        "crashed_episodes": ("Crashed episodes, %", 100.0),
        "crashed_at_fault": ("Crashed at fault, %", 100.0),
        "time_to_goal": ("Time to the goal, s", 1.0),
    }
    for metric, (title, factor) in shown.items():
        places = [k for k, each in enumerate(table.columns) if each.name == metric]
        numbers = {
            (row.labels[0], title_of(row.labels[1:])): row.numbers[places[-1]].scaled(factor)
            for row in rows_of
        }
        egos, names = (tuple(dict.fromkeys(label[k] for label in numbers)) for k in (0, 1))
        rows = [Row((name,), tuple(numbers[ego, name] for ego in egos)) for name in names]
        columns = tuple(Column(ego, form=".0f", label=ego) for ego in egos)
        whole = Table("roads", title, ("road",), columns, tuple(rows))
        parts.append(f"**{title}**\n\n{markdown(whole)}")
    return "\n".join(parts)


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


def preventable(run: Path) -> str:
    """The collisions and the strongest braking of each ego in each scenario."""
    table = tables_of(run).preventable
    assert table is not None
    return f"{markdown(table.take(range(len(table.columns) - 1)))}\n{table.note}\n"


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


def transfer(run: Path) -> str:
    """The crashes at fault in other conditions; a CSV file has all crashes, too."""
    transfer_numbers(run.parent).write_csv(RESULTS / "transfer.csv")
    return transfer_table(run.parent)


TABLES: dict[str, tuple[str, Callable[[Path], str]]] = {
    "readme": ("ego", readme),
    "merge": ("merge-mine", merge),
    "runs": ("ego", made_at),
    "ego": ("ego", ego),
    "edge-cases": ("ego", edges),
    "styles": ("styles", partial(of_suite, STYLES)),
    "transfer": ("transfer-traffics", transfer),
    "environment": ("environment", partial(of_suite, ENVIRONMENT)),
    "environment-edge-cases": ("environment", partial(rates, EDGE_CASES)),
    "released-edge-cases": ("released-environment", partial(rates, EDGE_CASES)),
    "realism": ("realism", realism),
    "pch": ("pch", partial(of_suite, PCH)),
    "crossplay": ("crossplay", crossplay),
    "roads": ("roads", roads),
    "preventable": ("r157", preventable),
    "avoidability": ("ego", avoidability),
    "fine-tuning": ("train", fine_tuning),
    "training-time": ("train", training_time),
    "rare": ("rare", rare_estimate),
    "rare-comparison": ("rare", rare_comparison),
    "reproduction-ego": ("released-ego", reproduction),
    "reproduction-styles": ("released-styles", reproduction),
    "reproduction-environment": ("released-environment", reproduction),
}
"""By name: the run folder that is needed, and what makes the text of it."""


def filled(text: str) -> str:
    """A page with the files of `docs/results` in their places."""
    texts = {path.stem: path.read_text(encoding="utf-8") for path in RESULTS.glob("*.md")}
    return BLOCK.sub(lambda found: f"{found[1]}{texts[found[2]]}\n{found[3]}", text)


def refill(page: Path) -> None:
    """Writes a page again with the files of `docs/results` in their places."""
    page.write_text(filled(page.read_text(encoding="utf-8")), encoding="utf-8")


def keep(name: str, text: str) -> None:
    """Writes a table into `docs/results`."""
    (RESULTS / f"{name}.md").write_text(text, encoding="utf-8")


def main(runs: Path) -> None:
    RESULTS.mkdir(exist_ok=True)
    for name, (folder, make) in TABLES.items():
        text = make(runs / folder) if (runs / folder).is_dir() else ""
        if text:
            keep(name, text)
        found = "from" if text else "as it was, nothing in"
        print(f"docs/results/{name}.md: {found} {runs / folder}")
    for page in (ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))):
        refill(page)


if __name__ == "__main__":
    if len(sys.argv) != 2:
        sys.exit("usage: python tools/write_results.py RUNS")
    main(Path(sys.argv[1]))
