"""The page about moving from 0.1: what it says to write instead is there."""

import re
from importlib import import_module
from pathlib import Path

import pytest

from charms_bench.errors import InputError
from charms_bench.runs.suite import load_suite

PAGE = Path(__file__).parents[2] / "docs" / "from-0.1-to-0.2.md"
ROW = re.compile(r"^\| `(charms_bench[\w.]+)` \| `(charms_bench[\w.]+)` \|$", re.MULTILINE)
MOVED = ROW.findall(PAGE.read_text(encoding="utf-8"))
SUITE = """\
suite: old
episodes: 2
egos: [{agent: idm_mobil}]
"""


@pytest.mark.parametrize(("before", "now"), MOVED)
def test_a_name_has_moved_to_where_the_page_says(before: str, now: str) -> None:
    module, name = now.rsplit(".", 1)
    assert hasattr(import_module(module), name)
    module, name = before.rsplit(".", 1)
    with pytest.raises((ImportError, AttributeError)):
        getattr(import_module(module), name)


@pytest.mark.parametrize(
    ("old", "instead"),
    [
        ("traffics: [{traffic: idm_mobil}]", "suite.yaml:4: .*traffic_models"),
        (
            "traffic_models: [{traffic: {road: merge-v1, drivers: human}}]",
            r"suite.yaml:4: (.|\n)*roads: \[merge-v1\]\ntraffic_models: \[{traffic: human}\]",
        ),
        (
            "traffic_models: [{traffic: {road: merge-v1}}]",
            r"suite.yaml:4: (.|\n)*roads: \[merge-v1\]\ntraffic_models: \[{traffic: environment}\]",
        ),
    ],
)
def test_the_error_about_an_old_key_says_what_to_write(
    old: str, instead: str, tmp_path: Path
) -> None:
    file = tmp_path / "suite.yaml"
    file.write_text(SUITE + old + "\n")
    with pytest.raises(InputError, match=instead):
        load_suite(file)
