"""Training suites: what they say, and how they say what is wrong."""

import json
import shutil
from pathlib import Path
from typing import Any

import charms_agents.charms
import pytest
import yaml
from charms_agents.human.samples import SampleSettings
from charms_agents.training.completed_reward import CompletedReward
from charms_agents.training.hyperparameters import Hyperparameters, Supervised
from charms_agents.training.rewards import StyleReward
from charms_agents.training.settings import FIRST_TRAINING_SEED, Condition
from charms_agents.training.suite_file import load_training

from charms_bench.errors import SuiteError
from charms_bench.world.scene import EVALUATION_SEEDS

SUITES = Path(__file__).parents[2] / "suites"
SUITE = SUITES / "train-baselines.yaml"
SHIPPED = SUITES / "train.yaml"


def changed(tmp_path: Path, *path: str, value: Any, suite: Path = SUITE) -> Path:
    """A training suite of the project with one value changed, or removed if it is None."""
    data = yaml.safe_load(suite.read_text())
    inner = data
    for key in path[:-1]:
        inner = inner[key]
    inner[path[-1]] = value
    if value is None:
        del inner[path[-1]]
    file = tmp_path / "train.yaml"
    plain = json.loads(json.dumps(data))  # without aliases
    file.write_text(yaml.safe_dump(plain, sort_keys=False))
    return file


def test_the_papers_baselines_are_trained_with_the_papers_table() -> None:
    suite = load_training(SUITE)
    h = suite.hyperparameters
    assert (h.learning_rate, h.batch_size, h.discount, h.replay_buffer) == (1e-4, 32, 0.99, 50_000)
    assert h.hidden_layers == (256, 256)
    assert suite.stages["level_1"].steps == 1_000_000
    assert suite.stages["prior_level_k"].steps == 500_000
    assert suite.order.index("level_1") < suite.order.index("prior_level_k")


def test_a_stage_needs_the_stages_its_traffic_comes_from() -> None:
    suite = load_training(SUITE)
    assert suite.needed_for("level_1") == ("level_1",)
    assert suite.needed_for("prior_level_k") == ("level_1", "prior_level_k")


def test_a_style_needs_its_prior_and_the_level_1_of_its_conditions() -> None:
    suite = load_training(SHIPPED)
    assert suite.needed_for("level_1") == ("people", "level_1")
    before = ("people", "level_1", "safe_prosocial")
    assert suite.needed_for("charms_safe_prosocial") == (*before, "charms_safe_prosocial")


def test_traffic_can_have_stages_that_learn_from_human_driving(tmp_path: Path) -> None:
    mixture = {"imitation": 0.5, "idm_mobil": 0.5}
    path = changed(tmp_path, "stages", "prior_level_k", "traffic", value={"mixture": mixture})
    assert load_training(path).needs["prior_level_k"] == ("imitation",)


def test_the_styles_differ_in_weights_and_orientation_alone() -> None:
    suite = load_training(SHIPPED)
    answers = {"level_1", "best_response"}
    styles = [stage for name, stage in suite.stages.items() if name not in answers]
    named = {"weights", "svo", "svo_angle_rad"}
    assert len({style.model_dump_json(exclude=named) for style in styles}) == 1
    angles = {(s.weights, s.all_styles[""].angle_rad) for s in styles}
    assert len(angles) == len(styles) == 8


def test_the_traffic_of_a_stage_can_have_networks_by_path(tmp_path: Path) -> None:
    network = Path(charms_agents.charms.__file__).parent / "policies" / "prior_level_k.onnx"
    shutil.copy(network, tmp_path / "mine.onnx")
    mixture = {"mine.onnx": 0.5, "idm_mobil": 0.5}
    path = changed(tmp_path, "stages", "prior_level_k", "traffic", value={"mixture": mixture})
    assert load_training(path).needed_for("prior_level_k") == ("prior_level_k",)
    (tmp_path / "mine.onnx").unlink()
    with pytest.raises(
        SuiteError, match=r"train.yaml:\d+: stages.prior_level_k.traffic.*mine.onnx"
    ):
        load_training(path)


def test_no_training_scene_is_ever_evaluated() -> None:
    assert FIRST_TRAINING_SEED > EVALUATION_SEEDS


WRONG: tuple[tuple[Path, str, Any, str], ...] = (
    (SUITE, "hyperparameters.batch_size", 0, "hyperparameters.batch_size"),
    (SUITE, "hyperparameters.batchsize", 32, "hyperparameters.batchsize: unknown key"),
    (SUITE, "hyperparameters.scenes", 7, "not a multiple of steps_per_gradient"),
    (SUITE, "hyperparameters.replay_buffer", 50_005, "replay_buffer 50005 is not a multiple"),
    (SUITE, "curve_steps", 10_001, "curve_steps: 10001 is not a multiple of scenes 10"),
    (SUITE, "stages.level_1.steps", 11, "stages.level_1.steps: 11 is not a multiple"),
    (SUITE, "stages.level_1.svo", "kind", "stages.level_1.svo"),
    (SUITE, "stages.level_1.weights", "fast", "no weights named 'fast'.*safe, efficient"),
    (SUITE, "stages.level_1.traffic", {}, "stages.level_1.traffic: give a name"),
    (SUITE, "stages.level_1.traffic", "level_O", "Did you mean 'level_0'.*this file: level_1"),
    (SUITE, "stages.level_1.traffic", "prior_level_k", "stages depend on each other"),
    (SUITE, "stages.level_1.traffic", {"mixture": {"level_9": 1.0}}, "named 'level_9'"),
    (SUITE, "stages.level_1.traffic", {"mixture": {"level_0": 0.5}}, "must .* sum to 1"),
    (SUITE, "stages.prior_level_k.traffic", {"name": "level_1", "options": {"tau": 1.5}},
     "stages.prior_level_k.traffic: 'level_1' is a stage, which has no options"),
    (SUITE, "weights.safe.comfort", -1.0, "weights.safe.comfort"),
    (SUITE, "stages.level_1.scene.density", 0, "stages.level_1.scene.density"),
    (SHIPPED, "stages.level_1.conditions", "level_9",
     "level_1.conditions: no conditions named 'level_9'; this file has: level_0, "),
    (SHIPPED, "conditions.level_0", [{"lanes": 3}, {"lanes": 2}, {"lanes": 5}],
     "stages.level_1.conditions: scenes 500 is not a multiple of 11 conditions"),
    (SHIPPED, "conditions.level_0", [], "conditions.level_0"),
    (SHIPPED, "conditions.level_0", [{"lanes": 1}], "conditions.level_0.*lanes"),
    (SHIPPED, "conditions.level_0", [{"traffic": "idm_mobi"}] * 10,
     r"conditions.level_0\[0\].traffic: .*Did you mean 'idm_mobil'"),
    (SUITE, "stages.environment", {"like": "level_1"}, "'environment' is no agent: expected "),
    (SHIPPED, "stages.level_1.prior", "person",
     "level_1.prior: no stage named 'person' under human.stages; this file has: people, "),
    (SHIPPED, "hyperparameters.prior_weight", 0.0,
     "stages.level_1.prior: needs hyperparameters with a prior_weight, and standardised"),
    (SHIPPED, "hyperparameters.standardised", False,
     "stages.level_1.prior: needs hyperparameters with a prior_weight, and standardised"),
    (SHIPPED, "hyperparameters.prior_weight", -0.1, "hyperparameters.prior_weight"),
    (SHIPPED, "human.stages.people.hidden_layers", [64],
     "stages.level_1.prior: has 1 hidden layers; expected as many as the stage has, 2"),
    (SHIPPED, "human.simulated", None,
     "human: a stage learns from `simulated` drivers: none given"),
    (SHIPPED, "human.simulated.conditions", "level_9",
     "human.simulated.conditions: no conditions named 'level_9'; this file has: level_0, "),
    (SHIPPED, "human.simulated.traffic", "level_1",
     "human.simulated.traffic: 'level_1' is a stage; expected installed agents or networks"),
    (SHIPPED, "human.simulated.traffic", "humn",
     "human.simulated.traffic: .*'humn'.*Did you mean 'human'"),
    (SHIPPED, "human.simulated.agents", ["humn"],
     "human.simulated.agents: .*'humn'.*Did you mean 'human'"),
    (SHIPPED, "human.simulated.scene", {"decision_hz": 5},
     "simulated.scene: expected simulation_hz 15 and decision_hz 3, found 15 and 5"),
    (SHIPPED, "human.stages.charms_safe_egoistic.drivers", "simulated",
     "charms_safe_egoistic.drivers: a stage that fine-tunes learns from recorded drivers; "),
    (SHIPPED, "human.simulated.episodes", 1, "human.simulated.episodes"),
    (SHIPPED, "human.samples.labels", "moment", "step_mps is for labels: manoeuvre"),
    (SHIPPED, "human.samples.step_mps", 0.0, "human.samples.step_mps"),
    (SHIPPED, "human.fine_tuning.loss", "entropy", "human.fine_tuning.loss"),
    (SHIPPED, "stages.level_1.reward", {"failure": 10.0}, "reward.failure: unknown key"),
    (SHIPPED, "stages.level_1.reward", {"jerk_mps3": 0.0}, "reward.jerk_mps3"),
    (SHIPPED, "stages.level_1.reward", {"desired_speed_mps": 22.0},
     "reward.desired_speed_mps: 22; expected more than 22 m/s, the lowest target speed of"),
    (SHIPPED, "observation", {"type": "neighbours", "action_mask": True}, "without an action mask"),
)  # fmt: skip


@pytest.mark.parametrize(("suite", "path", "value", "message"), WRONG)
def test_what_is_wrong_is_named_with_its_place(
    tmp_path: Path, suite: Path, path: str, value: Any, message: str
) -> None:
    file = changed(tmp_path, *path.split("."), value=value, suite=suite)
    with pytest.raises(SuiteError, match=rf"train\.yaml:\d+: .*{message}"):
        load_training(file)


STATIONARY: dict[str, Any] = {
    "parameters": {"gap_m": [40, 150]},
    "points": "random",
    "ego": {"lane": 1, "speed_mps": 26.0},
    "vehicles": [
        {"name": "standing", "lane": 1, "ahead_of": "ego", "gap_m": "gap_m", "speed_mps": 0},
        {"name": "beside", "lane": 0, "x_m": 80, "speed_mps": 26.0, "agent": "human"},
    ],
}
SLOW = {
    "name": "charms",
    "speed_min_mps": 0.0,
    "target_speed_min_mps": 0.0,
    "target_speed_steps_mps": [0.25, 0.5, 1.0, 2.0],
}


def test_a_scenario_and_another_profile_can_be_a_condition(tmp_path: Path) -> None:
    hazards = [{"traffic": {"scenario": STATIONARY}, "profile": SLOW}] * 5
    file = changed(tmp_path, "conditions", "hazards", value=hazards, suite=SHIPPED)
    names = ["level_0", "level_0", "hazards"]
    file = changed(tmp_path, "stages", "level_1", "conditions", value=names, suite=file)
    suite = load_training(file)
    stage = suite.stages["level_1"]
    assert suite.drivers_of(stage) == ("human", "idm_mobil")
    (plain, _), *_, (placed, traffic) = suite.places_of(stage)
    assert len(suite.places_of(stage)) == 25
    assert plain.scenario is None
    assert plain.profile.speed_min_mps == 22.0
    assert placed.scenario is not None
    assert placed.vehicles == 3
    assert placed.profile.speed_min_mps == placed.profile.target_speed_min_mps == 0.0
    assert traffic.agents == ("prescribed", "human")


@pytest.mark.parametrize(
    ("condition", "message"),
    [
        (
            {"traffic": {"scenario": {**STATIONARY, "points": "sobol"}}},
            "scenario.points: expected random, for episodes of a training",
        ),
        (
            {"traffic": {"scenario": STATIONARY}},
            r"level_0\[0\].traffic.scenario.vehicles\[0\].speed_mps: 0 is out of range; expected",
        ),
        ({"traffic": {"road": "merge-v0"}}, "a road is no traffic model"),
        (
            {"traffic": {"scenario": STATIONARY}, "profile": SLOW, "ego_slots": 3},
            r"level_0\[0\]: the scenario says which vehicle the ego is; remove ego_slots",
        ),
        (
            {"profile": "charms"},
            r"profile: target_speed_steps_mps: found \[\]; expected those of the stage 'level_1', ",
        ),
    ],
)
def test_conditions_in_which_networks_cannot_learn_are_named(
    tmp_path: Path, condition: dict[str, Any], message: str
) -> None:
    file = changed(tmp_path, "conditions", "level_0", value=[condition] * 10, suite=SHIPPED)
    with pytest.raises(SuiteError, match=rf"train\.yaml:\d+: .*{message}"):
        load_training(file)


@pytest.mark.parametrize(
    ("remaining", "expected"), [(1.0, 1e-3), (0.5, 1e-3), (0.25, 5e-4), (0.0, 0.0)]
)
def test_a_decaying_learning_rate_falls_to_zero_in_the_last_steps(
    remaining: float, expected: float
) -> None:
    h = Hyperparameters(learning_rate=1e-3, learning_rate_decay=0.5)
    assert h.learning_rate_at(remaining) == pytest.approx(expected)


def test_the_learning_rate_of_the_paper_stays() -> None:
    assert Hyperparameters().learning_rate_at(0.0) == 1e-4


def test_an_option_counts_as_an_input_only_where_it_is_used() -> None:
    plain, used = Hyperparameters().model_dump(), Hyperparameters(return_steps=3).model_dump()
    assert "return_steps" not in plain
    assert used == {**plain, "return_steps": 3}


def test_the_papers_suite_has_eight_styles_fine_tuned_as_in_its_table() -> None:
    suite = load_training(SUITES / "train-paper.yaml")
    assert suite.human is not None
    styles = {(s.weights, s.svo) for n, s in suite.stages.items() if n != "level_1"}
    assert len(styles) == 8
    tuned = [s for s in suite.human_stages.values() if s.fine_tunes]
    assert len({s.fine_tunes for s in tuned}) == 8
    for stage in tuned:
        ft = suite.human.settings_of(stage)
        assert (ft.learning_rate, ft.batch_size, ft.epochs, ft.pull) == (1e-6, 128, 8, 0.2)


def test_environments_are_divided_equally_among_the_conditions() -> None:
    suite = load_training(SHIPPED)
    stage = suite.stages["efficient_egoistic"]
    places = suite.places_of(stage)
    assert len(places) == 25
    assert suite.hyperparameters.scenes % len(places) == 0
    scenes = [scene for scene, _ in places]
    assert {scene.lanes for scene in scenes} == {2, 3, 5}
    assert {scene.density for scene in scenes} == {1.0, 1.5, 2.0}
    assert {scene.profile.target_speed_steps_mps for scene in scenes} == {(0.25, 0.5, 1.0, 2.0)}
    assert set(suite.drivers_of(stage)) == {"human", "idm_mobil", "level_1"}


def test_a_condition_changes_what_it_names_and_nothing_else() -> None:
    stage = load_training(SHIPPED).stages["level_1"]
    scene, traffic = stage.scene, stage.traffic
    changed_scene = Condition(lanes=5, density=2.0, duration_s=7.0).applied(scene, traffic)
    assert (changed_scene.lanes, changed_scene.density, changed_scene.duration_s) == (5, 2.0, 7.0)
    assert Condition().applied(scene, traffic) == scene
    named = {"lanes", "density", "duration_s"}
    assert changed_scene.model_dump(exclude=named) == scene.model_dump(exclude=named)


def test_without_a_reward_of_its_own_a_stage_has_the_papers() -> None:
    suite = load_training(SUITES / "train-paper.yaml")
    for stage in suite.stages.values():
        assert isinstance(stage.reward_of(suite.weights), StyleReward)
    suite = load_training(SHIPPED)
    reward = suite.stages["safe_altruistic"].reward_of(suite.weights)
    assert isinstance(reward, CompletedReward)
    assert (reward.scales.safety_horizon_s, reward.scales.conflict_cost) == (8.0, 25.0)


def test_options_that_the_paper_lacks_leave_the_keys_of_its_stages_as_they_were() -> None:
    assert "loss" not in Supervised().model_dump()
    assert Supervised(loss="cross_entropy").model_dump()["loss"] == "cross_entropy"
    assert not {"labels", "step_mps"} & SampleSettings().model_dump().keys()
    assert "prior_weight" not in Hyperparameters().model_dump()
