"""The networks in the package: the paper's baselines are those that their training suite makes."""

import hashlib
import json
from pathlib import Path
from typing import Any

import pytest
from charms_agents.charms import STYLES
from charms_agents.human.samples import fingerprint
from charms_agents.training.settings import EPISODES_OF_A_SEED, FIRST_TRAINING_SEED, Human
from charms_agents.training.suite_file import load_training

from charms_bench.plugins.onnx_policy import OnnxPolicy
from charms_bench.plugins.registry import make_agent
from charms_bench.world.highd import find_trios

PROJECT = Path(__file__).parents[2]
POLICIES = PROJECT / "agents" / "charms_agents" / "policies"
SUITE = load_training(PROJECT / "suites" / "train-baselines.yaml")
STAGES = tuple(SUITE.stages)
HUMAN_STAGES = tuple(SUITE.human_stages)
ALL = tuple(sorted(file.stem for file in POLICIES.glob("*.onnx")))
US101 = PROJECT.parent / "shared" / "data" / "us101_highd_format"


def manifest(name: str) -> dict[str, Any]:
    content: dict[str, Any] = json.loads((POLICIES / f"{name}.json").read_text())
    return content


def sha256(name: str) -> str:
    return hashlib.sha256((POLICIES / f"{name}.onnx").read_bytes()).hexdigest()


def human() -> Human:
    assert SUITE.human is not None
    return SUITE.human


@pytest.mark.parametrize("name", ALL)
def test_each_is_small_and_the_one_its_manifest_describes(name: str) -> None:
    assert (POLICIES / f"{name}.onnx").stat().st_size < 1_000_000
    assert manifest(name)["onnx_sha256"] == sha256(name)
    assert manifest(name)["export_check"]["observations"] >= 9_000
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
def test_each_learnt_among_the_packaged_ones_it_was_trained_against(name: str) -> None:
    spec, made = SUITE.stages[name].traffic, manifest(name)["traffic"]
    assert made.get("mixture", {}) == spec.mixture
    assert made.get("options", {}) == spec.options
    hashes = made["weights_sha256"]
    if "agent" in made:
        hashes = {made["agent"]: hashes}
    for before in SUITE.needs[name]:
        assert hashes[before] == sha256(before)


@pytest.mark.parametrize("name", HUMAN_STAGES)
def test_each_learnt_from_people_as_the_suite_says(name: str) -> None:
    stage, made = human().stages[name], manifest(name)
    assert made["supervised"] == human().settings_of(stage).model_dump(mode="json")
    assert made["samples"]["settings"] == human().samples.model_dump(mode="json")
    if stage.fine_tunes is not None:
        start = {"stage": stage.fine_tunes, "weights_sha256": sha256(stage.fine_tunes)}
        assert made["starts_from"] == start


@pytest.mark.skipif(not US101.is_dir(), reason="needs ../shared/data, human recordings")
def test_all_learnt_from_the_same_recordings_of_us_101() -> None:
    expected = fingerprint(find_trios(US101), human().samples)
    assert {manifest(name)["samples"]["fingerprint"] for name in HUMAN_STAGES} == {expected}


@pytest.mark.parametrize("name", HUMAN_STAGES)
def test_learning_from_people_made_each_decide_more_like_them(name: str) -> None:
    before, after = manifest(name)["before"], manifest(name)["after"]
    assert after["agreement"] > before["agreement"]
    assert after["log_likelihood"] > before["log_likelihood"]


@pytest.mark.parametrize(
    "agent", ["imitation", "prior_level_k", "prior_level_k_safe", "charms-best-response", *STYLES]
)
def test_each_agent_is_its_packaged_network(agent: str) -> None:
    stage = agent.removeprefix("charms-").replace("-", "_")
    if agent in STYLES:
        stage = "charms_{}_{}".format(*STYLES[agent])
    made = make_agent(agent)
    assert isinstance(made, OnnxPolicy)
    assert made.weights_sha256 == sha256(stage)
