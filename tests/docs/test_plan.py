"""The tool of the training plan: its suites are valid, and what it holds out is not trained."""

import shutil
import sys
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest
import yaml
from charms_agents.training.settings import TrainingSuite
from charms_agents.training.suite_file import load_training
from written import ROOT

from charms_bench.runs.suite import load_suite
from charms_bench.world.actions import DEFAULT_ACTIONS

WITHOUT_STYLES = ("styles", "style-traffic", "pch", "trials")
"""Tests of networks that the repository does not have."""


@pytest.fixture(scope="module")
def plan() -> Iterator[ModuleType]:
    sys.path.insert(0, str(ROOT / "tools"))
    import plan

    yield plan
    sys.path.remove(str(ROOT / "tools"))


def test_every_test_drives_the_ten_seeds_of_charms(plan: ModuleType, tmp_path: Path) -> None:
    for name in set(plan.TESTS) - set(WITHOUT_STYLES):
        suite = load_suite(plan.write_test(ROOT / "networks", tmp_path, name))
        labels = [each.label for each in suite.egos]
        seeds = {int(label.split()[-1]) for label in labels if label.startswith("CHARMS, seed")}
        assert seeds == set(range(3010, 3020))
        assert suite.seed == (962_000_000 if name == "validation" else 607_118_000)


def parameters(models: list[Any]) -> list[dict[str, list[float]]]:
    return [each["traffic"]["scenario"]["parameters"] for each in models]


def test_every_hazard_of_the_test_has_a_parameter_beyond_those_of_the_training(
    plan: ModuleType, tmp_path: Path
) -> None:
    trained = parameters(yaml.safe_load(plan.SUITE.read_text())["conditions"]["hazards"])
    file = plan.write_test(ROOT / "networks", tmp_path, "sealed-hazards")
    tested = parameters(yaml.safe_load(file.read_text())["traffic_models"])
    assert len(tested) == 4
    for its in tested:
        (like,) = {str(each): each for each in trained if each.keys() == its.keys()}.values()
        differ = [name for name in its if its[name] != like[name]]
        assert len(differ) == 1
        low, high = its[differ[0]]
        assert low >= like[differ[0]][1] or high <= like[differ[0]][0]


def test_an_ablation_takes_away_what_it_is_called_after(plan: ModuleType, tmp_path: Path) -> None:
    def without(name: str) -> TrainingSuite:
        suite = yaml.safe_load(plan.SUITE.read_text())
        plan.ABLATIONS[name](suite)
        file = tmp_path / f"{name}.yaml"
        file.write_text(yaml.safe_dump(suite))
        return load_training(file)

    assert without("no-brake").actions == DEFAULT_ACTIONS
    assert without("no-prior").stages["efficient_egoistic"].prior is None
    suite = without("level-0")
    assert "level_1" not in suite.drivers_of(suite.stages["efficient_egoistic"])


def test_the_trials_of_a_folder_are_egos_beside_idm_mobil(plan: ModuleType, tmp_path: Path) -> None:
    network = ROOT / "networks" / "seed-3010" / "charms_efficient_egoistic"
    for name in ("ppo-drawn-0", "dqn-default"):
        folder = tmp_path / "trials" / name / "seed-2000"
        folder.mkdir(parents=True)
        for suffix in (".onnx", ".json"):
            shutil.copy(network.with_suffix(suffix), folder / f"{name[:3]}{suffix}")
    suite = load_suite(plan.write_test(tmp_path, tmp_path, "trials"))
    assert [each.label for each in suite.egos] == ["IDM+MOBIL", "dqn-default", "ppo-drawn-0"]
    assert (suite.seed, suite.episodes) == (970_000_000, 600)
