"""`rescore`: a run's metrics again, from its rows."""

import json
from pathlib import Path
from typing import Annotated

import typer

from charms_bench.cli.terminal import Json, MetricSets, app, out, plain


@app.command()
def rescore(
    run: Annotated[Path, typer.Argument(metavar="RUN", help="The folder of a finished run.")],
    metric_sets: MetricSets = None,
    as_json: Json = False,
) -> None:
    """Compute a run's metrics again from its rows, and write its tables again; no simulation."""
    from charms_bench.report.run_files import write_table
    from charms_bench.report.suite_table import shown_metrics, suite_table
    from charms_bench.report.terminal import grid
    from charms_bench.runs.finished import open_finished
    from charms_bench.runs.lock import locked
    from charms_bench.runs.metric_sets import metric_sets as find

    sets = find(metric_sets or [])
    opened = open_finished(run)
    suite = opened.suite
    with locked(run):
        table = suite_table(suite, opened.cells(), sets)
        rest = write_table(run, table)
    if as_json:
        print(json.dumps(table.frame().to_dicts(), indent=2))
        return
    shown = table if metric_sets else table.select(*shown_metrics(table, suite.columns))
    out.print(grid(shown.without_constant_keys(), out.width))
    out.print(f"All metrics: {plain(str(rest))}", highlight=False, soft_wrap=True)
