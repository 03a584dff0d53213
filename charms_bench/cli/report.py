"""`report`: runs as one HTML file."""

import json
from pathlib import Path
from typing import Annotated

import typer

from charms_bench.cli.terminal import Json, app, out, plain


@app.command()
def report(
    runs: Annotated[
        list[Path],
        typer.Argument(metavar="RUN...", help="Folders of finished runs, trainings among them."),
    ],
    output: Annotated[
        Path, typer.Option("--output", "-o", metavar="OUT.html", help="The file.")
    ] = Path("report.html"),
    top: Annotated[
        int, typer.Option(min=0, max=100, help="Replays of that many most critical episodes.")
    ] = 10,
    episodes: Annotated[
        list[str] | None,
        typer.Option(
            "--episode",
            metavar="RUN:EPISODE[:EGO[:TRAFFIC]]",
            help="A replay of this one, too; may be given again.",
        ),
    ] = None,
    suite_folder: Annotated[
        Path, typer.Option(help="Where the suites were, at which paths in them start.")
    ] = Path(),
    as_json: Json = False,
) -> None:
    """Write tables, figures and replays of runs into one HTML file, which needs nothing else."""
    from charms_bench.report.html.report import write_report

    made = write_report(runs, output, top, episodes or [], suite_folder)
    if as_json:
        print(json.dumps(made, indent=2, ensure_ascii=False))
        return
    out.print(
        f"{plain(str(output))}: {len(runs)} run{'s' * (len(runs) > 1)}, "
        f"{len(made['replays'])} replays, {made['bytes'] / 1e6:.1f} MB",
        highlight=False,
        soft_wrap=True,
    )
