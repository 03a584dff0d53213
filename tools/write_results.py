"""Writes the tables of the readme and the documentation: `python tools/write_results.py RUNS`.

RUNS holds the run folders of the suites by their names, `RUNS/ego` and so on, and that of the
training as `RUNS/train`. Each gives a file in `docs/results`, which then replaces the text between
`<!-- results: NAME -->` and `<!-- end of results -->` wherever that stands. What RUNS does not
hold stays as it is.
"""

import re
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import polars as pl

from charms_bench.episodes.edge_cases import edge_cases
from charms_bench.report.stored import stored_tables
from charms_bench.report.training import stored_training
from charms_bench.runs.finished import open_finished

ROOT = Path(__file__).parent.parent
RESULTS = ROOT / "docs" / "results"
BLOCK = re.compile(r"(<!-- results: ([a-z-]+) -->\n\n).*?(<!-- end of results -->)", re.DOTALL)


@dataclass(frozen=True)
class Column:
    """A metric of a table."""

    header: str
    metric: str
    form: str = ".3f"
    """Of a number; with `%` it is printed in percent."""
    metric_set: str = "paper-"
    """How its label begins."""
    interval: bool = False
    """Whether the 95 % interval is printed too."""


CRASHED = Column("episodes crashed", "crashed_episodes", ".1%", "standard-", interval=True)
TRAFFIC_CRASHED = Column(
    "vehicles crashed in 20 s", "traffic_crashed", ".1%", "standard-", interval=True
)
PER_1000KM = Column("per 1,000 km", "traffic_crashes_per_1000km", ",.0f", "standard-")
DENSITY = Column("interaction density", "interaction_density", ".2f")
EGO_SPEED = Column("ego's speed, m/s", "speed_mean", ".2f")
EGO_SPEED_STD = Column("ego's speed std", "speed_std", ".2f")
EGO_TTC = Column("ego's TTC < 3 s, closing", "ttc_below_3s_closing", ".4f")
SPEED = Column("speed, m/s", "speed_mean", ".2f")
HARSH = Column("harsh", "harsh_acc_rate", ".4f")

EGO = (
    CRASHED,
    Column("collision rate", "collision_rate", ".4f"),
    Column("TTC < 3 s", "ttc_below_3s"),
    SPEED,
    Column("acceleration std, m/s²", "acc_std"),
    HARSH,
)
STYLES = (
    SPEED,
    Column("speed std", "speed_std", ".2f"),
    Column("acceleration", "acc_mean"),
    Column("acceleration std", "acc_std"),
    Column("headway, m", "dhw_mean", ".1f"),
    Column("headway std", "dhw_std", ".1f"),
    HARSH,
    CRASHED,
)
ENVIRONMENT = (TRAFFIC_CRASHED, PER_1000KM, DENSITY, EGO_SPEED_STD, EGO_TTC)
PCH = (TRAFFIC_CRASHED, PER_1000KM, DENSITY, EGO_SPEED, EGO_SPEED_STD)


def table(long: pl.DataFrame, name: str, columns: Sequence[Column]) -> str:
    """A Markdown table of a long one, a row an agent or a traffic."""
    chosen = [
        {
            row[name]: row
            for row in long.iter_rows(named=True)
            if row["metric"] == column.metric and row["metric_set"].startswith(column.metric_set)
        }
        for column in columns
    ]
    headers = [
        column.header + " (paper)" * any(row["paper"] is not None for row in rows.values())
        for column, rows in zip(columns, chosen, strict=True)
    ]
    lines = [
        [label, *(cell(column, rows[label]) for column, rows in zip(columns, chosen, strict=True))]
        for label in long[name].unique(maintain_order=True)
    ]
    return markdown([name, *headers], lines)


def cell(column: Column, row: dict[str, float | None]) -> str:
    """A number, its interval if that is asked for, and the paper's in parentheses."""

    def text(number: float) -> str:
        return f"{number:{column.form}}".removesuffix("%")

    if row["value"] is None:
        return "–"
    parts = [text(row["value"]) + " %" * column.form.endswith("%")]
    if column.interval and row["low"] is not None and row["high"] is not None:
        parts.append(f"[{text(row['low'])}, {text(row['high'])}]")
    if row["paper"] is not None:
        parts.append(f"({row['paper']:g})")
    return " ".join(parts)


def markdown(header: Sequence[str], lines: Sequence[Sequence[str]]) -> str:
    """A table whose first column is of names."""
    rule = "|---|" + "---:|" * (len(header) - 1)
    head, *rest = ("| " + " | ".join(line) + " |" for line in (header, *lines))
    return "\n".join([head, rule, *rest]) + "\n"


def of_suite(name: str, columns: Sequence[Column], of: str) -> Callable[[Path], str]:
    """Writes the table of a suite, a row an agent or a traffic."""

    def write(runs: Path) -> str:
        return table(stored_tables(runs / name, name)[""], of, columns)

    return write


def realism(runs: Path) -> str:
    """How far each traffic is from each reference, the nearest in bold."""
    long = stored_tables(runs / "realism", "realism")["-realism"]
    header, columns = ["traffic"], []
    for (reference, metric), rows in long.group_by("reference", "metric", maintain_order=True):
        distance, _, quantity = str(metric).partition("_")
        if distance != "js":
            continue
        what = {"speed": "speed", "dhw": "headway"}[quantity]
        header.append(f"{what}, {str(reference).upper()}")
        nearest = rows["value"].min()
        columns.append(
            [
                f"{'**' * (value == nearest)}{value:.3f}{'**' * (value == nearest)} "
                f"[{low:.3f}, {high:.3f}]"
                for value, low, high in rows.select("value", "low", "high").iter_rows()
            ]
        )
    traffics = long["traffic"].unique(maintain_order=True)
    return markdown(header, list(zip(traffics, *columns, strict=True)))


def crossplay(runs: Path) -> str:
    """The matrices, each under its title."""
    text = (runs / "crossplay" / "tables" / "crossplay-matrix.md").read_text(encoding="utf-8")
    return re.sub("^## (.*)$", r"**\1**", text, flags=re.MULTILINE)


def edges(runs: Path) -> str:
    """The first of the most critical episodes of the suite `ego`, and how to see one."""
    run = open_finished(runs / "ego")
    found = edge_cases(run, 2, None, range(len(run.suite.cells)), ROOT / "suites")
    lines = ["rank ego           traffic   episode criticality what happened"]
    lines += [
        f"{case.rank:4} {case.ego:13} {case.traffic:9} {case.episode:7} {case.criticality:11.2f} "
        f"{case.what}"
        for case in found
    ]
    listed = "\n".join(lines)
    first = f'charms-bench replay runs/ego {found[0].episode} --agent "{found[0].ego}"'
    replayed = f"This command replays the first of these episodes:\n\n```sh\n{first}\n```\n"
    return f"```text\n{listed}\n```\n\n{replayed}"


def fine_tuning(runs: Path) -> str:
    """What learning from people did to each style; nothing where no stage did."""
    stages = stored_training(runs / "train")["stages"].drop_nulls("agreement")
    if stages.is_empty():
        return ""
    lines = [
        [
            row["stage"].removeprefix("charms_").replace("_", " "),
            *(f"{row[when]:.1%}".replace("%", " %") for when in ("agreement_before", "agreement")),
        ]
        for row in stages.iter_rows(named=True)
    ]
    return markdown(["style", "before", "after"], lines)


TABLES: dict[str, tuple[str, Callable[[Path], str]]] = {
    "ego": ("ego", of_suite("ego", EGO, "agent")),
    "edge-cases": ("ego", edges),
    "styles": ("styles", of_suite("styles", STYLES, "agent")),
    "environment": ("environment", of_suite("environment", ENVIRONMENT, "traffic")),
    "realism": ("realism", realism),
    "pch": ("pch", of_suite("pch", PCH, "traffic")),
    "crossplay": ("crossplay", crossplay),
    "fine-tuning": ("train", fine_tuning),
}
"""By name: the run folder that is needed, and what makes the text of it."""


def filled(text: str) -> str:
    """A page with the files of `docs/results` in their places."""

    def block(found: re.Match[str]) -> str:
        return f"{found[1]}{(RESULTS / f'{found[2]}.md').read_text(encoding='utf-8')}\n{found[3]}"

    return BLOCK.sub(block, text)


def pages() -> list[Path]:
    """Whatever may have results in it."""
    return [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]


def main(runs: Path) -> None:
    RESULTS.mkdir(exist_ok=True)
    for name, (folder, make) in TABLES.items():
        text = make(runs) if (runs / folder).is_dir() else ""
        if text:
            (RESULTS / f"{name}.md").write_text(text, encoding="utf-8")
        print(
            f"docs/results/{name}.md: {'from' if text else 'as it was, nothing in'} {runs / folder}"
        )
    for page in pages():
        page.write_text(filled(page.read_text(encoding="utf-8")), encoding="utf-8")


if __name__ == "__main__":
    if len(sys.argv) != 2:
        sys.exit("usage: python tools/write_results.py RUNS")
    main(Path(sys.argv[1]))
