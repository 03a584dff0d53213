"""The table of a suite: every metric of every cell; and its matrices of egos and traffic models."""

from collections.abc import Sequence
from dataclasses import astuple, replace

import polars as pl

from charms_bench.metrics import PAPER, MetricSet
from charms_bench.report.definitions import columns_of, installed_column, said_of_left_out
from charms_bench.report.number import Number
from charms_bench.report.table import ESTIMATE, Row, Table, long_frame
from charms_bench.runs.cells import CellRows, title_of
from charms_bench.runs.suite import Suite
from charms_bench.statistics.intervals import estimate

KEYS = ("agent", "traffic")
LONG = {"metric_set": "group", "metric": "name", **ESTIMATE, "paper": "reference"}
"""A metric set is named with its version, such as `paper-2`."""
MATRICES = {
    "goal_reached": ("Egos that reach the goal of their road, % of episodes", 100.0),
    "time_to_goal": ("Time of egos to the goal of their road, s", 1.0),
    "crashed_episodes": ("Egos crashed, % of episodes", 100.0),
    "crashed_at_fault": ("Egos crashed at fault, % of episodes", 100.0),
    "speed_mean": ("Mean speed of egos, m/s", 1.0),
    "conflicts_per_1000km": ("Conflicts of egos per 1,000 km", 1.0),
    "planar_conflicts_per_1000km": ("Planar conflicts of egos per 1,000 km", 1.0),
    "yaw_rate_rms": ("Yaw rate of egos, root mean square, mrad/s", 1000.0),
    "lane_changes_per_km": ("Lane changes of egos per km", 1.0),
    "traffic_crashed": ("Traffic crashed, % of vehicles per episode", 100.0),
}
"""Metrics of the sets `roads` and `standard` that are shown as a matrix: title, and factor for its
unit."""
HIGHER_IS_BETTER = ("goal_reached",)
"""Of these metrics."""
NO_DIRECTION = ("speed_mean", "lane_changes_per_km")
"""Neither higher nor lower values of these are better; lower values of all others are."""


def part_of(suite: Suite, cell: CellRows, metric_sets: Sequence[MetricSet]) -> pl.DataFrame:
    """The part of one cell in the table's long frame: metrics with 95 % intervals, paper's values.

    The suite's seed is that of the resamples, which are the same for cells with the same number of
    episodes.
    """
    labels = [each.label for each in metric_sets for _ in each.metrics]
    metrics = [metric for each in metric_sets for metric in each.metrics]
    estimates = estimate(metrics, cell.sums(metrics, suite.scene), suite.seed)
    paper = {(PAPER.label, name): value for name, value in cell.paper.items()}
    records = [
        (*cell.labels, label, each.name, *astuple(found), paper.get((label, each.name)))
        for label, each, found in zip(labels, metrics, estimates, strict=True)
    ]
    return long_frame(records, suite.with_road(KEYS), LONG)


def from_frame(frame: pl.DataFrame, suite: Suite, metric_sets: Sequence[MetricSet] = ()) -> Table:
    """The table of a suite from its long frame.

    Without metric sets, the definitions of its columns are those of the installed sets.
    """
    notes = (suite.note, said_of_left_out(frame, "metric"), first_speeds(suite), time_over(frame))
    described = [each for found in metric_sets for each in columns_of(found).values()]
    columns = {(each.group, each.name): each for each in described}
    return Table.from_frame(
        frame,
        suite.suite,
        suite.title or suite.suite,
        suite.with_road(KEYS),
        LONG,
        (lambda *names: columns[names]) if columns else installed_column,
        note=" ".join(filter(None, notes)),
        reference="paper",
    )


def first_speeds(suite: Suite) -> str:
    """Says on which roads policies choose lower target speeds than the profile's; empty if none."""
    if not suite.roads:
        return ""
    from charms_bench.roads.settings import profiles_of  # slow to import

    least = suite.scene.profile.target_speed_min_mps
    scenes = {each.road.title: each.scene for each in suite.cells if each.road is not None}
    begin = {title: profiles_of(scene)[0].target_speed_min_mps for title, scene in scenes.items()}
    lower = ", ".join(
        f"{speed:.3g} m/s on {title}" for title, speed in begin.items() if speed < least
    )
    return lower and (
        "The target speeds of policies begin at the ego's first speed where it is below the "
        f"{least:g} m/s of the profile: {lower}."
    )


def time_over(frame: pl.DataFrame) -> str:
    """How many episodes end neither at a goal nor badly, by the long frame; empty if all do.

    On roads with a goal, these are the episodes whose time was over.
    """
    keys = [name for name in ("agent", "road", "traffic") if name in frame.columns]
    standard = ~pl.col("metric_set").str.starts_with(PAPER.name)
    values = frame.filter(standard).select(*keys, "metric", "value").drop_nulls("value")
    ended = [
        values.filter(metric=name).rename({"value": name}).drop("metric")
        for name in ("goal_reached", "crashed_episodes")
    ]
    both = ended[0].join(ended[1], on=keys)
    proportions = both.with_columns(over=1 - pl.col("goal_reached") - pl.col("crashed_episodes"))
    if proportions.is_empty() or proportions["over"].max() < 0.005:  # type: ignore[operator]  # a number
        return ""
    most = proportions.row(int(proportions["over"].arg_max() or 0), named=True)
    where = " in ".join(str(most[name]) for name in keys)
    proportion = f"{most['over']:.1%}".replace("%", " %")
    return (
        "Episodes with neither the goal nor a crash ended because their time was over: at most "
        f"{proportion} ({where})."
    )


def printed(table: Table, columns: Sequence[str]) -> Table:
    """The metrics that a suite prints, without keys that are all the same.

    They are the suite's own `columns`. If the table has none of them, they are the metrics that the
    paper reports, and if there are none, all.
    """
    names = list(dict.fromkeys(column.name for column in table.columns))
    reported = [table.columns[i].name for i in table.reported()]
    chosen = [name for name in columns if name in names]
    chosen = chosen or [name for name in names if name in reported] or names
    return table.select(*chosen).without_constant_keys()


def one_per_metric(table: Table) -> Table:
    """The table with one column per metric.

    Of a metric that several sets have, it is the one with the paper's values, else the last.
    """
    places: dict[str, int] = {}
    reported = table.reported()
    for i, column in enumerate(table.columns):
        if places.get(column.name) not in reported:
            places[column.name] = i
    return table.take(list(places.values()))


def matrices(table: Table) -> list[Table]:
    """A table of egos down and traffic models across for each of `MATRICES` that was computed.

    A column is a traffic, or a road with it. None for a suite of one ego or one traffic, which the
    table shows as well.
    """
    places = {
        column.name: i
        for i, column in enumerate(table.columns)
        if column.group.startswith(("roads-", "standard-"))
    }
    egos = tuple(dict.fromkeys(row.labels[0] for row in table.rows))
    traffics = {row.labels[1:]: title_of(row.labels[1:]) for row in table.rows}
    if len(egos) < 2 or len(traffics) < 2:
        return []
    found = []
    for metric, (title, factor) in MATRICES.items():
        if (place := places.get(metric)) is None:
            continue
        column = replace(table.columns[place], group="", unit="", form=",.1f")
        columns = tuple(replace(column, name=each, label=each) for each in traffics.values())
        numbers = {row.labels: row.numbers[place].scaled(factor) for row in table.rows}
        rows = tuple(
            Row((ego,), tuple(numbers.get((ego, *labels), Number()) for labels in traffics))
            for ego in egos
        )
        name = f"{table.name}-{metric}"
        found.append(Table(name, title, (f"ego \\ {table.keys[1]}",), columns, rows))
    return found
