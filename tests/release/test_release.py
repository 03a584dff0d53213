"""A newcomer installs the wheel or the sdist of a release, and runs the first suite.

`tox -e release` runs this. RELEASE_PYTHONS names the interpreters, separated by spaces; those that
do not start are skipped.
"""

import json
import os
import subprocess
import sys
import tarfile
from pathlib import Path

import pytest

pytest.importorskip("build", reason="tox -e release has it")

from charms_bench import __version__

pytestmark = pytest.mark.slow

ROOT = Path(__file__).parents[2]
PYTHONS = os.environ.get("RELEASE_PYTHONS", "python3.11 python3.12 python3.13").split()
RULE_BASED = {"IDM+MOBIL", "Stackelberg"}


def called(*command: object, cwd: Path) -> str:
    done = subprocess.run(
        [str(word) for word in command],
        cwd=cwd,
        env={key: value for key, value in os.environ.items() if key != "PYTHONPATH"},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


@pytest.fixture(scope="module")
def dist(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the sdist, and the wheel that was built from it."""
    folder = tmp_path_factory.mktemp("dist")
    called(sys.executable, "-m", "build", "--outdir", folder, ROOT, cwd=folder)
    return folder


@pytest.fixture(params=PYTHONS)
def python(request: pytest.FixtureRequest, tmp_path: Path) -> Path:
    """The interpreter of a new environment."""
    try:
        subprocess.run([request.param, "--version"], capture_output=True, check=True)
    except (OSError, subprocess.CalledProcessError):
        pytest.skip(f"{request.param} is not here")
    called(request.param, "-m", "venv", tmp_path / "environment", cwd=tmp_path)
    return tmp_path / "environment" / "bin" / "python"


def agents_in_the_table(charms_bench: Path, suite: str, folder: Path) -> set[str]:
    options = ("--episodes", 2, "--workers", 1, "--json")
    rows = json.loads(called(charms_bench, "run", suite, *options, cwd=folder))
    return {row["agent"] for row in rows}


def test_the_wheel_runs_a_suite_of_the_package_from_any_folder(
    dist: Path, python: Path, tmp_path: Path
) -> None:
    (wheel,) = dist.glob("*.whl")
    called(python, "-m", "pip", "install", "--quiet", wheel, cwd=tmp_path)
    charms_bench = python.parent / "charms-bench"
    assert __version__ in called(charms_bench, "--version", cwd=tmp_path)
    assert agents_in_the_table(charms_bench, "ego", tmp_path) >= RULE_BASED


def test_the_commands_of_the_readme_work_in_the_sdist(
    dist: Path, python: Path, tmp_path: Path
) -> None:
    (archive,) = dist.glob("*.tar.gz")
    with tarfile.open(archive) as file:
        file.extractall(tmp_path, filter="data")
    checkout = tmp_path / archive.name.removesuffix(".tar.gz")
    called(python, "-m", "pip", "install", "--quiet", ".", cwd=checkout)
    table = agents_in_the_table(python.parent / "charms-bench", "suites/ego.yaml", checkout)
    assert table >= RULE_BASED


def test_the_pages_of_a_package_index_have_what_they_show(dist: Path) -> None:
    (archive,) = dist.glob("*.tar.gz")
    with tarfile.open(archive) as file:
        member = file.extractfile(f"{archive.name.removesuffix('.tar.gz')}/PKG-INFO")
        assert member is not None
        metadata = member.read().decode()
    head, _, readme = metadata.partition("\n\n")
    for field in ("Summary", "Author", "Keywords", "License-Expression", "Project-URL"):
        assert f"\n{field}: " in head
    assert "Description-Content-Type: text/markdown" in head
    assert readme.startswith("# charms-bench")
