"""A list of plugins says what each does without importing one."""

import sys
from importlib.metadata import EntryPoint
from pathlib import Path

import pytest

from charms_bench.plugins.first_line import first_line

PACKAGE = {
    "__init__.py": "from .driver import Driver as Renamed\nraise SystemExit\n",
    "driver.py": '''
raise RuntimeError("imported")
class Driver:
    """Brakes \\x1b[2J for others.

    And more.
    """
def make():
    "Makes one."
made = make()
"""One with options."""
silent = make()
class Silent: pass
''',
    "broken.py": "class Driver(:",
    "escape.py": "class Driver:\n    'A \\d.'\n",
    "loop.py": "from .loop import Driver\n",
}


@pytest.fixture
def package(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> str:
    name = "has_first_lines"
    (tmp_path / name).mkdir()
    for file, text in PACKAGE.items():
        (tmp_path / name / file).write_text(text)
    monkeypatch.syspath_prepend(tmp_path)
    return name


@pytest.mark.parametrize(
    ("place", "said"),
    [
        (".driver:Driver", "Brakes [2J for others."),
        (":Renamed", "Brakes [2J for others."),
        (".driver:make", "Makes one."),
        (".driver:made", "One with options."),
        (".driver:silent", ""),
        (".driver:Silent", ""),
        (".driver:Missing", ""),
        (".escape:Driver", "A \\d."),
        (".broken:Driver", ""),
        (".loop:Driver", ""),
        (".missing:Driver", ""),
        (".driver.inner:Driver", ""),
    ],
)
def test_a_plugin_says_what_it_does_without_being_imported(
    package: str, place: str, said: str
) -> None:
    assert first_line(EntryPoint("name", package + place, "group")) == said
    assert package not in sys.modules


def test_a_plugin_whose_package_is_gone_says_nothing() -> None:
    assert first_line(EntryPoint("name", "not_installed.agent:Agent", "group")) == ""
    assert first_line(EntryPoint("name", "sys:Agent", "group")) == ""
