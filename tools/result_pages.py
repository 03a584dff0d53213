"""The tables of results in the readme and the pages."""

import re
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).parent.parent
RESULTS = ROOT / "docs" / "results"
"""The numbers of long tables, as CSV files."""
BLOCK = re.compile(
    r"(<!-- results: ([a-z0-9-]+) -->\n\n)(.*?)(\n<!-- end of results -->)", re.DOTALL
)


def pages() -> tuple[Path, ...]:
    """The readme and the pages of the documentation."""
    return ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))


def tables() -> Iterator[tuple[Path, str, str]]:
    """Each table with its page and its name."""
    for page in pages():
        for found in BLOCK.finditer(page.read_text(encoding="utf-8")):
            yield page, found[2], found[3]


def table_named(name: str) -> str:
    """A table as it stands on its page."""
    return next(text for _, each, text in tables() if each == name)


def keep(name: str, text: str) -> None:
    """Writes a table wherever it stands; a `ValueError` if it does not stand on a page."""
    where = {page for page, each, _ in tables() if each == name}
    if not where:
        raise ValueError(f"no page has a place `<!-- results: {name} -->`")
    for page in where:
        before = page.read_text(encoding="utf-8")
        after = BLOCK.sub(
            lambda found: f"{found[1]}{text}{found[4]}" if found[2] == name else found[0], before
        )
        page.write_text(after, encoding="utf-8")
