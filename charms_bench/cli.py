"""The command line. Heavy imports stay inside commands, so that `--help` is quick."""

import json
import os
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer
from rich.console import Console

from charms_bench.errors import CharmsBenchError, InputError

if TYPE_CHECKING:
    from rich.progress import Progress

app = typer.Typer(
    name="charms-bench",
    help="Benchmark driving behaviour on highway-env's motorway, compiled.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)
out = Console()
err = Console(stderr=True)

Json = Annotated[bool, typer.Option("--json", help="Print nothing but JSON on standard output.")]
Workers = Annotated[
    int | None, typer.Option(min=1, max=1024, help="Processes; by default one a core.")
]
SuiteFile = Annotated[Path, typer.Argument(metavar="SUITE", help="The suite's YAML file.")]


def main() -> None:
    """Runs the command line; a user's mistake is a message and exit code 2."""
    try:
        app()
    except CharmsBenchError as error:
        err.print(f"[bold red]error:[/] {_plain(str(error))}", soft_wrap=True, highlight=False)
        sys.exit(2)
    except BrokenPipeError:  # whoever reads has seen enough, `charms-bench ... | head`
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        sys.exit(1)


@app.command()
def run(
    suite: SuiteFile,
    episodes: Annotated[
        int | None, typer.Option(min=1, help="Episodes of every cell, instead of the suite's.")
    ] = None,
    workers: Workers = None,
    engine: Annotated[
        Literal["batched", "highway-env"], typer.Option(help="highway-env is the slow reference.")
    ] = "batched",
    seed: Annotated[
        int | None, typer.Option(min=0, help="First episode's seed, instead of the suite's.")
    ] = None,
    output: Annotated[
        Path | None, typer.Option(help="The run folder; by default runs/SUITE.")
    ] = None,
    only: Annotated[
        str | None, typer.Option(help="One stage of a training suite, with what it needs.")
    ] = None,
    recordings: Annotated[
        Path | None, typer.Option(help="Human driving to train on, instead of the suite's folder.")
    ] = None,
    as_json: Json = False,
) -> None:
    """Run a suite, or go on with it: what is finished is never run again."""
    from charms_bench.document import Document

    document = Document(suite)
    if "pipeline" in document.data:
        refused = {"--episodes": episodes, "--seed": seed}
        for option in (name for name, value in refused.items() if value is not None):
            raise InputError(f"{option} is for evaluations; {suite} is a training")
        folder = output or Path("runs") / suite.stem
        _run_pipeline(document, folder, workers, only, recordings)
        return
    for option, given in {"--only": only, "--recordings": recordings}.items():
        if given is not None:
            raise InputError(f"{option} is for trainings; {suite} is an evaluation")

    from charms_bench import runner
    from charms_bench.report.pairs import write_pairs
    from charms_bench.report.tables import build_table, render_terminal, write_tables
    from charms_bench.suite import suite_of

    loaded = suite_of(document)
    changes = {"episodes": episodes, "seed": seed}
    loaded = loaded.model_copy(update={k: v for k, v in changes.items() if v is not None})
    folder = output or Path("runs") / loaded.suite
    total = loaded.episodes * len(loaded.cells)
    with _interruptible(f"finished shards are in {folder}"), _progress("episodes", total) as bar:
        finished = runner.run(
            loaded, folder, engine, workers, lambda cell, count: bar(cell.ego.title, count)
        )
    cells = finished.cells()
    table = build_table(cells, loaded.scene, loaded.seed)
    write_tables(folder / "tables", loaded.suite, table)
    if loaded.pairs:
        write_pairs(folder / "tables", loaded.suite, cells, loaded.scene, loaded.seed)
    if as_json:
        print(json.dumps(table.to_dicts(), indent=2))
    else:
        if loaded.title:
            out.print(_plain(loaded.title), highlight=False)
        out.print(render_terminal(table, loaded.columns, out.width))
        rest = folder / "tables" / f"{loaded.suite}.md"
        out.print(f"All metrics: {_plain(str(rest))}", highlight=False, soft_wrap=True)
        if loaded.pairs:
            pairs = rest.with_name(f"{loaded.suite}-pairs.md")
            out.print(f"Pair by pair: {_plain(str(pairs))}", highlight=False, soft_wrap=True)


def _run_pipeline(
    document: Any, output: Path, workers: int | None, only: str | None, recordings: Path | None
) -> None:
    from charms_bench.registry import PIPELINES, load

    name = document.data["pipeline"]
    if not isinstance(name, str):
        raise document.error(("pipeline",), f"expected a name, found {name!r}")
    pipeline = load(PIPELINES, name)
    with _interruptible(f"checkpoints are in {output}"):
        pipeline(document.path, output, workers, only, recordings)


@app.command()
def agents(as_json: Json = False) -> None:
    """List the installed agents and traffics, without importing them."""
    from rich.table import Table

    from charms_bench.registry import AGENTS, TRAFFIC, plugins

    found = [*plugins(AGENTS).values(), *plugins(TRAFFIC).values()]
    if as_json:
        keys = ("name", "role", "version", "distribution")
        print(
            json.dumps([{key: getattr(plugin, key) for key in keys} for plugin in found], indent=2)
        )
        return
    table = Table("name", "role", "version", "distribution", box=None)
    for plugin in found:
        table.add_row(plugin.name, plugin.role, plugin.version, plugin.distribution)
    out.print(table)


@app.command()
def check(
    name: Annotated[str, typer.Argument(help="An agent or a traffic.")], as_json: Json = False
) -> None:
    """Hold a plugin against the contract; exit code 1 when it breaks a rule."""
    from charms_bench.registry import AGENTS, TRAFFIC, make_agent, make_traffic, plugins
    from charms_bench.testing import agent_rules, traffic_rules

    is_traffic = name in plugins(TRAFFIC) and name not in plugins(AGENTS)
    rules = traffic_rules(make_traffic(name)) if is_traffic else agent_rules(make_agent(name))
    results = []
    for rule in rules:
        try:
            rule()
            problem = ""
        except Exception as error:  # whatever a plugin does wrong is a finding
            problem = str(error) if isinstance(error, AssertionError) else repr(error)
        title = rule.__name__.replace("_", " ")
        results.append({"rule": title, "kept": not problem, "problem": problem})
        if not as_json:
            mark = "[red]broken[/]" if problem else "[green]kept[/]  "
            out.print(f"{mark} {title}{': ' * bool(problem)}{_plain(problem)}", highlight=False)
    if as_json:
        print(json.dumps(results, indent=2))
    if any(result["problem"] for result in results):
        raise typer.Exit(1)


@app.command()
def verify(
    suite: Annotated[
        Path | None, typer.Option(help="Compare a suite's cells, not the built-in cases.")
    ] = None,
    episodes: Annotated[int | None, typer.Option(min=1, help="Episodes of every case.")] = None,
    seed: Annotated[int, typer.Option(min=0, help="The first episode's seed.")] = 0,
    workers: Workers = None,
    as_json: Json = False,
) -> None:
    """Compare the compiled engine with highway-env, step for step; exit code 1 when they differ."""
    from dataclasses import asdict

    from charms_bench import verify as verification
    from charms_bench.suite import load_suite

    if suite is None:
        cases, count = verification.default_cases()
    else:
        cases, count = verification.cases_of(load_suite(suite)), 10
    count = episodes or count
    with _progress("episodes", count * len(cases)) as bar:
        results = verification.verify(cases, count, seed, workers, lambda done: bar("", done))
    differing = sum(len(result.differences) for result in results)
    if as_json:
        rows = [
            {"case": result.case.title, **asdict(result)} | {"case": result.case.title}
            for result in results
        ]
        print(json.dumps(rows, indent=2))
    else:
        _print_comparisons(results, differing)
    if differing:
        raise typer.Exit(1)


def _print_comparisons(results: Any, differing: int) -> None:
    from rich.table import Table

    table = Table(box=None, padding=(0, 1, 0, 0))
    for column in ("case", "episodes", "steps", "lane changes", "crashed", "largest", "differing"):
        table.add_column(column, justify="left" if column == "case" else "right")
    for r in results:
        table.add_row(
            _plain(r.case.title),
            *(f"{n:,}" for n in (r.episodes, r.steps, r.lane_changes, r.crashed)),
            f"{r.largest:.1e}",
            str(len(r.differences)),
        )
    out.print(table)
    for r in results:
        for d in r.differences:
            out.print(
                f"{_plain(r.case.title)}: episode {d.episode}, simulation step {d.step}, "
                f"vehicle {d.vehicle}: {d.quantity} {d.batched!r} (batched), "
                f"{d.highway_env!r} (highway-env)",
                highlight=False,
                soft_wrap=True,
            )
    total = sum(r.episodes for r in results)
    verdict = f"{differing} of {total:,} episodes differ" if differing else "the engines agree"
    out.print(f"{total:,} episodes: {verdict}.", highlight=False)


@app.command()
def bench(
    vehicles: Annotated[int, typer.Option(min=2, max=500, help="The ego included.")] = 21,
    traffic: Annotated[str, typer.Option(help="The traffic of this engine.")] = "idm_mobil",
    seconds: Annotated[float, typer.Option(min=0.1, help="Of every measurement.")] = 2.0,
    rounds: Annotated[int, typer.Option(min=1, help="Measurements of each contestant.")] = 3,
    as_json: Json = False,
) -> None:
    """Measure environment steps a second: this engine, highway-env and, if installed, EnvPool."""
    from dataclasses import asdict

    from rich.table import Table

    from charms_bench.bench import bench as measure

    def tell(name: str) -> None:
        if err.is_terminal:
            err.print(f"[dim]{name}[/]", highlight=False)

    results = measure(vehicles, traffic, seconds, rounds, tell)
    base = next(r.steps_per_s for r in results if r.name == "highway-env")
    rows = [
        asdict(r)
        | {
            "ns_per_vehicle_step": r.ns_per_vehicle_step,
            "times_highway_env": r.steps_per_s / base,
        }
        for r in results
    ]
    pool = [r for r in results if r.name == "EnvPool"]
    for row in rows:
        rival = next((r for r in pool if r.threads == row["threads"]), None)
        comparable = rival if rival and row["vehicles"] == rival.vehicles else None
        row["times_envpool"] = row["steps_per_s"] / comparable.steps_per_s if comparable else None
    if as_json:
        print(json.dumps(rows, indent=2))
        return
    table = Table(box=None)
    for column in ("engine", "vehicles", "threads", "steps/s", "x highway-env", "x EnvPool",
                   "ns/vehicle-step"):  # fmt: skip
        table.add_column(column, justify="left" if column == "engine" else "right")
    for row in rows:
        table.add_row(
            row["name"],
            str(row["vehicles"]),
            str(row["threads"]),
            f"{row['steps_per_s']:,.0f}",
            f"{row['times_highway_env']:,.1f}",
            f"{row['times_envpool']:.2f}" if row["times_envpool"] else "",
            f"{row['ns_per_vehicle_step']:,.1f}",
        )
    out.print(table)


@app.command()
def export(
    checkpoint: Annotated[Path, typer.Argument(help="A DQN's zip, as Stable-Baselines3 saves it.")],
    output: Annotated[Path, typer.Argument(metavar="OUT.onnx", help="The file to write.")],
    decision_hz: Annotated[
        float, typer.Option(min=0.001, max=1000, help="Decisions a second it was trained for.")
    ] = 3.0,
    style: Annotated[str, typer.Option(help="How it drives, in words, for the file.")] = "",
    as_json: Json = False,
) -> None:
    """Turn a trained network into an ONNX file, which drives in a suite as {onnx: OUT.onnx}."""
    from charms_bench.registry import EXPORTERS, load

    if output.suffix != ".onnx":
        raise InputError(f"{output}: expected a name that ends in .onnx")
    facts = {"decision_hz": f"{decision_hz:g}"} | ({"style": style} if style else {})
    made = load(EXPORTERS, "sb3")(checkpoint, output, facts)
    if as_json:
        print(json.dumps(made, indent=2))
        return
    sizes = " → ".join(map(str, made["sizes"]))
    out.print(
        f"{_plain(str(output))}: {sizes}, {made['activation']}; acts as {_plain(str(checkpoint))} "
        f"in {made['observations']:,} observations",
        highlight=False,
        soft_wrap=True,
    )


@app.command()
def data(
    folder: Annotated[Path, typer.Argument(help="Recordings in highD's format.")],
    figure: Annotated[
        Path | None, typer.Option(help="Draw them into this .png, .pdf or .svg.")
    ] = None,
    as_json: Json = False,
) -> None:
    """Say what recordings of human driving hold, and what can be learnt from them."""
    from charms_bench.human.highd import find_trios
    from charms_bench.human.samples import collect
    from charms_bench.human.survey import check_figure, draw, survey

    if figure is not None:
        check_figure(figure)
    with _progress("recordings", len(find_trios(folder))) as bar:
        collected = collect(folder, tell=lambda count: bar("", count))
    found = survey(collected)
    if figure is not None:
        draw(collected, figure)
    if as_json:
        print(json.dumps(found, indent=2))
        return
    _print_survey(found)
    if figure is not None:
        out.print(f"Figure: {_plain(str(figure))}", highlight=False, soft_wrap=True)


def _print_survey(found: dict[str, Any]) -> None:
    from rich.table import Table

    def quantiles(values: dict[str, float | None]) -> str:
        return ", ".join(
            f"{float(q):.0%} {value:.1f}" for q, value in values.items() if value is not None
        )

    rates = ", ".join(f"{rate:g}" for rate in found["frame_rates_hz"])
    lanes = ", ".join(f"{n} with {lanes} lanes" for lanes, n in found["carriageways"].items())
    sampled = found["sampled"]
    facts = {
        "recordings": f"{found['recordings']:,} at {rates} Hz, {found['recorded_h']:.2f} h",
        "vehicles": f"{found['cars']:,} cars, {found['trucks']:,} trucks, {found['rows']:,} rows",
        "carriageways": lanes,
        "lane changes": f"{found['lane_changes']:,}",
        "laneId against y": f"{found['lane_id_disagreements']:,} rows disagree",
        "speed, m/s": f"mean {found['speed_mean_mps']:.1f}; "
        + quantiles(found["speed_quantiles_mps"]),
        "lane offset, m": f"mean {found['offset_mean_m']:+.2f} to the right of the lane's centre",
        "following, m": quantiles(found["following_distance_m"]) or "nobody follows",
        "decisions": f"{found['decisions']:,}, of which {found['accepted']:,} are of use",
        "two intents": f"{found['two_intents']:.1%} of them",
        "samples": f"{sampled['training']:,} for training, {sampled['held_out']:,} held out",
    }
    table = Table(box=None, show_header=False)
    for fact, value in facts.items():
        table.add_row(fact, value)
    out.print(table)
    table = Table("label", box=None)
    table.add_column("all rows", justify="right")
    table.add_column("IDLE undersampled", justify="right")
    for action, share in found["label_shares"]["accepted"].items():
        table.add_row(action, f"{share:.1%}", f"{found['label_shares']['sampled'][action]:.1%}")
    out.print(table)
    table = Table("rejected because", box=None)
    table.add_column("rows", justify="right")
    for reason, count in found["rejected"].items():
        if count:
            table.add_row(reason, f"{count:,}")
    out.print(table)


@contextmanager
def _interruptible(what_is_left: str) -> Iterator[None]:
    """Turns Ctrl-C into a sentence about what is left, and exit code 130."""
    try:
        yield
    except KeyboardInterrupt:
        err.print(
            f"interrupted; {_plain(what_is_left)}, and the same command goes on from there",
            highlight=False,
        )
        raise typer.Exit(130) from None


@contextmanager
def _progress(unit: str, total: int) -> Iterator[Callable[[str, int], None]]:
    """A bar with rate and remaining time on a terminal; a line every tenth elsewhere."""
    if not err.is_terminal:
        yield _progress_lines(unit, total)
        return
    with _bar(unit) as progress:
        task = progress.add_task("", total=total)
        yield lambda what, count: progress.update(task, description=_plain(what), advance=count)


def _progress_lines(unit: str, total: int) -> Callable[[str, int], None]:
    done = 0

    def tell(what: str, count: int) -> None:
        nonlocal done
        before, done = done, done + count
        if before * 10 // total < done * 10 // total:
            err.print(f"{done:,} of {total:,} {unit}", highlight=False)

    return tell


def _bar(unit: str) -> "Progress":
    from rich.progress import (
        BarColumn,
        MofNCompleteColumn,
        Progress,
        ProgressColumn,
        TextColumn,
        TimeElapsedColumn,
        TimeRemainingColumn,
    )
    from rich.text import Text

    class Rate(ProgressColumn):
        def render(self, task: Any) -> Text:
            return Text(f"{task.speed:,.0f}/s" if task.speed else "")

    return Progress(
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TextColumn(unit),
        Rate(),
        TimeElapsedColumn(),
        TimeRemainingColumn(),
        console=err,
        transient=True,
    )


def _plain(text: str) -> str:
    """Text as it is: what users wrote is never markup."""
    from rich.markup import escape

    return escape(text)
