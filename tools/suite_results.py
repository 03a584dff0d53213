"""The tables of suites in the documentation."""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from textwrap import fill

import polars as pl
from result_pages import RESULTS
from transfer import with_worst

from charms_bench import open_run
from charms_bench.cli.evaluations import HEADLINE_WIDTH
from charms_bench.report.headline import headline
from charms_bench.report.html.table import written
from charms_bench.report.markdown import markdown
from charms_bench.report.stored import RunTables, stored_tables
from charms_bench.report.suite_table import matrices
from charms_bench.report.table import Column, Row, Table
from charms_bench.report.terminal import fitting
from charms_bench.runs.cells import title_of
from charms_bench.runs.resumable_folder import RunFolder

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
    """The table of a suite, with one agent or traffic model per row."""
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
    """A suite's table with these columns; only proportions keep their intervals."""
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


def preventable(run: Path) -> str:
    """The collisions and the strongest braking of each ego in each scenario."""
    table = tables_of(run).preventable
    assert table is not None
    return f"{markdown(table.take(range(len(table.columns) - 1)))}\n{table.note}\n"
