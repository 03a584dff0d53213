"""Every example of `docs/plugins.md` runs, in the order of the page."""

import shlex
import sys
from pathlib import Path

import pytest
from command_line import charms_bench
from plugin_folder import installed, python
from written import ROOT, blocks

GUIDE = list(blocks(ROOT / "docs" / "plugins.md"))


def examples(language: str) -> str:
    return "\n\n".join(block.text for block in GUIDE if block.language == language)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """The distribution that the guide describes."""
    (tmp_path / "my_plugins.py").write_text(examples("python"))
    (tmp_path / "pyproject.toml").write_text(examples("toml"))
    (tmp_path / "suite.yaml").write_text(examples("yaml"))
    return tmp_path


def test_every_command_of_the_guide_succeeds(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    installed(folder)
    monkeypatch.syspath_prepend(folder)
    try:
        for line in examples("sh").splitlines():
            command, *arguments = shlex.split(line)
            assert command == "charms-bench"
            workers = ["--workers", 1] * (arguments[0] in ("run", "rare"))
            called = charms_bench(*arguments, *workers, cwd=folder)
            assert called.returncode == 0, f"{line}\n{called.stdout}{called.stderr}"
    finally:
        sys.modules.pop("my_plugins", None)
    assert (folder / "runs" / "rush" / "tables" / "rush.csv").read_text().count("haste") == 2


def test_the_tests_of_the_guide_pass(folder: Path) -> None:
    arguments = ["pytest", "-q", "-p", "no:cacheprovider", "my_plugins.py"]
    tested = python(arguments, folder, installed(folder))
    assert tested.returncode == 0, tested.stdout


def test_the_guide_has_no_example_that_is_not_run() -> None:
    assert {block.language for block in GUIDE} == {"python", "toml", "yaml", "sh"}
