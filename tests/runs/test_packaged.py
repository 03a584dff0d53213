"""Suites by name: those that are installed with the package."""

import re
from pathlib import Path

import pytest
from command_line import charms_bench

from charms_bench.errors import SuiteError
from charms_bench.runs.document import Document
from charms_bench.runs.packaged import packaged_suites
from charms_bench.runs.suite import load_suite

SUITES = Path(__file__).parents[2] / "suites"


def test_a_name_stands_for_the_file_of_the_checkout(tmp_path: Path) -> None:
    for name, path in packaged_suites().items():
        assert Document(Path(name)).data == Document(path).data
        assert path.read_bytes() == (SUITES / f"{name}.yaml").read_bytes()


def test_a_listed_suite_can_be_copied_once(tmp_path: Path) -> None:
    listed = charms_bench("suites", cwd=tmp_path).stdout
    assert re.search("^ego +Decision-making performance of ego models", listed, re.MULTILINE)
    assert charms_bench("suites", "--copy", "ego", cwd=tmp_path).returncode == 0
    assert (tmp_path / "ego.yaml").read_bytes() == (SUITES / "ego.yaml").read_bytes()
    (tmp_path / "ego.yaml").write_text("mine")
    again = charms_bench("suites", "--copy", "ego", cwd=tmp_path)
    assert (again.returncode, (tmp_path / "ego.yaml").read_text()) == (2, "mine")


def test_a_copy_has_the_road_files_that_the_suite_names(tmp_path: Path) -> None:
    assert charms_bench("suites", "--copy", "places", cwd=tmp_path).returncode == 0
    copied = {path.relative_to(tmp_path): path.read_bytes() for path in tmp_path.rglob("*.*")}
    named = [SUITES / "places.yaml", *(SUITES / "places").glob("*.json")]
    assert copied == {path.relative_to(SUITES): path.read_bytes() for path in named}
    load_suite(tmp_path / "places.yaml")


def test_a_file_with_the_name_of_a_suite_has_to_be_given_by_its_full_path(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("ego").write_text("title: mine")
    with pytest.raises(SuiteError, match="ego: is both a suite of charms-bench and a file in the"):
        Document(Path("ego"))
    assert Document(tmp_path / "ego").data == {"title": "mine"}


@pytest.mark.parametrize(
    ("path", "message"),
    [
        ("suites/ego.yaml", "no such file; the suite of charms-bench is called 'ego'"),
        ("egos", r"is neither a file nor a suite\. Did you mean 'ego'\?"),
        ("mine.yaml", "mine.yaml: no such file$"),
    ],
)
def test_what_does_not_exist_is_named(
    path: str, message: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    with pytest.raises(SuiteError, match=message):
        Document(Path(path))
