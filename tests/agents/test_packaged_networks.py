"""The networks in the package are those that the project's training suite makes."""

import hashlib
import json
from pathlib import Path
from typing import Any

import pytest
from charms_agents.training.settings import EPISODES_OF_A_SEED, FIRST_TRAINING_SEED, load_training

from charms_bench.onnx_policy import OnnxPolicy
from charms_bench.registry import make_agent

PROJECT = Path(__file__).parents[2]
POLICIES = PROJECT / "agents" / "charms_agents" / "policies"
SUITE = load_training(PROJECT / "suites" / "train.yaml")
STAGES = tuple(SUITE.stages)


def manifest(name: str) -> dict[str, Any]:
    content: dict[str, Any] = json.loads((POLICIES / f"{name}.json").read_text())
    return content


def sha256(name: str) -> str:
    return hashlib.sha256((POLICIES / f"{name}.onnx").read_bytes()).hexdigest()


@pytest.mark.parametrize("name", STAGES)
def test_each_is_small_and_the_one_its_manifest_describes(name: str) -> None:
    assert (POLICIES / f"{name}.onnx").stat().st_size < 1_000_000
    assert manifest(name)["onnx_sha256"] == sha256(name)
    assert manifest(name)["export_check"]["observations"] >= 10_000
    assert OnnxPolicy(POLICIES / f"{name}.onnx").weights_sha256 == sha256(name)


@pytest.mark.parametrize("name", STAGES)
def test_each_was_trained_as_the_suite_says(name: str) -> None:
    stage, made = SUITE.stages[name], manifest(name)
    assert made["steps"] == stage.steps
    assert made["style"]["svo"] == stage.svo
    weights = SUITE.weights[stage.weights].model_dump()
    assert made["style"]["weights"] == {"name": stage.weights, **weights}
    assert made["scene"] == stage.scene.model_dump(mode="json")
    assert made["hyperparameters"] == SUITE.hyperparameters_of(stage).inputs
    first_seed = FIRST_TRAINING_SEED + SUITE.seed * EPISODES_OF_A_SEED
    assert (made["seed"], made["first_episode_seed"]) == (SUITE.seed, first_seed)


@pytest.mark.parametrize("name", STAGES)
def test_each_learnt_among_the_packaged_one_it_was_trained_against(name: str) -> None:
    traffic = SUITE.stages[name].traffic
    expected = sha256(traffic.stage) if traffic.stage else ""
    assert manifest(name)["traffic"]["weights_sha256"] == expected


def test_prior_level_k_is_the_packaged_network() -> None:
    agent = make_agent("prior_level_k")
    assert isinstance(agent, OnnxPolicy)
    assert agent.weights_sha256 == sha256("prior_level_k")
