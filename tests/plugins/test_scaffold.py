"""A new agent passes its own tests and stands in a table at once; bad names are refused."""

import json
import os
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest
from plugin_folder import installed, python

from charms_bench.errors import InputError
from charms_bench.plugins.scaffold import Kind, new_agent

FILES = ("README.md", "pyproject.toml", "tailgater.py", "suite.yaml", "tests/test_tailgater.py")


def drives_at_once(folder: Path, environment: dict[str, str]) -> None:
    tested = python(["pytest", "-q", "-p", "no:cacheprovider"], folder, environment)
    assert tested.returncode == 0, tested.stdout
    run = ["charms_bench", "run", "suite.yaml", "--episodes", "4", "--json"]
    finished = python(run, folder, environment)
    assert finished.returncode == 0, finished.stderr
    assert {row["agent"] for row in json.loads(finished.stdout)} == {"tailgater", "IDM+MOBIL"}


def test_a_new_agent_passes_its_own_tests_and_stands_in_a_table(tmp_path: Path) -> None:
    written = new_agent("tailgater", tmp_path / "new" / "tailgater")
    assert written == tuple(tmp_path / "new" / "tailgater" / name for name in FILES)
    drives_at_once(tmp_path / "new" / "tailgater", installed(tmp_path / "new" / "tailgater"))


@pytest.mark.parametrize("kind", ["planner", "memory", "driver-model", "traffic"])
def test_every_kind_passes_its_own_tests_and_stands_in_a_table(kind: Kind, tmp_path: Path) -> None:
    folder = tmp_path / "tailgater"
    new_agent("tailgater", folder, kind)
    environment = installed(folder)
    tested = python(["pytest", "-q", "-p", "no:cacheprovider"], folder, environment)
    assert tested.returncode == 0, tested.stdout
    run = ["charms_bench", "run", "suite.yaml", "--episodes", "2", "--workers", "1", "--json"]
    finished = python(run, folder, environment)
    assert finished.returncode == 0, finished.stderr
    key = "traffic" if kind == "traffic" else "agent"
    assert {row[key] for row in json.loads(finished.stdout)} == {"tailgater", "IDM+MOBIL"}


@pytest.mark.slow
def test_a_new_agent_can_be_installed_by_pip(tmp_path: Path) -> None:
    new_agent("tailgater", tmp_path)
    site = tmp_path / "site"
    pip = [sys.executable, "-m", "pip", "install", "--quiet", "--no-deps", "--target", str(site)]
    subprocess.run([*pip, str(tmp_path)], check=True)
    assert (site / "tailgater.py").exists()
    (tmp_path / "tailgater.py").unlink()  # what is tested is what was installed
    drives_at_once(tmp_path, {**os.environ, "PYTHONPATH": str(site)})


def test_a_name_of_several_words_becomes_a_class(tmp_path: Path) -> None:
    new_agent("two_second_rule", tmp_path)
    project = tomllib.loads((tmp_path / "pyproject.toml").read_text())["project"]
    points = project["entry-points"]["charms_bench.agents"]
    assert points == {"two_second_rule": "two_second_rule:TwoSecondRulePolicy"}
    assert "class TwoSecondRulePolicy(Policy):" in (tmp_path / "two_second_rule.py").read_text()


def test_an_empty_folder_is_filled_and_any_other_left_alone(tmp_path: Path) -> None:
    (tmp_path / "notes.txt").write_text("mine")
    with pytest.raises(InputError, match="is not empty; give another folder with --folder"):
        new_agent("tailgater", tmp_path)
    assert [path.name for path in tmp_path.iterdir()] == ["notes.txt"]
    with pytest.raises(InputError, match=r"notes\.txt: cannot be written: Not a directory"):
        new_agent("tailgater", tmp_path / "notes.txt")


@pytest.mark.parametrize("name", ["", "My", "two words", "a-b", "../a", "1st", "a_", "class", "ä"])
def test_what_is_no_module_name_is_refused(tmp_path: Path, name: str) -> None:
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
def test_what_is_taken_is_refused(tmp_path: Path, name: str, message: str) -> None:
    with pytest.raises(InputError, match=message):
        new_agent(name, tmp_path / "new")
