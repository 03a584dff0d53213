"""The contents of the project's pages: fenced blocks, commands, code spans; and how they run."""

import os
import re
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).parent.parent.parent
PAGES = [
    ROOT / name for name in ("README.md", "docs/index.md", "docs/results.md", "docs/training.md")
]
PAGES += sorted({ROOT / "CONTRIBUTING.md", *(ROOT / "docs").glob("*.md")} - set(PAGES))
"""The order in which commands run: later pages use the output of earlier ones."""
FENCE = re.compile(r"^( *)```([^\n`]*)\n(.*?)^\1```$", re.DOTALL | re.MULTILINE)
OF_A_SHELL = {"sh", "bash", "console", "shell"}


@dataclass(frozen=True)
class Block:
    """A fenced block of a page."""

    page: Path
    line: int
    language: str
    """Empty if the block names no language."""
    text: str


def blocks(page: Path) -> Iterator[Block]:
    """The fenced blocks of a page."""
    written = page.read_text(encoding="utf-8")
    for found in FENCE.finditer(written):
        line = written.count("\n", 0, found.start()) + 2
        yield Block(page, line, found[2].partition(" ")[0], found[3])


def scripts(page: Path) -> list[str]:
    """The Python code of each block of a page that has some."""
    return [block.text for block in blocks(page) if block.language == "python"]


def execute(page: Path, *parts: str) -> None:
    """Runs Python code of a page, by default all of it."""
    exec(compile("\n".join(parts or scripts(page)), page.name, "exec"), {"__name__": "page"})


def run(command: str, folder: Path) -> subprocess.CompletedProcess[str]:
    """Runs a command of a page in a folder."""
    path = os.pathsep.join([str(Path(sys.executable).parent), os.environ["PATH"]])
    environment = {**os.environ, "PATH": path, "COLUMNS": "100"}
    return subprocess.run(
        ["bash", "-c", command], cwd=folder, env=environment, capture_output=True, text=True
    )


def commands(block: Block) -> list[str]:
    """The commands of a shell block, in order; in a `console` block, those after a prompt."""
    if block.language not in OF_A_SHELL:
        return []
    lines = block.text.replace("\\\n", " ").splitlines()
    if block.language == "console":
        lines = [line.removeprefix("$ ") for line in lines if line.startswith("$ ")]
    parts = [part for line in lines for part in re.sub(r"(^|\s+)#.*", "", line).split(" && ")]
    return [" ".join(part.split()) for part in parts if part.strip()]


def spans(page: Path) -> Iterator[str]:
    """The code spans of a page."""
    text = FENCE.sub("", page.read_text(encoding="utf-8"))
    for found in re.findall(r"`([^`]+)`", text):
        yield " ".join(found.split())
