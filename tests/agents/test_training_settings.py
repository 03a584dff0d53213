"""Training suites: what they say, and how they say what is wrong."""

import shutil
from pathlib import Path
from typing import Any

import charms_agents.charms
import pytest
import yaml
from charms_agents.training.settings import FIRST_TRAINING_SEED, Hyperparameters, load_training

from charms_bench.errors import SuiteError
from charms_bench.world.scene import EVALUATION_SEEDS

SUITE = Path(__file__).parents[2] / "suites" / "train.yaml"


def changed(tmp_path: Path, *path: str, value: Any) -> Path:
    """The project's training suite with one value changed."""
    data = yaml.safe_load(SUITE.read_text())
    inner = data
    for key in path[:-1]:
        inner = inner[key]
    inner[path[-1]] = value
    file = tmp_path / "train.yaml"
    file.write_text(yaml.safe_dump(data, sort_keys=False))
    return file


def test_the_projects_suite_trains_with_the_papers_table() -> None:
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
    before = ("level_1", "safe_prosocial")
    assert suite.needed_for("charms_safe_prosocial") == (*before, "charms_safe_prosocial")


def test_traffic_can_have_stages_that_learn_from_human_driving() -> None:
    suite = load_training(SUITE)
    styles = {name for name in suite.human_stages if name.startswith("charms_")}
    assert set(suite.needs["best_response"]) == styles
    assert len(styles) == 8


def test_the_styles_differ_in_weights_and_orientation_alone() -> None:
    suite = load_training(SUITE)
    styles = [
        suite.stages[name.removeprefix("charms_")] for name in suite.human_stages if "_" in name
    ]
    named = {"weights", "svo", "svo_angle_rad"}
    assert len({style.model_dump_json(exclude=named) for style in styles}) == 1
    assert len({(style.weights, style.angle_rad) for style in styles}) == len(styles) == 8


def test_the_traffic_of_a_stage_can_have_networks_by_path(tmp_path: Path) -> None:
    network = Path(charms_agents.charms.__file__).parent / "policies" / "level_1.onnx"
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


@pytest.mark.parametrize(
    ("path", "value", "message"),
    [
        (("hyperparameters", "batch_size"), 0, "hyperparameters.batch_size"),
        (("hyperparameters", "batchsize"), 32, "hyperparameters.batchsize: unknown key"),
        (
            ("hyperparameters", "scenes"),
            7,
            "not a multiple of steps_per_gradient",
        ),
        (("hyperparameters", "replay_buffer"), 50_005, "replay_buffer 50005 is not a multiple"),
        (("curve_steps",), 10_001, "curve_steps: 10001 is not a multiple of scenes 10"),
        (("stages", "level_1", "steps"), 11, "stages.level_1.steps: 11 is not a multiple"),
        (("stages", "level_1", "svo"), "kind", "stages.level_1.svo"),
        (("stages", "level_1", "weights"), "fast", "no weights named 'fast'.*safe, efficient"),
        (("stages", "level_1", "traffic"), {}, "stages.level_1.traffic: give a name"),
        (("stages", "level_1", "traffic"), "level_O", "Did you mean 'level_0'.*this file: level_1"),
        (("stages", "level_1", "traffic"), "prior_level_k", "stages depend on each other"),
        (("stages", "level_1", "traffic"), {"mixture": {"level_9": 1.0}}, "named 'level_9'"),
        (("stages", "level_1", "traffic"), {"mixture": {"level_0": 0.5}}, "must .* sum to 1"),
        (
            ("stages", "prior_level_k", "traffic"),
            {"name": "level_1", "options": {"tau": 1.5}},
            "no traffic named 'level_1'",
        ),
        (("seeds",), [1, 2, 1], "a seed is given twice in seeds"),
        (("stages", "level_1", "variant"), "calm", "no variant named 'calm'; this file has: "),
        (("weights", "safe", "comfort"), -1.0, "weights.safe.comfort"),
        (("stages", "level_1", "scene", "density"), 0, "stages.level_1.scene.density"),
    ],
)
def test_what_is_wrong_is_named_with_its_place(
    tmp_path: Path, path: tuple[str, ...], value: Any, message: str
) -> None:
    file = changed(tmp_path, *path, value=value)
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
    assert "return_steps" not in Hyperparameters().inputs
    assert Hyperparameters(return_steps=3).inputs == {**Hyperparameters().inputs, "return_steps": 3}


def test_a_stage_can_name_other_hyperparameters(tmp_path: Path) -> None:
    file = changed(tmp_path, "variants", "calm", value={"learning_rate": 2e-4})
    data = yaml.safe_load(file.read_text())
    data["stages"]["prior_level_k"]["variant"] = "calm"
    file.write_text(yaml.safe_dump(data, sort_keys=False))
    suite = load_training(file)
    rates = {n: suite.hyperparameters_of(s).learning_rate for n, s in suite.stages.items()}
    assert (rates["level_1"], rates["prior_level_k"]) == (1e-4, 2e-4)


def test_the_papers_suite_has_eight_styles_fine_tuned_as_in_its_table() -> None:
    suite = load_training(SUITE.with_name("train-paper.yaml"))
    assert suite.human is not None
    assert suite.variants == {}
    styles = {(s.weights, s.svo) for n, s in suite.stages.items() if n != "level_1"}
    assert len(styles) == 8
    tuned = [s for s in suite.human_stages.values() if s.fine_tunes]
    assert len({s.fine_tunes for s in tuned}) == 8
    for stage in tuned:
        ft = suite.human.settings_of(stage)
        assert (ft.learning_rate, ft.batch_size, ft.epochs, ft.pull) == (1e-6, 128, 8, 0.2)
