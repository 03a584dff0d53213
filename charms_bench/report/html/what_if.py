"""Writes two futures of an episode as one HTML file: their table, and a replay with ghosts."""

from pathlib import Path

from charms_bench.episodes.what_if import WhatIf
from charms_bench.foundation.files import write_bytes
from charms_bench.report.html.episode import for_page
from charms_bench.report.html.page import check_page, render
from charms_bench.report.html.sections import Section
from charms_bench.report.what_if_table import what_if_table


def write_what_if(found: WhatIf, path: Path) -> None:
    """Writes the page.

    Raises:
        InputError: The file's name does not end in `.html`.
        RunFolderError: It cannot be written.
    """
    check_page(path)
    section = what_if_section(found, "futures")
    shown = for_page(f"what-if-{found.recorded.episode}", found.recorded, found.other, found.step)
    page = render(
        [section],
        title=section.title,
        replays=[shown],
        packed={shown["id"]: shown.pop("packed")},
        named=1,
        is_report=False,
        has_ghosts=True,
        provenance=[],
    )
    write_bytes(path, page.encode())


def what_if_section(found: WhatIf, name: str) -> Section:
    """The section of two futures; links call it `name`."""
    recorded, table = found.recorded, what_if_table(found)
    happened, instead = found.sentences()
    facts = [recorded.cell.title, f"recorded: {happened}", f"what if: {instead}"]
    return Section(name, table.title, facts, [table], [])
