"""Writes the tables of the readme and the documentation: `python tools/write_results.py RUNS`.

RUNS holds the run folders of the suites by their names, `RUNS/ego` and so on, and that of the
training as `RUNS/train`. Each gives a file in `docs/results`, which then replaces the text between
`<!-- results: NAME -->` and `<!-- end of results -->` wherever that stands. What RUNS does not
hold stays as it is.
"""

import re
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from charms_bench.episodes.edge_cases import edge_cases
from charms_bench.report.markdown import markdown
from charms_bench.report.run_tables import RunTables
from charms_bench.report.stored import stored_tables
from charms_bench.report.suite_table import matrices
from charms_bench.report.table import Row, Table
from charms_bench.report.training_tables import stored_training
from charms_bench.runs.finished import open_finished
from charms_bench.runs.folder import RunFolder

ROOT = Path(__file__).parent.parent
RESULTS = ROOT / "docs" / "results"
BLOCK = re.compile(r"(<!-- results: ([a-z-]+) -->\n\n).*?(<!-- end of results -->)", re.DOTALL)


@dataclass(frozen=True)
class Shown:
    """A metric of a table in the documentation."""

    header: str
    metric: str
    form: str = ".3f"
    """As in `Column`."""
    metric_set: str = "paper-"
    """How the label of its set begins."""
    interval: bool = False
    """Whether the 95 % interval is written too."""


CRASHED = Shown("episodes crashed", "crashed_episodes", ".1%", "standard-", interval=True)
TRAFFIC_CRASHED = Shown(
    "vehicles crashed in 20 s", "traffic_crashed", ".1%", "standard-", interval=True
)
PER_1000KM = Shown("per 1,000 km", "traffic_crashes_per_1000km", ",.0f", "standard-")
DENSITY = Shown("interaction density", "interaction_density", ".2f")
EGO_SPEED = Shown("ego's speed, m/s", "speed_mean", ".2f")
EGO_SPEED_STD = Shown("ego's speed std", "speed_std", ".2f")
EGO_TTC = Shown("ego's TTC < 3 s, closing", "ttc_below_3s_closing", ".4f")
SPEED = Shown("speed, m/s", "speed_mean", ".2f")
HARSH = Shown("harsh", "harsh_acc_rate", ".4f")

EGO = (
    CRASHED,
    Shown("collision rate", "collision_rate", ".4f"),
    Shown("TTC < 3 s", "ttc_below_3s"),
    SPEED,
    Shown("acceleration std, m/s²", "acc_std"),
    HARSH,
)
STYLES = (
    SPEED,
    Shown("speed std", "speed_std", ".2f"),
    Shown("acceleration", "acc_mean"),
    Shown("acceleration std", "acc_std"),
    Shown("headway, m", "dhw_mean", ".1f"),
    Shown("headway std", "dhw_std", ".1f"),
    HARSH,
    CRASHED,
)
ENVIRONMENT = (TRAFFIC_CRASHED, PER_1000KM, DENSITY, EGO_SPEED_STD, EGO_TTC)
PCH = (TRAFFIC_CRASHED, PER_1000KM, DENSITY, EGO_SPEED, EGO_SPEED_STD)


def of_suite(name: str, columns: Sequence[Shown], key: str) -> Callable[[Path], str]:
    """Writes the table of a suite, an agent or a traffic per row."""

    def write(runs: Path) -> str:
        return markdown(shown(tables_of(runs / name).metrics, columns, key))

    return write


def tables_of(run: Path) -> RunTables:
    return stored_tables(run, RunFolder(run).suite())


def shown(table: Table, columns: Sequence[Shown], key: str) -> Table:
    """A suite's table with some columns under other names, labelled by one key."""
    place = table.keys.index(key)
    chosen = table.take([_place(table, column) for column in columns])
    return replace(
        chosen,
        keys=(key,),
        columns=tuple(
            replace(each, name=column.header, form=column.form)
            for each, column in zip(chosen.columns, columns, strict=True)
        ),
        rows=tuple(
            Row(
                (row.labels[place],),
                tuple(
                    number if column.interval else replace(number, low=None, high=None)
                    for number, column in zip(row.numbers, columns, strict=True)
                ),
            )
            for row in chosen.rows
        ),
    )


def _place(table: Table, column: Shown) -> int:
    return next(
        i
        for i, each in enumerate(table.columns)
        if each.name == column.metric and each.group.startswith(column.metric_set)
    )


def realism(runs: Path) -> str:
    """How far each traffic is from each reference, the nearest in bold."""
    table = tables_of(runs / "realism").realism
    assert table is not None
    what = {"speed": "speed", "dhw": "headway"}
    chosen = table.take([i for i, each in enumerate(table.columns) if each.name.startswith("js_")])
    headers = [f"{what[each.quantity]}, {each.group.upper()}" for each in chosen.columns]
    columns = [replace(each, name=n) for each, n in zip(chosen.columns, headers, strict=True)]
    return markdown(replace(chosen, columns=tuple(columns)))


def crossplay(runs: Path) -> str:
    """The matrices, each under its title."""
    found = matrices(tables_of(runs / "crossplay").metrics)
    return "\n".join(f"**{matrix.title}**\n\n{markdown(matrix)}" for matrix in found)


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
    """What learning from human driving did to each style; nothing if no stage learnt from it."""
    table = stored_training(runs / "train").stages
    assert table is not None
    names = {"agreement_before": "before", "agreement": "after"}
    chosen = table.select(*names)
    return markdown(
        replace(
            chosen,
            keys=("style",),
            columns=tuple(replace(e, name=names[e.name], form=".1%") for e in chosen.columns),
            rows=tuple(
                replace(row, labels=(row.labels[0].removeprefix("charms_").replace("_", " "),))
                for row in chosen.rows
                if row.numbers[1].value is not None
            ),
        )
    )


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
