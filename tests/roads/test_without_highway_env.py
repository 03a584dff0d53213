"""Without highway-env, every environment can be made, and suites run."""

import json
import os
import subprocess
import sys
from itertools import product
from pathlib import Path

import pytest

MISSING = """\
import importlib.metadata
import sys

class Missing:
    @staticmethod
    def find_spec(name, path=None, target=None):
        if name.partition(".")[0] == "highway_env":
            raise ModuleNotFoundError("highway-env is not installed", name=name)

def found(name, found=importlib.metadata.Distribution.from_name):
    if name == "highway-env":
        raise importlib.metadata.PackageNotFoundError(name)
    return found(name)

sys.meta_path.insert(0, Missing)
importlib.metadata.Distribution.from_name = found
"""
EVERY_ENVIRONMENT = """\
import sys

import gymnasium

import charms_bench.envs
from charms_bench.roads import TASKS

for name in TASKS:
    env = gymnasium.make(f"charms_bench/{name}", disable_env_checker=True)
    env.reset(seed=0)
    env.step(env.action_space.sample())
assert not {"highway_env", "pygame", "matplotlib"} & {*sys.modules}
print(len(TASKS))
"""
SUITE = """\
suite: merges
scene:
  profile: {name: charms, speed_min_mps: 0.0, target_speed_min_mps: 0.0}
egos: [{agent: idm_mobil}]
roads: [merge-v0, exit-v1]
traffic_models: [{traffic: environment}, {traffic: idm_mobil}]
"""


@pytest.fixture
def environment(tmp_path: Path) -> dict[str, str]:
    """Environment variables with which processes find no highway-env."""
    (tmp_path / "sitecustomize.py").write_text(MISSING)
    paths = [str(tmp_path), *filter(None, [os.environ.get("PYTHONPATH")])]
    return {**os.environ, "PYTHONPATH": os.pathsep.join(paths)}


def output_of(environment: dict[str, str], *arguments: str) -> str:
    command = [sys.executable, "-W", "ignore", *arguments]
    done = subprocess.run(command, env=environment, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_every_environment_can_be_made_and_stepped(environment: dict[str, str]) -> None:
    assert output_of(environment, "-c", EVERY_ENVIRONMENT).strip() == "31"


def test_a_suite_on_roads_runs(environment: dict[str, str], tmp_path: Path) -> None:
    suite = tmp_path / "merges.yaml"
    suite.write_text(SUITE)
    options = ["--episodes", "2", "--workers", "1", "--json", "--output", str(tmp_path / "run")]
    printed = output_of(environment, "-m", "charms_bench", "run", str(suite), *options)
    places = {(row["road"], row["traffic"]) for row in json.loads(printed)}
    assert places == {*product(("merge-v0", "exit-v1"), ("environment", "idm_mobil"))}
    manifest = json.loads((tmp_path / "run" / "manifest.json").read_text())
    assert "highway-env" not in manifest["versions"]
