"""Writes a report: one HTML file from run folders."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from charms_bench.episodes.ego_view import ego_view
from charms_bench.errors import InputError
from charms_bench.foundation.files import absolute, check_ending, reject_foreign, write_bytes
from charms_bench.report.html.chosen import asked, choose, choose_beside, futures
from charms_bench.report.html.episode import for_page
from charms_bench.report.html.packed import pack
from charms_bench.report.html.page import ENDINGS, render
from charms_bench.report.html.sections import section_of, what_if_section
from charms_bench.report.html.sources import Evaluation, Source, open_sources


def write_report(
    paths: Sequence[Path],
    output: Path,
    top: int,
    episodes: Sequence[str],
    suite_folder: Path,
    what_if: str | None = None,
) -> dict[str, Any]:
    """Writes the report of some run folders, in their order; returns what it contains, for JSON.

    It replays the `top` most critical episodes of all runs and those in `episodes`, written
    RUN:EPISODE[:EGO[:TRAFFIC]], of which `what_if` shows another future, STEP:AGENT[:VEHICLE].
    Relative paths in suites start at `suite_folder`. A `CharmsBenchError` says what cannot be used.
    """
    check_ending(output, *ENDINGS)
    reject_foreign(output)
    page_path, suite_folder = absolute(output), absolute(suite_folder)
    sources = open_sources(paths)
    runs = [source for source in sources if isinstance(source, Evaluation)]
    if episodes and not runs:
        raise InputError("--episode needs an evaluation; none of these folders holds one")
    named = [asked(text, runs) for text in episodes]
    others = {} if what_if is None else futures(what_if, runs, named, suite_folder)
    chosen = choose(runs, top, named, suite_folder)
    shown = [
        for_page(name, each, others[name].other if name in others else None)
        for name, _, each in chosen
    ]
    more = choose_beside(runs, chosen, suite_folder)
    others_packed = {name: pack(each, ego_view(each)) for name, _, each in more}
    packed = {each["id"]: each["packed"] for each in shown} | others_packed
    for name, (index, _, seed), each in (*chosen, *more):
        place = runs[index].run.suite.surroundings.index(each.cell.surroundings)
        packed[name] |= {"title": each.cell.title, "scene": [index, place, seed]}
    sections = [section_of(source, suite_folder) for source in sources]
    sections += [what_if_section(each, f"what-if-{name}") for name, each in others.items()]
    page = render(
        sections,
        sections[0].title if len(sources) == 1 else "Driving behaviour, measured",
        shown,
        beside=others_packed,
        named=len(named),
        has_ghosts=bool(others),
        provenance=[_provenance(source) for source in sources],
    ).encode(errors="replace")  # the name of a folder need not be UTF-8
    write_bytes(page_path, page)
    return {
        "report": str(output),
        "bytes": len(page),
        "runs": [str(path) for path in paths],
        "replays": [each["id"] for each in shown],
    }


def _provenance(source: Source) -> dict[str, Any]:
    """Where a run comes from, according to its manifest."""
    facts: dict[str, Any] = {"folder": source.path.name}
    manifest: Mapping[str, Any] = {}
    if isinstance(source, Evaluation):
        manifest = source.run.folder.manifest()
        versions = {"charms-bench": manifest.get("charms_bench"), **manifest.get("versions", {})}
        machine = manifest.get("machine", {})
        facts |= {
            "suite's hash": manifest.get("suite_sha256"),
            "versions": ", ".join(f"{name} {version}" for name, version in versions.items()),
            "machine": ", ".join(f"{name} {value}" for name, value in machine.items()),
        }
    return {"name": source.key, "facts": facts, "agents": manifest.get("agents", {})}
