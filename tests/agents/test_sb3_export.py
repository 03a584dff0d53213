"""Stable-Baselines3 checkpoints become ONNX files; hostile ones do nothing."""

import json
import os
import pickle
import zipfile
from functools import partial
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import onnx
import pytest
import stable_baselines3 as sb3
import torch
from charms_agents.training import sb3_export
from charms_agents.training.network_file import KINDS, read_network
from charms_agents.training.sb3_export import export_zip
from command_line import charms_bench
from handmade_weights import ppo_weights
from made_checkpoints import Blank, zipped
from stable_baselines3.common.torch_layers import FlattenExtractor
from typer.testing import CliRunner

from charms_bench.cli import app
from charms_bench.errors import InputError, ModelError
from charms_bench.plugins.onnx_policy import OnnxPolicy
from charms_bench.testing import example_scene
from charms_bench.world.kinematics_observation import Kinematics
from charms_bench.world.observations import ACTION_MASK, neighbours

SUITE = """\
suite: exported
episodes: 2
scene: {duration_s: 2.0, traffic_vehicles: 5, decision_hz: 5}
egos: [{agent: {onnx: out.onnx}}]
traffic_models: [{traffic: idm_mobil}]
"""
FACTS = {"decision_hz": "5", "style": "hasty"}


def saved(folder: Path, **spaces: Any) -> tuple[Any, Path]:
    """Somebody's DQN and its checkpoint."""
    settings = {"net_arch": [16, 8]}
    model = sb3.DQN("MlpPolicy", Blank(**spaces), buffer_size=10, policy_kwargs=settings, seed=3)
    path = folder / "model.zip"
    model.save(path)
    return model, path


def saved_ppo(folder: Path, **settings: Any) -> tuple[Any, Path]:
    """Somebody's PPO and its checkpoint."""
    kwargs = {"net_arch": {"pi": [16, 8], "vf": [4]}, **settings}
    model = sb3.PPO("MlpPolicy", Blank(), policy_kwargs=kwargs, seed=3, device="cpu")
    with torch.no_grad():  # untrained logits are all but equal, and too small for tanh to matter
        for parameter in model.policy.parameters():
            parameter.mul_(5.0)
    path = folder / "ppo.zip"
    model.save(path)
    return model, path


def saved_actor(folder: Path, kind: str, low: float = -1.0, **settings: Any) -> tuple[Any, Path]:
    """Somebody's SAC or TD3 and its checkpoint."""
    env = Blank()
    env.action_space = gymnasium.spaces.Box(np.array([-1.0, low], np.float32), 1.0)
    kwargs = {"net_arch": [16, 8]} | settings.pop("policy_kwargs", {})
    model = getattr(sb3, kind)(
        "MlpPolicy", env, buffer_size=10, policy_kwargs=kwargs, seed=3, device="cpu", **settings
    )
    path = folder / f"{kind}.zip"
    model.save(path)
    return model, path


class Hostile:
    """Leaves a file behind wherever it is unpickled."""

    def __init__(self, trace: Path) -> None:
        self.trace = trace

    def __reduce__(self) -> tuple[Any, ...]:
        return os.mkdir, (str(self.trace),)


def assert_acts_alike(model: Any, file: Path, most: float = 1.0) -> None:
    """The file takes the model's actions, which are several."""
    observations = np.random.default_rng(0).uniform(-most, most, (200, 7, 5)).astype(np.float32)
    expected, _ = model.predict(observations, deterministic=True)
    np.testing.assert_array_equal(OnnxPolicy(file).decide(observations), expected)
    assert len(set(expected)) > 1


def rejected(path: Path, message: str) -> None:
    output = path.parent / "out.onnx"
    with pytest.raises(ModelError, match=message) as caught:
        export_zip(path, output, FACTS)
    assert str(caught.value).startswith(str(path))
    assert not output.exists()
    assert not list(path.parent.glob(".*.partial"))


class Halved(FlattenExtractor):
    """Changes what the network sees, without weights."""

    def forward(self, observations: Any) -> Any:
        return super().forward(observations) / 2


def test_a_features_extractor_without_weights_is_rejected(tmp_path: Path) -> None:
    _, path = saved_ppo(tmp_path, features_extractor_class=Halved)
    rejected(path, "has the features extractor .*Halved.*; expected MlpPolicy without one")
    _, path = saved_ppo(tmp_path, features_extractor_class=FlattenExtractor)
    export_zip(path, tmp_path / "out.onnx", FACTS)


def test_the_file_acts_as_the_model_that_was_saved(tmp_path: Path) -> None:
    model, path = saved(tmp_path)
    made = export_zip(path, tmp_path / "out.onnx", FACTS)
    assert_acts_alike(model, tmp_path / "out.onnx")
    assert made["sizes"] == [35, 16, 8, 5]
    assert made["observations"] == 4 * 16 * 21
    assert made["ties"] == 0


def test_the_file_says_what_it_is_and_where_it_is_from(tmp_path: Path) -> None:
    _, path = saved(tmp_path)
    made = export_zip(path, tmp_path / "out.onnx", FACTS)
    says = {p.key: p.value for p in onnx.load(tmp_path / "out.onnx").metadata_props}
    assert says["actions"] == "LANE_LEFT, IDLE, LANE_RIGHT, FASTER, SLOWER"
    assert says["observation"].startswith("neighbours: (7, 5) float32")
    assert (says["decision_hz"], says["style"]) == ("5", "hasty")
    assert says["activation"] == "ReLU"
    assert says["source"] == "model.zip, a Stable-Baselines3 checkpoint"
    assert says["source_sha256"] == made["sha256"]


def test_several_checkpoints_are_exported_to_a_folder_under_their_own_names(tmp_path: Path) -> None:
    _, first = saved(tmp_path)
    second = first.rename(tmp_path / "second.zip")
    saved(tmp_path)
    done = charms_bench("export", first, second, "--to", tmp_path / "nets", "--json")
    assert [made["sizes"] for made in json.loads(done.stdout)] == [[35, 16, 8, 5]] * 2
    assert {path.name for path in (tmp_path / "nets").iterdir()} == {"model.onnx", "second.onnx"}
    twice = charms_bench("export", first, tmp_path / "other" / "model.zip", "--to", tmp_path)
    assert (twice.returncode, "have the same name" in twice.stderr) == (2, True)


def test_only_an_exported_network_is_replaced(tmp_path: Path) -> None:
    _, path = saved(tmp_path)
    for _ in range(2):
        assert charms_bench("export", path, tmp_path / "out.onnx").returncode == 0
    (tmp_path / "out.onnx").write_bytes(b"mine")
    answer = charms_bench("export", path, tmp_path / "out.onnx", columns=300)
    assert (answer.returncode, (tmp_path / "out.onnx").read_bytes()) == (2, b"mine")
    assert "out.onnx: already exists, and charms-bench has not written it" in answer.stderr


@pytest.mark.parametrize(
    ("settings", "sizes", "activation"),
    [
        ({}, [35, 16, 8, 5], "Tanh"),
        ({"activation_fn": torch.nn.ReLU}, [35, 16, 8, 5], "ReLU"),
        ({"net_arch": [4]}, [35, 4, 5], "Tanh"),
        ({"net_arch": []}, [35, 5], "Tanh"),
    ],
)
def test_a_ppos_file_takes_its_likeliest_actions(
    tmp_path: Path, settings: dict[str, Any], sizes: list[int], activation: str
) -> None:
    model, path = saved_ppo(tmp_path, **settings)
    made = export_zip(path, tmp_path / "out.onnx", FACTS)
    assert_acts_alike(model, tmp_path / "out.onnx")
    assert (made["sizes"], made["activation"], made["ties"]) == (sizes, activation, 0)


def test_an_activation_that_cannot_be_exported_is_named(tmp_path: Path) -> None:
    _, path = saved_ppo(tmp_path, activation_fn=torch.nn.Hardsigmoid)
    rejected(path, r"has <class '.*Hardsigmoid'> between.*expected ReLU, Tanh, ELU, ")
    _, path = saved_ppo(tmp_path, activation_fn=partial(torch.nn.LeakyReLU, 0.3))
    rejected(path, r"has functools.partial.*LeakyReLU.* between")


@pytest.mark.parametrize("name", sorted({*KINDS} - {"ReLU", "Tanh"}))
def test_the_common_activations_are_exported(tmp_path: Path, name: str) -> None:
    model, path = saved_ppo(tmp_path, activation_fn=getattr(torch.nn, name))
    made = export_zip(path, tmp_path / "out.onnx", FACTS)
    observations = np.random.default_rng(0).uniform(-1, 1, (200, 7, 5)).astype(np.float32)
    with torch.no_grad():
        expected = model.policy.get_distribution(torch.tensor(observations)).distribution.logits
    values = OnnxPolicy(tmp_path / "out.onnx").values_and_memory(observations)[0]
    log_sum = np.log(np.exp(values).sum(axis=1, keepdims=True))
    np.testing.assert_allclose(values - log_sum, expected, rtol=0, atol=1e-4)
    assert made["activation"] == name
    with pytest.raises(ModelError, match="was not written by this pipeline"):
        read_network(tmp_path / "out.onnx")


@pytest.mark.parametrize("kind", ["SAC", "TD3", "DDPG"])
@pytest.mark.parametrize("policy", [{}, {"activation_fn": torch.nn.Tanh}, {"net_arch": []}])
def test_an_actors_file_has_its_continuous_actions(
    tmp_path: Path, kind: str, policy: dict[str, Any]
) -> None:
    model, path = saved_actor(tmp_path, kind, policy_kwargs=policy)
    with torch.no_grad():  # untrained actions are near 0, where tanh does not matter
        for parameter in model.policy.actor.parameters():
            parameter.mul_(4.0)
    model.save(path)
    done = export_zip(path, tmp_path / "out.onnx", FACTS)
    hidden = policy.get("net_arch", [16, 8])
    assert done["sizes"] == [35, *hidden, 2]
    exported = OnnxPolicy(tmp_path / "out.onnx")
    assert exported.actions == "continuous"
    seen = sb3_export._seen(neighbours, 9)
    expected, _ = model.predict(seen, deterministic=True)
    np.testing.assert_allclose(exported.decide(seen), expected, rtol=0, atol=1e-5)
    assert np.ptp(expected, axis=0).min() > 0.1


@pytest.mark.parametrize(
    ("kind", "settings", "message"),
    [
        ("SAC", {"low": -0.5}, r"has actions from \[-1.0, -0.5\] to \[1.0, 1.0\]; expected Box"),
        ("SAC", {"use_sde": True}, "expected a SAC without use_sde"),
    ],
)
def test_other_continuous_policies_are_named(
    tmp_path: Path, kind: str, settings: dict[str, Any], message: str
) -> None:
    _, path = saved_actor(tmp_path, kind, **settings)
    rejected(path, message)


@pytest.mark.parametrize("data", [b"", b"{", b"[" * 10**5, b'{"policy_kwargs": null}', b"\x80\x05"])
def test_without_a_readable_data_the_usual_activation_is_assumed(
    tmp_path: Path, data: bytes
) -> None:
    made = export_zip(zipped(tmp_path, data=data), tmp_path / "out.onnx", FACTS)
    assert made["activation"] == "ReLU (assumed)"
    made = export_zip(zipped(tmp_path, ppo_weights(), data=data), tmp_path / "out.onnx", FACTS)
    assert made["activation"] == "Tanh (assumed)"


def test_a_file_says_to_those_who_go_on_from_it_what_stands_between_its_layers(
    tmp_path: Path,
) -> None:
    _, path = saved_ppo(tmp_path)
    export_zip(path, tmp_path / "out.onnx", FACTS)
    network = read_network(tmp_path / "out.onnx")
    assert [type(module).__name__ for module in network] == [*["Linear", "Tanh"] * 2, "Linear"]


def test_a_flat_observation_is_as_good(tmp_path: Path) -> None:
    _, path = saved(tmp_path, shape=(35,))
    assert export_zip(path, tmp_path / "out.onnx", FACTS)["sizes"][0] == 35


def test_pickled_data_beside_the_weights_is_never_loaded(tmp_path: Path) -> None:
    trace = tmp_path / "trace"
    path = zipped(tmp_path, data=pickle.dumps(Hostile(trace)))
    export_zip(path, tmp_path / "out.onnx", FACTS)
    assert not trace.exists()
    pickle.loads(pickle.dumps(Hostile(trace)))
    assert trace.exists()


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"log_std": torch.zeros(5)}, "has 5 actions; expected 2"),
        ({"lstm_critic__weight_ih_l0": torch.zeros(4, 4)}, "policy.pth holds: lstm_critic.weight"),
        ({"pi_features_extractor__cnn__0__bias": torch.zeros(2)}, "CnnPolicy"),
        ({"action_net__weight": None, "action_net__bias": None}, "holds: value_net.weight"),
        ({"action_net__bias": None}, "expected linear layers"),
        ({"action_net__weight": torch.zeros(5, 25)}, "takes 25 numbers; expected 35"),
        ({"mlp_extractor__policy_net__2__bias": torch.zeros(5)}, r"weights at positions \[2, 4\]"),
    ],
)
def test_policies_that_are_no_ppos_with_an_mlp_are_named(
    tmp_path: Path, changes: dict[str, Any], message: str
) -> None:
    rejected(zipped(tmp_path, ppo_weights(**changes)), message)


def test_a_file_that_would_act_differently_is_not_written(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    _, path = saved(tmp_path)
    zeros = lambda self, values: np.zeros(len(values), np.int64)  # noqa: E731
    monkeypatch.setattr(OnnxPolicy, "actions_of", zeros)
    rejected_output = tmp_path / "out.onnx"
    with pytest.raises(ModelError, match="would act differently from the network"):
        export_zip(path, rejected_output, FACTS)
    assert not rejected_output.exists()


def test_the_checked_observations_are_those_of_moving_scenes() -> None:
    seen = sb3_export._seen(neighbours, 0)
    assert seen.shape == (16 * 21, 7, 5)
    assert (seen[:, 0, 0] == 1).all()
    assert len(np.unique(seen[:, 1:, 0].sum(axis=1))) > 3


def test_the_command_line_exports_and_the_file_drives_in_a_suite(tmp_path: Path) -> None:
    saved(tmp_path)
    export = ["export", "model.zip", "out.onnx", "--decision-hz", "5", "--json"]
    done = charms_bench(*export, cwd=tmp_path)
    assert json.loads(done.stdout)["sizes"] == [35, 16, 8, 5]
    (tmp_path / "suite.yaml").write_text(SUITE)
    ran = charms_bench("run", "suite.yaml", "--workers", 1, "--json", cwd=tmp_path)
    rows = json.loads(ran.stdout)
    assert {row["agent"] for row in rows} == {"out.onnx"}


@pytest.mark.parametrize(
    ("arguments", "observation", "hz"),
    [
        (["--observation", "Kinematics"], Kinematics(), 1.0),
        (
            ["--observation", "{type: Kinematics, vehicles_count: 6, see_behind: true}"],
            Kinematics(vehicles_count=6, see_behind=True),
            1.0,
        ),
        (["--observation", "Kinematics", "--decision-hz", "5"], Kinematics(), 5.0),
        ([], neighbours, 3.0),
        (["--decision-hz", "2"], neighbours, 2.0),
    ],
)
def test_the_file_sees_what_the_command_line_says(
    tmp_path: Path, arguments: list[str], observation: Any, hz: float
) -> None:
    _, path = saved(tmp_path, shape=observation.shape)
    output = tmp_path / "out.onnx"
    done = CliRunner().invoke(app, ["export", str(path), str(output), *arguments])
    assert f"observes {observation.name}, decides at {hz:g} Hz" in done.stdout
    assert ("`simulation_hz: 18`" in done.stdout) == (hz == 2)
    policy = OnnxPolicy(output)
    assert (policy.observation, policy.decision_hz) == (observation, hz)


@pytest.mark.parametrize(
    ("said", "message"),
    [
        ("kinematics", "no observation named 'kinematics'. Did you mean 'Kinematics'"),
        ("{type: Kinematics", "--observation {type: Kinematics: is not YAML"),
        ("neighbours", "takes 25 numbers; expected 35, .* name the observation.* suites have ne"),
    ],
)
def test_what_it_cannot_have_been_trained_on_is_one_message(
    tmp_path: Path, said: str, message: str
) -> None:
    _, path = saved(tmp_path, shape=(5, 5))
    arguments = ["export", str(path), str(tmp_path / "out.onnx"), "--observation", said]
    with pytest.raises(InputError, match=message):
        CliRunner().invoke(app, arguments, catch_exceptions=False)


@pytest.mark.parametrize("stochastic", [False, True])
def test_a_maskable_ppos_file_takes_the_mask(tmp_path: Path, stochastic: bool) -> None:
    _, path = saved_ppo(tmp_path)
    with zipfile.ZipFile(path) as archive:
        members = {name: archive.read(name) for name in archive.namelist()}
    data = json.loads(members["data"])
    data["policy_class"]["__module__"] = "sb3_contrib.common.maskable.policies"
    with zipfile.ZipFile(path, "w") as archive:
        for name, content in (members | {"data": json.dumps(data).encode()}).items():
            archive.writestr(name, content)
    export_zip(path, tmp_path / "ppo.onnx", {}, stochastic=stochastic)
    policy, scene = OnnxPolicy(tmp_path / "ppo.onnx"), example_scene()
    seen = policy.observation(scene, np.nonzero(np.ones(scene.x.shape, np.bool_)))
    noise = np.random.default_rng(0).random((len(seen), 5 * stochastic))
    actions = policy.decide(seen, np.zeros((len(seen), 0)), noise)
    chosen = seen[np.arange(len(seen)), ACTION_MASK, actions]
    assert seen.shape[1:] == (8, 5)
    assert len(set(actions)) == 5 or not stochastic
    assert (chosen == 1).all()
