"""`verify`, `bench` and `warm-up`: compare the engine with highway-env, and compile it."""

from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path

import typer
from typer import Option

import charms_bench
from charms_bench.cli import arguments
from charms_bench.cli.terminal import (
    FAIL,
    app,
    end_with_json,
    err,
    interruptible,
    print_records,
    say,
)
from charms_bench.errors import InputError, suggestion
from charms_bench.foundation.words import counted


@app.command(rich_help_panel=arguments.ENGINE)
def verify(
    suite: Path | None = Option(
        None, help="Compare the engines in this suite instead of the built-in cases."
    ),
    episodes: int | None = Option(None, min=1, max=1_000_000, help="Number of episodes per case."),
    seed: int = Option(0, min=0, max=2**62, help="Seed of the first episode."),
    continuous: bool = Option(
        False, "--continuous", help="Drive the egos with random accelerations and steering angles."
    ),
    road: str | None = Option(
        None,
        help="Compare one of highway-env's other environments, such as merge-v0, or the road in a "
        "file.",
    ),
    starts: bool = Option(
        False, "--starts", help="Compare only the starts of the episodes of --road."
    ),
    workers: arguments.Workers = None,
    as_json: arguments.Json = False,
) -> None:
    """Compare the compiled engines with highway-env's own vehicles.

    Both use the same elementary functions. The exit code is 1 if the engines differ.
    """
    from charms_bench.foundation.progress import progress
    from charms_bench.runs.document import Document
    from charms_bench.runs.suite import check_agents, suite_of
    from charms_bench.testing import parity
    from charms_bench.testing.verify import case_on, cases_of, default_cases

    if starts and road is None:
        raise InputError("--starts needs --road")
    cases: Sequence[parity.Case]
    if road is not None:
        if suite is not None or continuous:
            raise InputError("--road excludes --suite and --continuous")
        cases, count = [case_on(road)], 20
    elif suite is None:
        cases, count = default_cases(continuous)
    elif continuous:
        raise InputError("--suite and --continuous exclude each other; a suite names its egos")
    else:
        document = Document(suite)
        loaded = suite_of(document)
        check_agents(document, loaded)
        cases, count = cases_of(loaded), 10
    count = episodes or count
    charms_bench.warm_up()
    most = {"steps": 0} if starts else {}
    with progress("episodes", count * len(cases)) as bar:
        seeds = range(seed, seed + count)
        found = parity.verify(cases, seeds, workers, lambda done: bar("", done), **most)
    differing = sum(len(each.differences) for each in found)
    code = FAIL if differing else 0
    records = [asdict(each) for each in found]
    if as_json:
        end_with_json(records, code)
    forms = dict.fromkeys(("episodes", "steps", "crashed", "differing"), ",.0f")
    forms |= {"largest": ".1e", "largest_at_start": ".1e"}
    counts = [each | {"differing": len(each["differences"])} for each in records]
    print_records("case", counts, forms)
    for each in found:
        for difference in each.differences:
            say(f"{each.case}: {difference}")
    total = counted(sum(each.episodes for each in found), "episode")
    verdict = f"{differing} of {total} differ" if differing else "the engines agree"
    say(f"{total}: {verdict}.")
    raise typer.Exit(code)


def _known(road: str) -> str:
    """The name of an environment that can be simulated."""
    from charms_bench.roads import TASKS

    if road not in TASKS:
        raise InputError(f"--road: no environment named '{road}'. {suggestion(road, TASKS)}")
    return road


@app.command("warm-up", rich_help_panel=arguments.ENGINE)
def compile_engine() -> None:
    """Compile the engine before the first run.

    It is compiled once for each installation, for the processor of this machine.
    """
    with interruptible():
        compiled = charms_bench.warm_up()
    say("The engine is compiled." if compiled else "The engine was compiled before.")


@app.command(rich_help_panel=arguments.ENGINE)
def bench(
    context: typer.Context,
    vehicles: int = Option(21, min=6, max=2001, help="Vehicles per scene, including the ego."),
    traffic: str = Option("idm_mobil", help="Traffic model of the compiled engine."),
    seconds: float = Option(2.0, min=0.1, max=3600, help="Duration of each measurement."),
    rounds: int = Option(3, min=1, max=1000, help="Number of measurements per engine."),
    environments: int | None = Option(
        None,
        min=1,
        max=10_000,
        help="Measure Gymnasium vector environments of this size instead of engines.",
    ),
    learners: bool = Option(
        False,
        help="Measure environments in which a program drives all vehicles with random actions; "
        "the speed is in decisions of vehicles per second.",
    ),
    road: str | None = Option(
        None,
        help="Measure one of highway-env's other environments, such as merge-v0, instead of the "
        "motorway.",
    ),
    scale: Path | None = Option(
        None,
        callback=arguments.FIGURE,
        help="Measure the compiled engine with 1 to all cores, 21 to 2,000 vehicles and 1 to "
        "100,000 scenes instead, and draw the speeds to this file (.pdf, .png or .svg).",
    ),
    as_json: arguments.Json = False,
) -> None:
    """Measure environment steps and vehicle updates per second.

    The command measures the compiled engine, highway-env and, if it is installed, EnvPool. An
    environment step is one decision of the ego. A vehicle update is one simulation step of one
    vehicle.
    """
    from charms_bench.testing import bench as benchmark

    def tell(name: str) -> None:
        err().print(f"[dim]{name}[/]", highlight=False)

    if road is not None:
        _check_excluded(context, "--road", "vehicles", "traffic", "learners", "scale")
        records = benchmark.bench_road(_known(road), seconds, rounds, tell, environments or 100)
        forms = dict.fromkeys(("decisions_per_s", "low", "high", "times_highway_env"), ",.1f")
        print_records("name", records, {"environments": ",.0f", **forms}, as_json)
        return
    if scale is not None:
        _check_excluded(context, "--scale", "vehicles", "traffic", "environments", "learners")
    charms_bench.warm_up()
    forms = {"vehicles": ",.0f", "threads": ".0f", "steps_per_s": ",.0f"}
    forms |= {"vehicle_updates_per_s": ",.0f", "ns_per_vehicle_step": ",.1f"}
    if scale is not None:
        from charms_bench.report.figures.drawing import save
        from charms_bench.report.figures.scale import draw_scale

        records = [each.record() for each in benchmark.scale(seconds, rounds, tell)]
        save(draw_scale(records), scale)
        print_records("name", records, {"scenes": ",.0f", **forms}, as_json)
        return
    results = benchmark.bench(vehicles, traffic, seconds, rounds, tell, environments, learners)
    base = next(r.steps_per_s for r in results if r.name == "highway-env")
    pool = {(r.threads, r.vehicles): r.steps_per_s for r in results if r.name == "EnvPool"}
    records = []
    for r in results:
        times: dict[str, float | None] = {"times_highway_env": r.steps_per_s / base}
        if learners:
            speeds = {"decisions_per_s": r.steps_per_s, "low": r.low, "high": r.high}
            records.append({"name": r.name, "threads": r.threads, **speeds, **times})
        else:
            rival = pool.get((r.threads, r.vehicles))
            times["times_envpool"] = rival and r.steps_per_s / rival
            records.append(r.record() | times)
    if learners:
        forms = {"threads": ".0f"} | dict.fromkeys(("decisions_per_s", "low", "high"), ",.0f")
    forms |= {"times_highway_env": ",.1f"} | ({} if learners else {"times_envpool": ".2f"})
    print_records("name", records, forms, as_json)


def _check_excluded(context: typer.Context, option: str, *others: str) -> None:
    """Raises an `InputError` if one of the others is given, which would have no effect."""
    for other in others:
        source = context.get_parameter_source(other)
        if source is not None and source.name == "COMMANDLINE":
            raise InputError(f"{option} excludes --{other}")
