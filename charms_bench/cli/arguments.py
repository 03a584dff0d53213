"""The groups of commands, and the arguments and options that several commands have."""

from pathlib import Path
from typing import Annotated

import typer

from charms_bench.cli.terminal import print_only_json
from charms_bench.foundation.files import absolute, reject_foreign

EVALUATE = "Evaluate"
FAILURES = "Find and explain failures"
AGENTS = "Agents and traffic models"
ENGINE = "The engine"
DATA = "Human driving and datasets"
ROADS = "Roads"
"""The groups of commands in `--help`, each a command's `rich_help_panel`."""
Json = Annotated[
    bool,
    typer.Option("--json", callback=print_only_json, help="Print only JSON on standard output."),
]
Workers = Annotated[
    int | None,
    typer.Option(min=1, max=1024, help="Number of worker processes; the default is one per core."),
]
MetricSets = Annotated[
    list[str] | None,
    typer.Option(
        "--set",
        metavar="NAME[:OPTION=VALUE,...]",
        help="Metric set, e.g. standard:ttc_s=2; repeat for more. The default is paper and "
        "standard.",
    ),
]
RunPath = Annotated[Path, typer.Argument(metavar="RUN", help="Folder of a finished run.")]
EgoLabel = Annotated[
    str | None, typer.Option("--ego", help="Select the ego with this label in the tables.")
]
TrafficLabel = Annotated[
    str | None, typer.Option("--traffic", help="Select the traffic model with this label.")
]
RoadLabel = Annotated[str | None, typer.Option("--road", help="Select the road with this label.")]
EgoAgents = Annotated[
    list[str] | None,
    typer.Option(
        "--agent",
        help="Installed agent, or ONNX file of a network, that drives the ego besides the suite's "
        "egos; repeat for more.",
    ),
]
AnySuite = Annotated[
    Path, typer.Argument(metavar="SUITE", help="YAML file, or a name that `suites` lists.")
]
SuiteFolder = Annotated[
    Path, typer.Option(help="Folder that relative paths in the suite refer to.")
]
Recordings = Annotated[
    Path,
    typer.Argument(
        metavar="RECORDINGS",
        help="Folder of recordings in highD's format, CSV table of NGSIM, or the Parquet table "
        "of I-24 or I-75.",
    ),
]


def drawable(path: Path | None) -> Path | None:
    """The absolute path of a figure; an `InputError` if it cannot be written there."""
    if path is None:
        return None
    from charms_bench.report.figures.drawing import check_figure

    check_figure(path)
    path = absolute(path)
    reject_foreign(path)
    return path


FigurePath = Annotated[
    Path | None,
    typer.Option(
        "--figure", callback=drawable, help="Draw a figure into this .png, .pdf or .svg file."
    ),
]
