"""What a stage's network depends on, and who drives around its ego."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from charms_agents.training.job import Job
from charms_agents.training.settings import load_training

from charms_bench.traffic import OneAgent

SUITE = Path(__file__).parents[2] / "suites" / "train.yaml"


def job_of(**arguments: Any) -> Job:
    suite = load_training(SUITE)
    stage = suite.stages["prior_level_k"]
    return Job("prior_level_k", stage, suite, "level_0", None, "", **arguments)


def test_one_agent_drives_all_the_others() -> None:
    assert isinstance(job_of().make_traffic(), OneAgent)
    assert list(job_of().make_traffic_agents()) == ["level_0"]


def test_an_agent_mixed_in_drives_its_share_of_the_others() -> None:
    job = job_of(mixed_in="idm_mobil", mixed_in_share=0.25)
    assert list(job.make_traffic_agents()) == ["level_0", "idm_mobil"]
    drivers = job.make_traffic().assign(np.random.default_rng(0), 100, 100)
    # 2,500 +- 43 of 10,000
    assert 2_300 < (drivers == "idm_mobil").sum() < 2_700
    assert set(drivers.ravel()) == {"level_0", "idm_mobil"}


def test_who_is_mixed_in_decides_the_network_too() -> None:
    plain, mixed = job_of(), job_of(mixed_in="idm_mobil", mixed_in_share=0.25)
    assert "mixed_in" not in plain.inputs["traffic"]
    assert mixed.inputs["traffic"]["mixed_in"]["share"] == 0.25
    assert plain.key != mixed.key


@pytest.mark.parametrize(
    "option", [{"safe_headway_m": 50.0}, {"lane_change_cost": 0.1}, {"svo_angle_rad": 1.2}]
)
def test_an_option_of_the_reward_decides_the_network_too(option: dict[str, float]) -> None:
    plain = job_of()
    changed = replace(plain, stage=plain.stage.model_copy(update=option))
    (name,) = option
    assert name not in str(plain.inputs)
    assert name in str(changed.inputs)
    assert plain.key != changed.key
