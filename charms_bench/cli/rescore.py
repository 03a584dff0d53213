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
    from charms_bench.report.tables import build_table, render_terminal, write_tables
    from charms_bench.runs.finished import open_finished
    from charms_bench.runs.lock import locked
    from charms_bench.runs.metric_sets import metric_sets as find

    sets = find(metric_sets or [])
    opened = open_finished(run)
    suite = opened.suite
    with locked(run):
        table = build_table(opened.cells(), suite.scene, suite.seed, sets)
        write_tables(run / "tables", suite.suite, table, sets)
    if as_json:
        print(json.dumps(table.to_dicts(), indent=2))
        return
    everything = table["metric"].unique(maintain_order=True).to_list()
    out.print(render_terminal(table, everything if metric_sets else suite.columns, out.width))
    rest = run / "tables" / f"{suite.suite}.md"
    out.print(f"All metrics: {plain(str(rest))}", highlight=False, soft_wrap=True)
