"""The pages, and the files of `docs/results` that stand in them."""

import re
from pathlib import Path

ROOT = Path(__file__).parent.parent
RESULTS = ROOT / "docs" / "results"
BLOCK = re.compile(r"(<!-- results: ([a-z0-9-]+) -->\n\n).*?(<!-- end of results -->)", re.DOTALL)


def filled(text: str) -> str:
    """A page with the files of `docs/results` in their places."""
    texts = {path.stem: path.read_text(encoding="utf-8") for path in RESULTS.glob("*.md")}
    return BLOCK.sub(lambda found: f"{found[1]}{texts[found[2]]}\n{found[3]}", text)


def refill(page: Path) -> None:
    """Writes a page again with the files of `docs/results` in their places."""
    page.write_text(filled(page.read_text(encoding="utf-8")), encoding="utf-8")


def keep(name: str, text: str) -> None:
    """Writes a table into `docs/results`."""
    (RESULTS / f"{name}.md").write_text(text, encoding="utf-8")
