"""`rare`: the probability of an event that almost never happens."""

from pathlib import Path

import typer

import charms_bench
from charms_bench.cli.terminal import (
    FAILURES,
    AnySuite,
    EgoAgents,
    Json,
    Workers,
    app,
    end_with_json,
    interruptible,
    print_table,
    say,
    shown,
)


@app.command(rich_help_panel=FAILURES)
def rare(
    suite: AnySuite,
    agents: EgoAgents = None,
    event: str = typer.Option(
        "crash",
        metavar="NAME[:OPTION=VALUE,...]",
        help="Event: crash, ttc:below_s=1.0, or an event of a plugin.",
    ),
    runs: int = typer.Option(
        10,
        help="Independent runs per ego and traffic model, 5 to 1,000; more runs give a "
        "narrower interval.",
    ),
    samples: int = typer.Option(
        1000, help="Episodes per level of a run, a multiple of 5, at least 100."
    ),
    seed: int | None = typer.Option(
        None, min=0, help="Seed of all random draws; overrides the suite."
    ),
    workers: Workers = None,
    output: Path | None = typer.Option(
        None, help="Folder; the default is runs/SUITE-rare-EVENT, and each --agent."
    ),
    as_json: Json = False,
) -> None:
    """Estimate the probability of a rare event, such as a crash.

    The command uses subset simulation. The column `plain episodes` shows how many episodes of plain
    simulation would give an interval as narrow. Finished runs are not repeated.
    """
    with interruptible():
        made = charms_bench.rare(
            suite,
            event,
            output,
            agents=agents or (),
            runs=runs,
            samples=samples,
            seed=seed,
            workers=workers,
        )
    if as_json:
        end_with_json(made.table.frame().to_dicts())
    print_table(made.table.without_constant_keys(), stacked=True)
    say(f"Written: {', '.join(map(shown, made.files))}")
