"""`compare`: two agents over the same episodes."""

import json
from pathlib import Path
from typing import Annotated

import typer

from charms_bench.cli.terminal import Json, MetricSets, app, out


@app.command()
def compare(
    first: Annotated[Path, typer.Argument(metavar="RUN_A", help="The folder of a finished run.")],
    second: Annotated[
        Path | None, typer.Argument(metavar="[RUN_B]", help="Another run of the same episodes.")
    ] = None,
    agents: Annotated[
        tuple[str, str] | None,
        typer.Option(
            metavar="A B", help="Egos, as tables call them: of RUN_A, and of RUN_B if there is one."
        ),
    ] = None,
    metrics: Annotated[
        list[str] | None,
        typer.Option(
            "--metric",
            help="Only this one; may be given again. Fewer tests find more: "
            "choose before you look.",
        ),
    ] = None,
    metric_sets: MetricSets = None,
    as_json: Json = False,
) -> None:
    """Say in which metrics two agents differ by more than chance, and by how much."""
    from charms_bench.report.comparison import by_pair, to_dicts
    from charms_bench.report.comparison import compare as compare_cells
    from charms_bench.report.terminal import grid
    from charms_bench.runs.finished import open_finished
    from charms_bench.runs.metric_sets import metric_sets as find
    from charms_bench.runs.pairing import pairs_of

    sets = find(metric_sets or [])
    one = open_finished(first)
    pairs = pairs_of(one, None if second is None else open_finished(second), agents)
    table = compare_cells(pairs, sets, one.suite.scene, one.suite.seed, metrics or ())
    if as_json:
        print(json.dumps(to_dicts(table), indent=2, ensure_ascii=False))
        return
    for part in by_pair(table):
        out.print(grid(part, out.width, stacked=False))
