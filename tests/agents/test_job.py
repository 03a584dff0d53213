"""What a stage's network depends on."""

import json
from pathlib import Path
from typing import Any

import pytest
from charms_agents.training.completed_reward import RewardScales
from charms_agents.training.job import Job, reinforcement_job
from charms_agents.training.suite_file import load_training
from rows.history import earlier_networks, missing

from charms_bench.plugins.onnx_policy import OnnxPolicy
from charms_bench.plugins.registry import make_agent
from charms_bench.plugins.specs import TrafficSpec

PROJECT = Path(__file__).parents[2]
SUITE = PROJECT / "suites" / "train-baselines.yaml"
POLICIES = PROJECT / "agents" / "charms_agents" / "policies"


def job_of(composition: dict[str, float], weights_of: str = "", **options: Any) -> Job:
    """The job of `prior_level_k` in a mixture, with other options and weights in the traffic."""
    suite, name = load_training(SUITE), "prior_level_k"
    changes = {"traffic": TrafficSpec(mixture=composition), **options}
    stages = {**suite.stages, name: suite.stages[name].model_copy(update=changes)}
    drivers = {driver: make_agent(weights_of or driver) for driver in composition}
    return reinforcement_job(Path(), name, suite.model_copy(update={"stages": stages}), drivers)


def test_who_drives_the_others_decides_the_network() -> None:
    keys = [
        job_of({"level_0": 1.0}).key,
        job_of({"level_0": 0.5, "idm_mobil": 0.5}).key,
        job_of({"level_0": 0.25, "idm_mobil": 0.75}).key,
        job_of({"prior_level_k": 1.0}).key,
        job_of({"prior_level_k": 1.0}, weights_of="charms").key,
    ]
    assert len(set(keys)) == 5


@pytest.mark.parametrize(
    "option", [{"reward": RewardScales(lane_change_cost=3.0)}, {"svo_angle_rad": 1.2}]
)
def test_an_option_of_the_reward_decides_the_network_too(option: dict[str, Any]) -> None:
    plain, changed = job_of({"level_0": 1.0}), job_of({"level_0": 1.0}, **option)
    (name,) = option
    assert name not in str(plain.inputs)
    assert name in str(changed.inputs)
    assert plain.key != changed.key


def test_the_baselines_suite_gives_the_keys_of_its_networks(tmp_path: Path) -> None:
    if why := missing():
        pytest.skip(why)
    level_1 = earlier_networks(tmp_path) / "baselines" / "level_1.onnx"
    suite = load_training(SUITE)
    for name in suite.stages:
        drivers = {
            driver: OnnxPolicy(level_1) if driver == "level_1" else make_agent(driver)
            for driver in suite.drivers_of(suite.stages[name])
        }
        folder = level_1.parent if name == "level_1" else POLICIES
        made = json.loads((folder / f"{name}.json").read_text())
        assert reinforcement_job(Path(), name, suite, drivers).key == made["key"]
