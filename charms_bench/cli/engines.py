"""`verify` and `bench`: the compiled engine against highway-env."""

import json
from pathlib import Path
from typing import Annotated, Any

import typer

from charms_bench.cli.terminal import Json, Workers, app, err, out, plain, progress


@app.command()
def verify(
    suite: Annotated[
        Path | None, typer.Option(help="Compare a suite's cells, not the built-in cases.")
    ] = None,
    episodes: Annotated[
        int | None, typer.Option(min=1, max=1_000_000, help="Episodes of every case.")
    ] = None,
    seed: Annotated[int, typer.Option(min=0, max=2**62, help="The first episode's seed.")] = 0,
    workers: Workers = None,
    as_json: Json = False,
) -> None:
    """Compare the compiled engine with highway-env, step for step; exit code 1 when they differ."""
    from dataclasses import asdict

    from charms_bench.runs.suite import load_suite
    from charms_bench.testing import verify as verification

    if suite is None:
        cases, count = verification.default_cases()
    else:
        cases, count = verification.cases_of(load_suite(suite)), 10
    count = episodes or count
    with progress("episodes", count * len(cases)) as bar:
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
            plain(r.case.title),
            *(f"{n:,}" for n in (r.episodes, r.steps, r.lane_changes, r.crashed)),
            f"{r.largest:.1e}",
            str(len(r.differences)),
        )
    out.print(table)
    for r in results:
        for d in r.differences:
            out.print(
                f"{plain(r.case.title)}: episode {d.episode}, simulation step {d.step}, "
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
    vehicles: Annotated[int, typer.Option(min=6, max=500, help="The ego included.")] = 21,
    traffic: Annotated[str, typer.Option(help="The traffic of this engine.")] = "idm_mobil",
    seconds: Annotated[float, typer.Option(min=0.1, max=3600, help="Of every measurement.")] = 2.0,
    rounds: Annotated[
        int, typer.Option(min=1, max=1000, help="Measurements of each contestant.")
    ] = 3,
    environments: Annotated[
        int | None,
        typer.Option(
            min=1, max=10_000, help="Gymnasium's vector environments instead, of so many each."
        ),
    ] = None,
    as_json: Json = False,
) -> None:
    """Measure environment steps a second: this engine, highway-env and, if installed, EnvPool."""
    from dataclasses import asdict

    from rich.table import Table

    from charms_bench.testing.bench import bench as measure
    from charms_bench.testing.bench import bench_environments

    def tell(name: str) -> None:
        err.print(f"[dim]{name}[/]", highlight=False)

    if environments:
        results = bench_environments(environments, vehicles, traffic, seconds, rounds, tell)
    else:
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
