"""Writes a report: one HTML file from run folders."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from charms_bench import __version__
from charms_bench.episodes.criticality import criticality
from charms_bench.episodes.ego_view import ego_view
from charms_bench.episodes.replay import Replay
from charms_bench.errors import InputError
from charms_bench.report.figures.timelines import LEFT, RIGHT, draw_timelines
from charms_bench.report.html.episodes import asked, choose
from charms_bench.report.html.packed import pack
from charms_bench.report.html.page import render
from charms_bench.report.html.sections import evaluation_section, training_section
from charms_bench.report.html.sources import Evaluation, TrainingFolder, open_sources
from charms_bench.report.html.svg import in_page
from charms_bench.world.files import write_bytes


def write_report(
    paths: Sequence[Path], output: Path, top: int, episodes: Sequence[str], suite_folder: Path
) -> dict[str, Any]:
    """Writes the report of some run folders.

    Args:
        paths: The run folders, in the order of the report.
        output: The HTML file.
        top: How many of the most critical episodes of all runs to replay.
        episodes: More episodes, as RUN:EPISODE[:EGO[:TRAFFIC]].
        suite_folder: Where relative paths of networks and recordings in suites start.

    Returns:
        What the file contains, for JSON.

    Raises:
        CharmsBenchError: A folder or an episode cannot be used, or the file cannot be written.
    """
    if output.suffix.lower() not in (".html", ".htm"):
        raise InputError(f"{output}: expected a name that ends in .html")
    sources = open_sources(paths)
    runs = [source for source in sources if isinstance(source, Evaluation)]
    if episodes and not runs:
        raise InputError("--episode needs an evaluation; none of these folders holds one")
    named = [asked(text, runs) for text in episodes]
    shown = [for_page(*each) for each in choose(runs, top, named, suite_folder)]
    sections = [
        evaluation_section(source, suite_folder)
        if isinstance(source, Evaluation)
        else training_section(source)
        for source in sources
    ]
    page = render(
        sections,
        title=sections[0].title if len(sections) == 1 else "Driving behaviour, measured",
        replays=shown,
        packed={each["id"]: each.pop("packed") for each in shown},
        named=len(named),
        what_if=False,
        provenance=[_provenance(source) for source in sources],
        version=__version__,
        cursor_from=LEFT,
        cursor_to=RIGHT,
    ).encode()
    write_bytes(output, page)
    return {
        "report": str(output),
        "bytes": len(page),
        "runs": [str(path) for path in paths],
        "replays": [each["id"] for each in shown],
    }


def for_page(name: str, replay: Replay, ghosts: Replay | None = None) -> dict[str, Any]:
    """An episode for the page's templates and player; another future is drawn as ghosts."""
    view, ego, traffic = ego_view(replay), replay.cell.ego.title, replay.cell.traffic.title
    measured = criticality(replay.episodes, replay.steps, replay.settings)["criticality"].item()
    label = (
        "Over time: gaps ahead and behind, time to collision, speed and reward of "
        f"{ego} in {traffic}, episode {replay.episode}"
    )
    return {
        "id": name,
        "ego": ego,
        "traffic": traffic,
        "episode": replay.episode,
        "criticality": f"{measured:.2f}",
        "what": replay.what_happened(),
        "seconds": f"{replay.t_s[-1]:.1f}",
        "timelines": in_page(draw_timelines(replay, view), f"replay-{name}", label),
        "packed": pack(replay, view, ghosts),
    }


def _provenance(source: Evaluation | TrainingFolder) -> dict[str, Any]:
    """Where a run comes from, according to its manifest."""
    if isinstance(source, TrainingFolder):
        return {"name": source.key, "facts": {"folder": source.path.name}, "agents": {}}
    manifest = source.run.folder.manifest()
    versions = {"charms-bench": manifest.get("charms_bench"), **manifest.get("versions", {})}
    machine = manifest.get("machine", {})
    return {
        "name": source.key,
        "facts": {
            "folder": source.path.name,
            "engine": manifest.get("engine"),
            "suite's hash": manifest.get("suite_sha256"),
            "versions": ", ".join(f"{name} {version}" for name, version in versions.items()),
            "machine": ", ".join(f"{name} {value}" for name, value in machine.items()),
        },
        "agents": manifest.get("agents", {}),
    }
