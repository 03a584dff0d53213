"""The groups of commands, and the arguments and options that several commands have."""

from collections.abc import Callable
from pathlib import Path
from typing import Annotated

from typer import Argument, Option

from charms_bench.cli.terminal import print_only_json
from charms_bench.errors import InputError
from charms_bench.foundation.files import absolute, check_ending, reject_foreign

EVALUATE = "Evaluate"
FAILURES = "Find and explain failures"
AGENTS = "Agents and traffic models"
ENGINE = "The engine"
DATA = "Human driving and datasets"
ROADS = "Roads"
"""The groups of commands in `--help`, each a command's `rich_help_panel`."""
Json = Annotated[
    bool, Option("--json", callback=print_only_json, help="Print only JSON on standard output.")
]
Workers = Annotated[
    int | None,
    Option(min=1, max=1024, help="Number of worker processes; the default is one per core."),
]
MetricSets = Annotated[
    list[str] | None,
    Option(
        "--set",
        metavar="NAME[:OPTION=VALUE,...]",
        help="Metric set, e.g. standard:ttc_s=2; repeat for more. The default is paper and "
        "standard.",
    ),
]
RunPath = Annotated[Path, Argument(metavar="RUN", help="Folder of a finished run.")]
EgoLabel = Annotated[
    str | None, Option("--ego", help="Select the ego with this label in the tables.")
]
TrafficLabel = Annotated[
    str | None, Option("--traffic", help="Select the traffic model with this label.")
]
RoadLabel = Annotated[str | None, Option("--road", help="Select the road with this label.")]
EgoAgents = Annotated[
    list[str] | None,
    Option(
        "--agent",
        help="Installed agent, or ONNX file of a network, that drives the ego besides the suite's "
        "egos; repeat for more.",
    ),
]
AnySuite = Annotated[
    Path, Argument(metavar="SUITE", help="YAML file, or a name that `suites` lists.")
]
SuiteFolder = Annotated[Path, Option(help="Folder that relative paths in the suite refer to.")]
Recordings = Annotated[
    Path,
    Argument(
        metavar="RECORDINGS",
        help="Folder of recordings in highD's format, CSV table of NGSIM, or the Parquet table "
        "of I-24 or I-75.",
    ),
]


def ending_in(*endings: str, is_new: bool = False) -> Callable[[Path | None], Path | None]:
    """Makes the path of an option absolute; an `InputError` if its name has another ending.

    A file that exists is an error if it `is_new`, or if others have written it.
    """

    def checked(path: Path | None) -> Path | None:
        if path is None:
            return None
        check_ending(path, *endings)
        if is_new and path.exists():
            raise InputError(f"{path}: exists already; expected the name of a new file")
        path = absolute(path)
        reject_foreign(path)
        return path

    return checked


NEW_JSON, FIGURE = ending_in(".json", is_new=True), ending_in(".pdf", ".png", ".svg")
GIF, HTML, XML = ending_in(".gif"), ending_in(".html", ".htm"), ending_in(".xml")
FigurePath = Annotated[
    Path | None,
    Option("--figure", callback=FIGURE, help="Draw a figure into this .png, .pdf or .svg file."),
]
