"""A new agent passes its own tests and stands in a table at once; bad names are rejected."""

import json
import os
import subprocess
import sys
import tomllib
from pathlib import Path
from typing import get_args

import pytest
from command_line import charms_bench
from plugin_folder import installed, python

from charms_bench.errors import InputError
from charms_bench.plugins.scaffold import Kind, new_agent

FILES = ("README.md", "pyproject.toml", "tailgater.py", "suite.yaml", "tests/test_tailgater.py")
KINDS: tuple[Kind, ...] = get_args(Kind)


def name_of(kind: Kind) -> str:
    return f"my_{kind.replace('-', '_')}"


def stands_in_a_table(name: str, folder: Path) -> None:
    run = ("run", "suite.yaml", "--episodes", 2, "--workers", 1, "--json")
    finished = charms_bench(*run, cwd=folder)
    assert finished.returncode == 0, finished.stderr
    rows = json.loads(finished.stdout)
    assert {row["agent"] for row in rows} | {row["traffic"] for row in rows} == {name, "IDM+MOBIL"}


@pytest.fixture(scope="module")
def folders(tmp_path_factory: pytest.TempPathFactory) -> dict[Kind, Path]:
    """A distribution of each kind, as if all were installed."""
    made = tmp_path_factory.mktemp("new")
    for kind in KINDS:
        new_agent(name_of(kind), made / kind, kind)
        installed(made / kind)
    return {kind: made / kind for kind in KINDS}


def test_agents_of_all_kinds_pass_their_own_tests(folders: dict[Kind, Path]) -> None:
    paths = [*map(str, folders.values())]
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join([*paths, *sys.path])}
    tests = ["pytest", "-q", "-p", "no:cacheprovider", "--import-mode=importlib", *paths]
    tested = python(tests, folders["policy"], environment)
    assert tested.returncode == 0, tested.stdout


@pytest.mark.parametrize("kind", KINDS)
def test_a_new_agent_stands_in_a_table_at_once(
    kind: Kind, folders: dict[Kind, Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.syspath_prepend(folders[kind])
    stands_in_a_table(name_of(kind), folders[kind])


def test_a_new_agent_is_these_files(tmp_path: Path) -> None:
    written = new_agent("tailgater", tmp_path / "new" / "tailgater")
    assert written == tuple(tmp_path / "new" / "tailgater" / name for name in FILES)


@pytest.mark.slow
def test_a_new_agent_can_be_installed_by_pip(tmp_path: Path) -> None:
    new_agent("tailgater", tmp_path)
    site = tmp_path / "site"
    pip = [sys.executable, "-m", "pip", "install", "--quiet", "--no-deps", "--target", str(site)]
    subprocess.run([*pip, str(tmp_path)], check=True)
    assert (site / "tailgater.py").exists()
    (tmp_path / "tailgater.py").unlink()  # what is tested is what was installed
    environment = {**os.environ, "PYTHONPATH": str(site)}
    tested = python(["pytest", "-q", "-p", "no:cacheprovider"], tmp_path, environment)
    assert tested.returncode == 0, tested.stdout
    finished = python(["charms_bench", "run", "suite.yaml", "--json"], tmp_path, environment)
    assert finished.returncode == 0, finished.stderr
    assert {row["agent"] for row in json.loads(finished.stdout)} == {"tailgater", "IDM+MOBIL"}


def test_a_name_of_several_words_becomes_a_class(tmp_path: Path) -> None:
    new_agent("two_second_rule", tmp_path)
    project = tomllib.loads((tmp_path / "pyproject.toml").read_text())["project"]
    points = project["entry-points"]["charms_bench.agents"]
    assert points == {"two_second_rule": "two_second_rule:TwoSecondRulePolicy"}
    assert "class TwoSecondRulePolicy(Policy):" in (tmp_path / "two_second_rule.py").read_text()


def test_a_name_that_says_the_kind_says_it_once(tmp_path: Path) -> None:
    new_agent("slow_policy", tmp_path)
    assert "class SlowPolicy(Policy):" in (tmp_path / "slow_policy.py").read_text()


def test_a_name_with_a_hyphen_brings_one_with_an_underscore(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="not ending with an underscore, such as 'my_planner'"):
        new_agent("my-planner", tmp_path)


def test_an_empty_folder_is_filled_and_any_other_left_alone(tmp_path: Path) -> None:
    (tmp_path / "notes.txt").write_text("mine")
    with pytest.raises(InputError, match="is not empty; give another folder with --folder"):
        new_agent("tailgater", tmp_path)
    assert [path.name for path in tmp_path.iterdir()] == ["notes.txt"]
    with pytest.raises(InputError, match=r"notes\.txt: cannot be written: Not a directory"):
        new_agent("tailgater", tmp_path / "notes.txt")


@pytest.mark.parametrize("name", ["", "My", "two words", "a-b", "../a", "1st", "a_", "class", "ä"])
def test_what_is_no_module_name_is_rejected(tmp_path: Path, name: str) -> None:
    with pytest.raises(InputError, match="cannot be the name of a module; expected"):
        new_agent(name, tmp_path / "new")
    assert not (tmp_path / "new").exists()


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("outside_policy", "outside-plugin already has the agent 'outside_policy'"),
        ("outside_traffic", "outside-plugin already has the traffic 'outside_traffic'"),
        ("numpy", "a module named 'numpy' already exists"),
        ("random", "a module named 'random' already exists"),
    ],
)
def test_what_is_taken_is_rejected(tmp_path: Path, name: str, message: str) -> None:
    with pytest.raises(InputError, match=message):
        new_agent(name, tmp_path / "new")
