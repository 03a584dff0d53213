"""One network that is given the style in which it drives: its training, its file, its use."""

from math import cos, pi
from pathlib import Path

import numpy as np
import onnx
import pytest
import torch
from charms_agents.training import pipeline
from charms_agents.training.completed_reward import CompletedReward, RewardScales
from charms_agents.training.job import reinforcement_job
from charms_agents.training.network_file import export
from charms_agents.training.reinforcement import Reinforcement
from charms_agents.training.rewards import Weights
from charms_agents.training.suite_file import load_training
from pydantic import ValidationError

from charms_bench.envs.vector_env import HighwayVectorEnv
from charms_bench.errors import ModelError, SuiteError
from charms_bench.plugins.onnx_policy import OnnxPolicy
from charms_bench.plugins.registry import make_agent
from charms_bench.plugins.specs import AgentSpec
from charms_bench.plugins.traffic import OneAgent
from charms_bench.runs.suite import EgoEntry
from charms_bench.world.scene import SceneSettings

SUITE = """
pipeline: charms
hyperparameters:
  {hidden_layers: [16], scenes: 12, steps_per_gradient_step: 6, learning_starts: 12, batch_size: 16,
   replay_buffer: 240, target_update_steps: 12, standardised: true, prior_weight: 1.0}
curve_steps: 120
weights:
  fast: {safety: 0.2, efficiency: 1.0, comfort: 0.2}
  safe: {safety: 1.0, efficiency: 0.2, comfort: 0.2}
stages:
  drivers:
    steps: 120
    styles:
      hurried: {weights: fast, svo: competitive}
      kind: {weights: safe, svo: prosocial}
      other: {weights: safe, svo: altruistic, svo_angle_rad: 1.2}
    reward: {failure_cost: 50.0}
    scene: {duration_s: 5.0}
    traffic: idm_mobil
"""
TUNED = "human: {recordings: none, stages: {tuned: {fine_tunes: drivers}}}\n"
CAREFUL, HURRIED = (Weights(safety=s, efficiency=1.2 - s, comfort=0.2) for s in (1.0, 0.2))


def test_each_scene_has_the_reward_of_its_style() -> None:
    weights, angles = (CAREFUL, HURRIED, CAREFUL), (0.0, -pi / 4, pi / 4)
    scales, settings = RewardScales(), SceneSettings(traffic_vehicles=20, density=1.5)
    together = CompletedReward(weights, angles, scales)
    alone = [CompletedReward(*style, scales) for style in zip(weights, angles, strict=True)]
    drivers, found = {"idm_mobil": make_agent("idm_mobil")}, []
    for reward in (together, *alone):
        made = HighwayVectorEnv(settings, 9, OneAgent("idm_mobil"), drivers, reward, 0)
        made.reset()
        rng = np.random.default_rng(0)
        found.append(np.array([made.step(rng.integers(5, size=9))[1] for _ in range(8)]))
    for k, rewards in enumerate(found[1:]):
        np.testing.assert_array_equal(found[0][:, k::3], rewards[:, k::3])
    assert len({round(float(rewards.sum()), 6) for rewards in found}) == 4


def trained(folder: Path) -> Path:
    (folder / "styles.yaml").write_text(SUITE)
    pipeline.run(folder / "styles.yaml", folder / "run", workers=1)
    return folder / "run" / "networks" / "drivers.onnx"


def test_a_stage_of_several_styles_writes_one_network_that_is_given_each(tmp_path: Path) -> None:
    file = trained(tmp_path)
    seen = np.random.default_rng(1).uniform(-1, 1, (200, 7, 5)).astype(np.float32)
    values = {}
    for name in ("hurried", "kind", "other", None):
        values[name] = OnnxPolicy(file, style=name).values_and_memory(seen)[0]
    np.testing.assert_array_equal(values[None], values["hurried"])
    assert not np.allclose(values["kind"], values["hurried"])
    assert not np.allclose(values["kind"], values["other"])
    said = {prop.key: prop.value for prop in onnx.load(file).metadata_props}
    assert said["style"] == "as given"
    # cos phi and sin phi of -45 degrees, and the weights of safety, efficiency and comfort.
    half = cos(pi / 4)
    numbers = torch.tensor(OnnxPolicy(file)._given[0])
    torch.testing.assert_close(numbers, torch.tensor([half, -half, 0.2, 1.0, 0.2]))


def with_styles(folder: Path, said: str) -> Path:
    """The network whose values are the numbers of its style, with the metadata `said`."""
    layer = torch.nn.Linear(37, 5)
    with torch.no_grad():
        layer.weight.zero_(), layer.bias.zero_()
        layer.weight[1, 35] = layer.weight[3, 36] = 1.0
    seen, file = np.zeros((4, 7, 5), np.float32), folder / "styled.onnx"
    styles = {"calm": [1.0, 0.0], "quick": [0.0, 1.0]}
    export(torch.nn.Sequential(layer), file, {}, seen, styles=styles)
    model = onnx.load(file)
    for prop in model.metadata_props:
        if prop.key == "styles":
            prop.value = said or prop.value
    onnx.save(model, file)
    return file


def test_the_style_decides_what_the_network_does(tmp_path: Path) -> None:
    file, seen = with_styles(tmp_path, ""), np.zeros((3, 7, 5), np.float32)
    assert [*OnnxPolicy(file, style="calm").decide(seen)] == [1, 1, 1]
    assert [*OnnxPolicy(file, style="quick").decide(seen)] == [3, 3, 3]
    specs = [AgentSpec.model_validate({"onnx": str(file), "style": name}) for name in ("calm",
             "quick")]  # fmt: skip
    made = [spec.make({str(file): file}) for spec in specs]
    assert [policy.decide(seen)[0] for policy in made if isinstance(policy, OnnxPolicy)] == [1, 3]
    assert len({spec.key for spec in specs}) == 2
    assert [EgoEntry(agent=spec).title for spec in specs] == [f"{file}, calm", f"{file}, quick"]


@pytest.mark.parametrize(
    ("style", "said", "message"),
    [
        ("quiet", "", r"styled.onnx: has no style 'quiet'. Did you mean 'quick'"),
        (
            None,
            "calm",
            r"styled.onnx: metadata: styles is 'calm'; expected a JSON",
        ),
        (None, '{"calm": [1.0]}', "the 2 numbers of each style"),
        (None, '{"calm": [1.0, NaN]}', "the 2 numbers of each style"),
        (None, '{"calm": [1.0, 1e99]}', "the 2 numbers of each style"),
        (None, "{}", "the 2 numbers of each style"),
    ],
)
def test_a_style_that_a_file_does_not_have_is_named(
    tmp_path: Path, style: str | None, said: str, message: str
) -> None:
    file = with_styles(tmp_path, said)
    with pytest.raises(ModelError, match=message):
        OnnxPolicy(file, style=style)


def test_a_style_is_for_networks_that_are_given_one(tmp_path: Path) -> None:
    file, layer = tmp_path / "plain.onnx", torch.nn.Linear(35, 5)
    export(torch.nn.Sequential(layer), file, {}, np.zeros((1, 7, 5), np.float32))
    with pytest.raises(ModelError, match="has no style 'calm': it drives in one style"):
        OnnxPolicy(file, style="calm")
    with pytest.raises(ValidationError, match="style is for networks given by path"):
        AgentSpec.model_validate({"name": "idm_mobil", "style": "calm"})


@pytest.mark.parametrize(
    ("before", "after", "message"),
    [
        ("    styles:\n", "    svo: egoistic\n    styles:\n", "weights and svo, or styles instead"),
        ("    reward: {failure_cost: 50.0}\n", "", "expected a reward beside styles"),
        ("{weights: fast, svo", "{weights: slow, svo", "styles.hurried.weights: no weights named"),
        ("scenes: 12, steps_per_gradient_step: 6", "scenes: 4, steps_per_gradient_step: 2",
         "stages.drivers.styles: 4 scenes a condition are not a multiple"),
        ("stages:\n  drivers", f"{TUNED}stages:\n  drivers",
         "human.stages.tuned.fine_tunes: 'drivers' has several styles; expected a stage with one"),
    ],
)  # fmt: skip
def test_styles_that_cannot_be_trained_are_named(
    tmp_path: Path, before: str, after: str, message: str
) -> None:
    assert SUITE.count(before) == 1
    (tmp_path / "styles.yaml").write_text(SUITE.replace(before, after))
    with pytest.raises(SuiteError, match=message):
        load_training(tmp_path / "styles.yaml")


def test_a_stage_can_drive_in_its_own_traffic_and_continues_with_the_same_bits(
    tmp_path: Path,
) -> None:
    file = tmp_path / "styles.yaml"
    file.write_text(SUITE.replace("traffic: idm_mobil", "traffic: drivers"))
    suite = load_training(file)
    stage = suite.stages["drivers"]
    assert suite.needs == {"drivers": ()}
    whole, first, second = (Reinforcement(suite, stage, {}, None) for _ in range(3))
    for _ in range(5):
        first._agent.step()
    second.load_arrays(first.arrays())
    for learner in (whole, second):
        learner.learn(lambda: None)
    np.testing.assert_array_equal(whole.observations, second.observations)
    for ours, theirs in zip(whole.network.parameters(), second.network.parameters(), strict=True):
        np.testing.assert_array_equal(ours.detach().numpy(), theirs.detach().numpy())


def test_own_traffic_does_what_the_network_does_in_the_style_that_each_vehicle_has_drawn(
    tmp_path: Path,
) -> None:
    (tmp_path / "styles.yaml").write_text(SUITE.replace("traffic: idm_mobil", "traffic: drivers"))
    suite = load_training(tmp_path / "styles.yaml")
    learner = Reinforcement(suite, suite.stages["drivers"], {}, None)
    learner.learn(lambda: None)
    own, count = learner.own_traffic, 200
    seen = np.random.default_rng(2).uniform(-1, 1, (count, 7, 5)).astype(np.float32)
    noise = np.random.default_rng(3).random((count, own.noise_draws))
    actions, styles = own.decide(seen, np.zeros((count, 1)), noise)
    again, kept = own.decide(seen, styles, 1 - noise)
    np.testing.assert_array_equal(kept, styles)
    np.testing.assert_array_equal(again, actions)
    file = tmp_path / "network.onnx"
    of_styles = suite.styles_of(suite.stages["drivers"])
    export(learner.network, file, {}, seen, styles=of_styles)
    for k, name in enumerate(of_styles):
        some = styles[:, 0] == k + 1
        assert 40 < some.sum() < 95  # of 200 vehicles, a third
        np.testing.assert_array_equal(
            OnnxPolicy(file, style=name).decide(seen[some]), actions[some]
        )


def test_how_much_of_its_traffic_a_stage_drives_itself_is_part_of_what_it_depends_on(
    tmp_path: Path,
) -> None:
    keys = set()
    for traffic in ("drivers", "idm_mobil", "{mixture: {idm_mobil: 0.5, drivers: 0.5}}",
                    "{mixture: {idm_mobil: 0.9, drivers: 0.1}}"):  # fmt: skip
        file = tmp_path / "styles.yaml"
        file.write_text(SUITE.replace("traffic: idm_mobil", f"traffic: {traffic}"))
        suite = load_training(file)
        others = [name for name in suite.drivers_of(suite.stages["drivers"]) if name != "drivers"]
        drivers = {name: make_agent(name) for name in others}
        keys.add(reinforcement_job(tmp_path, "drivers", suite, drivers).folder)
    assert len(keys) == 4
