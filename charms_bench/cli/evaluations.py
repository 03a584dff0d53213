"""`run`, `show`, `compare`, `rescore`, `report` and `audit`: suites and their runs."""

import os
from contextlib import suppress
from pathlib import Path
from typing import Annotated, Any

import typer
from typer import Argument, Option

import charms_bench
from charms_bench.cli import arguments
from charms_bench.cli.terminal import (
    FAIL,
    UNKNOWN,
    app,
    as_word,
    end_with_json,
    interruptible,
    out,
    print_records,
    print_table,
    say,
    shown,
)
from charms_bench.errors import InputError, RunFolderError
from charms_bench.foundation.words import counted

AllMetrics = Annotated[
    bool, Option("--all", help="Show every metric, not only the suite's columns.")
]
EARLY_WORKERS = 4
"""The most workers that start before the suite is read; a finished run needs none of them."""
HEADLINE_WIDTH = 100
"""Characters that the table at the end of a run takes at most."""
VERDICTS = {
    "pass": (0, "everything that was checked passes"),
    "fail": (FAIL, "fails"),
    "unknown": (UNKNOWN, "nothing fails, but not everything can be checked here"),
}
"""The exit code of `audit`, and what it says."""


@app.command(rich_help_panel=arguments.EVALUATE)
def suites(
    copy: str | None = Option(
        None, metavar="NAME", help="Copy this suite to the current folder, to edit it."
    ),
    as_json: arguments.Json = False,
) -> None:
    """List the suites that come with charms-bench.

    `charms-bench run NAME` runs one.
    """
    from charms_bench.runs.copied_suite import copy_suite
    from charms_bench.runs.document import Document
    from charms_bench.runs.packaged import packaged_suites

    if copy is not None:
        path = copy_suite(copy)
        say(f"Written: {shown(path)}; charms-bench run {as_word(path)}")
        return
    titles = {name: str(Document(path).data["title"]) for name, path in packaged_suites().items()}
    if as_json:
        end_with_json([{"name": name, "title": title} for name, title in titles.items()])
    width = max(map(len, titles))
    for name, title in titles.items():
        say(f"{name:{width}}  {title}")


@app.command(rich_help_panel=arguments.EVALUATE)
def run(
    suite: arguments.AnySuite,
    agents: arguments.EgoAgents = None,
    episodes: int | None = Option(
        None, min=1, help="Episodes per ego and traffic model; overrides the suite."
    ),
    workers: arguments.Workers = None,
    seed: int | None = Option(
        None,
        min=0,
        help="Seed of the first episode, or the seed of a training; overrides the suite.",
    ),
    output: Path | None = Option(
        None, help="Run folder; the default is runs/SUITE, followed by each --agent."
    ),
    rows: Path | None = Option(
        None,
        metavar="RUN",
        help="Another run folder; episodes that it contains are copied, not simulated.",
    ),
    shard_limit_s: float | None = Option(
        None,
        "--shard-limit",
        min=1,
        metavar="SECONDS",
        help="Time limit for one shard (150 episodes), including the start of its worker; "
        "the default is 1800.",
    ),
    shorten: bool = Option(
        False, "--shorten", help="Delete finished episodes that the suite no longer has."
    ),
    cluster: str | None = Option(
        None,
        metavar="ADDRESS",
        help="Address of a Dask scheduler; its cluster runs the suite, e.g. tcp://HOST:8786.",
    ),
    only: str | None = Option(
        None, help="Train only this stage of a training suite, and the stages that it needs."
    ),
    steps: int | None = Option(
        None,
        min=1,
        help="Environment steps of every stage of a training, such as a few for a trial; "
        "overrides the suite.",
    ),
    recordings: Path | None = Option(
        None, help="Folder of human recordings for training; overrides the suite."
    ),
    as_json: arguments.Json = False,
) -> None:
    """Run a suite, or continue an interrupted run of it.

    Finished shards are not simulated again.
    """
    from charms_bench.foundation.workers import started_early
    from charms_bench.runs.document import Document

    of_evaluations: dict[str, Any] = {
        "episodes": episodes, "rows": rows, "shard_limit_s": shard_limit_s,
        "cluster": cluster, "shorten": shorten or None, "agents": agents,
    }  # fmt: skip
    of_trainings: dict[str, Any] = {"only": only, "recordings": recordings, "steps": steps}
    is_training = "pipeline" in Document(suite).data
    kinds = ("evaluations", "a training") if is_training else ("trainings", "an evaluation")
    for name, value in (of_evaluations if is_training else of_trainings).items():
        if value is not None:
            option = {"agents": "agent", "shard_limit_s": "shard-limit"}.get(name, name)
            raise InputError(f"--{option} is for {kinds[0]}; {suite} is {kinds[1]}")
    if is_training:
        with interruptible():
            trained = charms_bench.train(suite, output, workers=workers, seed=seed, **of_trainings)
        _print_training(trained, as_json)
        return
    early = min(workers or os.cpu_count() or 1, EARLY_WORKERS) if cluster is None else 0
    with interruptible(), started_early(early, "charms_bench.runs.shard"):
        # To import what it needs takes a while, in which the workers start.
        of_evaluations |= {"seed": seed, "shorten": shorten, "agents": agents or ()}
        made = charms_bench.run(suite, output, workers=workers, **of_evaluations)
    _print_result(made, as_json)


def _print_result(run: Any, as_json: bool, table: Any = None) -> None:
    """The headline of a run, or the table that a command has made, and where the files are."""
    if as_json:
        chosen = run.table if table is None else table
        end_with_json(chosen.frame().to_dicts())
    from charms_bench.report.headline import headline
    from charms_bench.report.stored import stored_tables
    from charms_bench.report.terminal import compact

    if run.suite.title:
        say(run.suite.title)
    if table is not None:
        print_table(table.without_constant_keys(), stacked=True)
    else:
        chosen = headline(run.suite, stored_tables(run.path, run.suite))
        width = min(out().width, HEADLINE_WIDTH)
        out().print(compact(chosen, width), width=width)
        with suppress(InputError):  # the tables do not need the networks
            for line in run.interfaces():
                say(line)
    folder = as_word(run.path)
    say(f"All tables: charms-bench show {folder}; as a page: charms-bench report {folder}")


@app.command(rich_help_panel=arguments.EVALUATE)
def show(
    run: Path = Argument(
        metavar="RUN", help="Folder of an evaluation, a training, `rare` or `search`."
    ),
    metrics: list[str] | None = Option(
        None, "--metric", help="Show only this metric; repeat for more."
    ),
    everything: AllMetrics = False,
    as_json: arguments.Json = False,
) -> None:
    """Print the tables of a run, with 95 % intervals drawn to scale."""
    from charms_bench.episodes.search import MANIFEST as SEARCH
    from charms_bench.foundation.progress import note
    from charms_bench.report.stored import holds, stored_tables
    from charms_bench.report.suite_table import printed
    from charms_bench.report.terminal import drawn
    from charms_bench.runs.rare import MANIFEST as RARE
    from charms_bench.runs.resumable_folder import MANIFEST, RunFolder

    if not holds(run, MANIFEST):
        if metrics or everything:
            raise InputError(f"{run}: is not an evaluation; --metric and --all are for those")
        if holds(run, RARE):
            _print_rare(run, as_json)
        elif holds(run, SEARCH):
            _print_search(run, as_json)
        else:
            _print_training(charms_bench.open_training(run), as_json, curves=True)
        return
    folder = RunFolder(run)
    suite = folder.suite()
    table, *others = stored_tables(run, suite).each()
    if metrics:
        table, others = table.select(*metrics), []
    remarks = []
    try:
        opened = charms_bench.open_run(run)
        folder.reject_damaged(folder.shards(suite))
        remarks = [] if as_json else [*opened.interfaces(), *opened.remarks()]
    except RunFolderError as error:  # tables are shown even where their rows are missing
        if folder.finished():
            note(str(error))
    if as_json:
        facts = {name: getattr(suite, name) for name in ("suite", "title", "episodes", "seed")}
        tables = {each.name: each.frame().to_dicts() for each in (table, *others)}
        end_with_json({**facts, "tables": tables})
    cells = f"{len(suite.egos)} × {len(suite.surroundings)} cells"
    cells += f" of {counted(suite.episodes, 'episode')}"
    say(f"{suite.title or suite.suite}\n{cells}, seeds from {suite.seed:,}")
    for each in (table if metrics or everything else printed(table, suite.columns), *others):
        out().print(drawn(each, out().width))
    if remarks:
        say("\n".join(["", *remarks]))


def _print_rare(folder: Path, as_json: bool) -> None:
    """The tables that `rare` has written."""
    from charms_bench.report.stored import read_csv, read_written

    paths = sorted((folder / "tables").glob("*.csv"))
    if not paths:
        raise InputError(f"{folder}: is not finished; the same command continues there")
    if as_json:
        end_with_json({path.stem: read_csv(path).to_dicts() for path in paths})
    for path in paths:
        say(read_written(path.with_suffix(".md")).decode(errors="replace").rstrip())


def _print_search(folder: Path, as_json: bool) -> None:
    """The failures in the suite that `search` has written."""
    from charms_bench.episodes.found_suite import found_in
    from charms_bench.episodes.search import FOUND

    path, points = folder / FOUND, found_in(folder)
    if as_json:
        end_with_json({"failures": list(points), "suite": str(path) if points else None})
    if not points:
        say(f"{folder}: no failure")
        return
    records = [{"failure": str(k), **point} for k, point in enumerate(points)]
    print_records("failure", records, dict.fromkeys(points[0], ".5g"))
    say(f"Run them with `charms-bench run {shown(path)}`")


def _print_training(training: Any, as_json: bool, curves: bool = False) -> None:
    from charms_bench.report.training_tables import drawn_curves

    if as_json:
        end_with_json(training.to_dict())
    if training.stages is not None:
        print_table(training.stages, stacked=True)
        networks = shown(training.path / "networks")
        say(f"Evaluate a network: charms-bench run ego --agent {networks}/NAME.onnx")
    if curves:
        out().print(drawn_curves(training, out().width))


@app.command(rich_help_panel=arguments.EVALUATE)
def compare(
    first: Path = Argument(metavar="RUN_A", help="Folder of a finished run."),
    second: Path | None = Argument(
        None, metavar="[RUN_B]", help="Another run of the same episodes."
    ),
    egos: tuple[str, str] | None = Option(
        None,
        metavar="A B",
        help="Labels of the egos in the tables. With one run, both are from it; with two "
        "runs, A is from RUN_A and B is from RUN_B.",
    ),
    metrics: list[str] | None = Option(
        None,
        "--metric",
        help="Test only this metric; repeat for more. Fewer tests have more power; choose "
        "the metrics before you look at the results.",
    ),
    metric_sets: arguments.MetricSets = None,
    everything: AllMetrics = False,
    as_json: arguments.Json = False,
) -> None:
    """Test in which metrics two egos differ.

    Both egos drive the same episodes, so the tests are paired.
    """
    from charms_bench.report.comparison import by_pair, to_dicts

    other = None if second is None else charms_bench.open_run(second)
    run = charms_bench.open_run(first)
    table = run.compare(other, egos, metrics or (), metric_sets or ())
    if as_json:
        end_with_json(to_dicts(table))
    columns = () if everything or metrics or metric_sets else run.suite.columns
    parts = by_pair(table, columns) if columns else []
    for part in parts or by_pair(table):
        print_table(part)
    if parts:
        say(
            f"The table has the suite's columns, {sum(len(each.rows) for each in parts)} of "
            f"{len(table.rows)} tests; --all shows every metric."
        )


@app.command(rich_help_panel=arguments.EVALUATE)
def rescore(
    run: arguments.RunPath,
    metric_sets: arguments.MetricSets = None,
    as_json: arguments.Json = False,
) -> None:
    """Compute the metrics of a run again, without simulating."""
    opened = charms_bench.open_run(run)
    table = opened.rescore(*(metric_sets or ()))
    _print_result(opened, as_json, table if metric_sets else None)


@app.command(rich_help_panel=arguments.EVALUATE)
def report(
    runs: list[Path] = Argument(
        metavar="RUN...", help="Folders of finished runs, trainings, `rare` and `search`."
    ),
    output: Path = Option(
        Path("report.html"), "--output", "-o", metavar="OUT.html", help="HTML file to write."
    ),
    top: int = Option(10, min=0, max=100, help="Number of most critical episodes to replay."),
    episodes: list[str] | None = Option(
        None,
        "--episode",
        metavar="RUN:EPISODE[:EGO[:TRAFFIC]]",
        help="Also replay this episode; repeat for more.",
    ),
    what_if: str | None = Option(
        None,
        metavar="STEP:AGENT[:VEHICLE]",
        help="Also show the future of each --episode with another agent from decision STEP on; "
        "see `charms-bench what-if`.",
    ),
    suite_folder: arguments.SuiteFolder = Path(),
    as_json: arguments.Json = False,
) -> None:
    """Write runs into one self-contained HTML file."""
    from charms_bench.report.html.report import write_report

    made = write_report(runs, output, top, episodes or [], suite_folder, what_if)
    if as_json:
        end_with_json(made)
    say(
        f"{output}: {counted(len(runs), 'run')}, {counted(len(made['replays']), 'replay')}, "
        f"{made['bytes'] / 1e6:z.1f} MB"
    )


@app.command(rich_help_panel=arguments.EVALUATE)
def audit(
    run: arguments.RunPath,
    everything: bool = Option(
        False, "--all", help="Simulate every shard again, not only a sample."
    ),
    shards: int = Option(10, min=1, help="Number of shards to simulate again."),
    seed: int | None = Option(
        None, min=0, help="Seed that chooses the shards; by default, a new one."
    ),
    workers: arguments.Workers = None,
    suite_folder: arguments.SuiteFolder = Path(),
    as_json: arguments.Json = False,
) -> None:
    """Check the rows, tables and networks of a run.

    Some shards are simulated again, and all tables are computed again. The exit code is 0 if
    every check passes, 1 if a check fails, and 3 if a check cannot be made with the installed
    software.
    """
    chosen = None if everything else shards
    with interruptible():
        found = charms_bench.audit(
            run, shards=chosen, seed=seed, workers=workers, suite_folder=suite_folder
        )
    code, verdict = VERDICTS[found.verdict]
    if as_json:
        facts = {"verdict": found.verdict, "undrawn": found.undrawn}
        end_with_json({**facts, "findings": found.table.records()}, code)
    for line in found.lines():
        say(line)
    missed = f"if one shard is false, it was missed with a probability of {found.undrawn:z.0%}"
    is_sample = 0 < found.undrawn < 1 and found.verdict != "fail"
    say(f"{run}: {verdict}{f'; {missed}' if is_sample else ''}")
    raise typer.Exit(code)
