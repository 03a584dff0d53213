"""The base install evaluates without torch or anything else of the extras."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

CHECK_ALL = """\
import sys
from charms_bench.cli import main
for name in sys.argv[1:]:
    sys.argv = ["charms-bench", "check", name]
    try:
        main()
    except SystemExit as end:
        if end.code:
            raise
"""
OF_EXTRAS = (
    *("torch", "stable_baselines3", "onnx", "tensorboard"),
    *("dask", "distributed", "pettingzoo", "minari", "h5py"),
)
SUITE = Path(__file__).parent.parent / "suites" / "ego.yaml"


@pytest.fixture
def without_torch(tmp_path: Path) -> dict[str, str]:
    """An environment in which importing a library of an extra fails."""
    for name in OF_EXTRAS:
        missing = f"raise ModuleNotFoundError('{name} is not installed', name='{name}')\n"
        (tmp_path / f"{name}.py").write_text(missing)
    return {**os.environ, "PYTHONPATH": str(tmp_path)}


def called(environment: dict[str, str], *arguments: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "charms_bench", *arguments]
    return subprocess.run(command, env=environment, capture_output=True, text=True, check=False)


def charms_bench(environment: dict[str, str], *arguments: str) -> str:
    finished = called(environment, *arguments)
    assert finished.returncode == 0, finished.stderr
    return finished.stdout


def test_the_ego_suite_runs_with_every_row(without_torch: dict[str, str], tmp_path: Path) -> None:
    options = ["--episodes", "6", "--json", "--output", str(tmp_path / "run")]
    rows = json.loads(charms_bench(without_torch, "run", str(SUITE), *options))
    learnt = {"Imitation Learning", "Prior Level-k"}
    charms = {"CHARMS by the paper", "CHARMS", "CHARMS best response"}
    assert {row["agent"] for row in rows} == {"IDM+MOBIL", "Stackelberg"} | learnt | charms


@pytest.mark.parametrize("half", [0, 1])
def test_every_agent_of_the_project_can_be_made(without_torch: dict[str, str], half: int) -> None:
    listed = json.loads(charms_bench(without_torch, "agents", "--json"))
    ours = [row["name"] for row in listed if row["distribution"] == "charms-bench"]
    assert {"idm_mobil", "stackelberg", "imitation", "prior_level_k", "charms"} <= set(ours)
    command = [sys.executable, "-c", CHECK_ALL, *ours[half::2]]
    checked = subprocess.run(command, env=without_torch, capture_output=True, text=True)
    assert checked.returncode == 0, checked.stdout + checked.stderr


@pytest.mark.parametrize(
    "arguments", [("run", str(SUITE.parent / "train.yaml")), ("export", "model.zip", "model.onnx")]
)
def test_what_needs_torch_says_how_to_install_it(
    without_torch: dict[str, str], arguments: tuple[str, ...]
) -> None:
    finished = called(without_torch, *arguments)
    assert finished.returncode == 2
    assert "pip install 'charms-bench[train]'" in finished.stderr
    assert "Traceback" not in finished.stderr


def test_a_cluster_says_how_to_install_what_it_needs(without_torch: dict[str, str]) -> None:
    finished = called(without_torch, "run", str(SUITE), "--cluster", "tcp://127.0.0.1:8786")
    assert finished.returncode == 2
    assert "pip install 'charms-bench[cluster]'" in finished.stderr
    assert "Traceback" not in finished.stderr


def test_a_parallel_environment_says_how_to_install_what_it_needs(
    without_torch: dict[str, str],
) -> None:
    command = [sys.executable, "-c", "import charms_bench.envs.parallel_env"]
    done = subprocess.run(command, env=without_torch, capture_output=True, text=True, check=False)
    assert done.stderr.strip().endswith("pip install 'charms-bench[pettingzoo]'")
    assert "ImportError: a ParallelEnv needs PettingZoo" in done.stderr


def test_the_suites_are_installed(without_torch: dict[str, str], tmp_path: Path) -> None:
    listed = charms_bench(without_torch, "suites")
    assert {"ego", "transfer/lanes-2", "train"} <= {line.split()[0] for line in listed.splitlines()}
    options = ["--episodes", "2", "--output", str(tmp_path / "run"), "--json"]
    named = json.loads(charms_bench(without_torch, "run", "ego", *options))
    assert named == json.loads(charms_bench(without_torch, "run", str(SUITE), *options))
