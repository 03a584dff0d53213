"""The networks in the package are those that the training suites make."""

import hashlib
import json
from pathlib import Path
from typing import Any

import polars as pl
import pytest
from charms_agents.charms import STYLES
from charms_agents.human.samples import fingerprint
from charms_agents.training.suite_file import load_training
from rows.history import earlier_networks, missing

from charms_bench.plugins.onnx_policy import OnnxPolicy
from charms_bench.plugins.onnx_session import open_session, signature_of
from charms_bench.plugins.registry import make_agent
from charms_bench.world.observations import described
from charms_bench.world.recording_folder import find_trios

PROJECT = Path(__file__).parents[2]
POLICIES = PROJECT / "agents" / "charms_agents" / "policies"
PACKAGED = tuple(sorted(file.stem for file in POLICIES.glob("*.onnx")))
RESULTS = PROJECT / "docs" / "results"
HASHES = RESULTS / "plan-trainings.csv"
"""The hashes of the networks of the plan, also of those that are not kept."""
NOT_KEPT = RESULTS / "networks.csv"
NAMES = ("train-baselines", "train")
SUITES = {name: load_training(PROJECT / "suites" / f"{name}.yaml") for name in NAMES}


def network(name: str) -> Path:
    """The network of a stage, in the package if it is kept."""
    return POLICIES / f"{name}.onnx"


STAGES = [
    (suite, name)
    for suite, training in SUITES.items()
    for name in training.stages
    if network(name).is_file()
]
HUMAN_STAGES = [
    (suite, name)
    for suite, training in SUITES.items()
    if training.human is not None
    for name in training.human.stages
    if network(name).is_file()
]
US101 = PROJECT.parent / "shared" / "data" / "us101_corrected"


def manifest(name: str) -> dict[str, Any]:
    content: dict[str, Any] = json.loads(network(name).with_suffix(".json").read_text())
    return content


def sha256(file: Path) -> str:
    return hashlib.sha256(file.read_bytes()).hexdigest()


def hash_of(suite: str, name: str) -> str:
    """The hash of the network of a stage, by the tables of the trainings if it is not kept."""
    if (file := network(name)).is_file():
        return sha256(file)
    if suite == "train-baselines":
        table = pl.read_csv(NOT_KEPT).filter(network=f"baselines/{name}")
    else:
        table = pl.read_csv(HASHES).filter(network=name, seed=SUITES[suite].seed)
    return str(table["onnx_sha256"].item())


def test_the_package_has_the_networks_of_its_agents_alone() -> None:
    styles = {"charms_{}_{}".format(*style) for style in STYLES.values()}
    others = {"best_response", "charms_paper", "charms_roads", "imitation", "prior_level_k",
              "prior_level_k_safe"}  # fmt: skip
    assert set(PACKAGED) == styles | others


def test_the_paper_has_one_of_the_networks_of_the_plan() -> None:
    table = pl.read_csv(HASHES).filter(network="paper", seed=3010)
    assert table["onnx_sha256"].item() == sha256(POLICIES / "charms_paper.onnx")


def test_the_agent_of_all_roads_has_one_of_the_networks_of_its_plan() -> None:
    table = pl.read_csv(RESULTS / "plan-roads-trainings.csv")
    suite, made = load_training(PROJECT / "suites" / "train-roads.yaml"), manifest("charms_roads")
    stage = suite.stages[made["stage"]]
    of_seed = table.filter(network="roads", seed=suite.seed)
    assert of_seed["onnx_sha256"].item() == sha256(POLICIES / "charms_roads.onnx")
    assert [*made["style"]] == [*stage.styles]
    assert stage.reward is not None
    assert made["reward"] == stage.reward.model_dump(exclude_none=True)
    assert (made["steps"], made["seed"]) == (stage.steps, suite.seed)


@pytest.mark.parametrize(
    ("suite", "name"), [("train", "charms_efficient_egoistic"), ("train-roads", "charms_roads")]
)
def test_training_describes_an_observation_as_when_the_network_was_trained(
    suite: str, name: str
) -> None:
    said = signature_of(open_session((POLICIES / f"{name}.onnx").read_bytes())).metadata
    trains = load_training(PROJECT / "suites" / f"{suite}.yaml")
    assert described(trains.observed) == said["observation"]


def test_a_network_that_is_not_kept_can_be_made_or_found(tmp_path: Path) -> None:
    lacking = pl.read_csv(NOT_KEPT)
    of_plan = lacking.filter(pl.col("network").str.starts_with("seed-3012/"))
    plan = pl.read_csv(HASHES).filter(seed=3012)
    for path, found in of_plan.select("network", "onnx_sha256").iter_rows():
        assert plan.filter(network=path.split("/")[1])["onnx_sha256"].item() == found
    assert not lacking.select("command", "commit").null_count().sum_horizontal().item()
    if not missing():
        before = earlier_networks(tmp_path)
        for path, found in lacking.select("network", "onnx_sha256").iter_rows():
            assert sha256(before / f"{path}.onnx") == found


@pytest.mark.parametrize(("suite", "name"), STAGES + HUMAN_STAGES)
def test_each_is_small_and_the_one_its_manifest_describes(suite: str, name: str) -> None:
    file, made = network(name), manifest(name)
    assert file.stat().st_size < 1_000_000
    assert made["onnx_sha256"] == sha256(file) == OnnxPolicy(file).weights_sha256
    assert made["export_check"]["observations"] >= 9_000


@pytest.mark.parametrize(("suite", "name"), STAGES)
def test_each_was_trained_as_the_suite_says(suite: str, name: str) -> None:
    training, made = SUITES[suite], manifest(name)
    stage = training.stages[name]
    assert made["steps"] == stage.steps
    assert made["style"]["svo"] == stage.svo
    weights = training.weights[stage.weights].model_dump()
    assert made["style"]["weights"] == {"name": stage.weights, **weights}
    assert made["scene"] == stage.scene.model_dump(mode="json")
    assert made["hyperparameters"] == training.hyperparameters.model_dump(mode="json")
    assert (made["seed"], made["first_episode_seed"]) == (
        training.seed,
        training.first_episode_seed,
    )


@pytest.mark.parametrize(("suite", "name"), STAGES)
def test_each_learnt_among_the_networks_it_was_trained_against(suite: str, name: str) -> None:
    hashes = json.dumps(manifest(name)["traffic"])
    in_traffic = set(SUITES[suite].needs[name]) - {"people"}
    assert all(hash_of(suite, before) in hashes for before in in_traffic)


@pytest.mark.parametrize(("suite", "name"), HUMAN_STAGES)
def test_each_learnt_from_people_as_the_suite_says(suite: str, name: str) -> None:
    human, made = SUITES[suite].human, manifest(name)
    assert human is not None
    stage = human.stages[name]
    assert made["supervised"] == human.settings_of(stage).model_dump(mode="json")
    if stage.fine_tunes is not None:
        weights = hash_of(suite, stage.fine_tunes)
        assert made["starts_from"] == {"stage": stage.fine_tunes, "weights_sha256": weights}


@pytest.mark.skipif(not US101.is_dir(), reason="needs ../shared/data, human recordings")
@pytest.mark.parametrize(("suite", "name"), HUMAN_STAGES)
def test_all_learnt_from_the_same_recordings_of_us_101(suite: str, name: str) -> None:
    human = SUITES[suite].human
    assert human is not None
    expected = fingerprint(
        find_trios(US101), human.samples, SUITES[suite].observed, SUITES[suite].interface
    )
    assert manifest(name)["samples"]["fingerprint"] == expected


@pytest.mark.parametrize(("suite", "name"), HUMAN_STAGES)
def test_learning_from_people_made_each_decide_more_like_them(suite: str, name: str) -> None:
    before, after = manifest(name)["before"], manifest(name)["after"]
    assert after["log_likelihood"] > before["log_likelihood"]


@pytest.mark.parametrize(
    "agent",
    ["imitation", "prior_level_k", "prior_level_k_safe", "charms-best-response", "charms-paper",
     "charms-roads", *STYLES],
)  # fmt: skip
def test_each_agent_is_its_packaged_network(agent: str) -> None:
    stage = {"charms-best-response": "best_response"}.get(agent, agent.replace("-", "_"))
    if agent in STYLES:
        stage = "charms_{}_{}".format(*STYLES[agent])
    made = make_agent(agent)
    assert isinstance(made, OnnxPolicy)
    assert made.weights_sha256 == sha256(POLICIES / f"{stage}.onnx")
