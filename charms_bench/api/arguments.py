"""What the functions of the Python interface take."""

from collections.abc import Sequence
from pathlib import Path

from charms_bench.errors import InputError
from charms_bench.foundation.files import absolute
from charms_bench.foundation.names import name_of_agent
from charms_bench.plugins.registry import AGENTS, find
from charms_bench.runs.document import Document
from charms_bench.runs.suite import Suite, check_agents, suite_of

PathLike = str | Path


def check_positive(**options: float | None) -> None:
    """Raises an `InputError` if one of the options is given and not above 0."""
    for name, value in options.items():
        if value is not None and value <= 0:
            raise InputError(f"{name} is {value}; expected a number above 0")


def asked(
    suite: PathLike,
    output: PathLike | None,
    agents: Sequence[str],
    kind: str = "",
    **changes: int | None,
) -> tuple[Document, Suite, str, Path]:
    """Reads a suite with some keys changed and agents added to its egos.

    Returns also the folder's name by default, in which `kind` follows that of the suite, and the
    folder. A `CharmsBenchError` says why the suite, an agent or a network cannot be used.
    """
    document = evaluation_in(suite)
    document.data |= {key: value for key, value in changes.items() if value is not None}
    added = [ego_entry(agent) for agent in agents]
    if added and isinstance(document.data.get("egos"), list):
        document.data["egos"] = document.data["egos"] + added
    # Before plugins are imported, which can change the current folder.
    place = absolute(output or "runs")
    loaded = suite_of(document)
    check_agents(document, loaded)
    name = "-".join((loaded.suite + kind, *(name_of_agent(ego["label"]) for ego in added)))
    return document, loaded, name, place if output else place / name


def evaluation_in(suite: PathLike) -> Document:
    """The document of a suite; raises an `InputError` if it is one of a training."""
    document = Document(Path(suite))
    if "pipeline" in document.data:
        raise InputError(f"{suite}: is a training suite; use charms_bench.train")
    return document


def ego_entry(agent: str) -> dict[str, str]:
    """The entry of a suite for an installed agent or a network's path; raises an `InputError`."""
    path = Path(agent)
    if path.suffix != ".onnx":
        return {"agent": find(AGENTS, agent).name, "label": agent}
    if not path.is_file():
        raise InputError(f"{agent}: {'is not a file' if path.exists() else 'no such file'}")
    return {"agent": str(absolute(path)), "label": path.stem}
