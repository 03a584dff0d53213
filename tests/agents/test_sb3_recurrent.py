"""Checkpoints of sb3-contrib's RecurrentPPO become ONNX files with states, and stochastic ones."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from charms_agents.training.sb3_export import export_zip
from command_line import charms_bench
from handmade_weights import dqn_weights, ppo_weights, recurrent_weights
from made_checkpoints import Blank, zipped

from charms_bench.errors import ModelError
from charms_bench.plugins.onnx_policy import OnnxPolicy


def lstm(layers: int) -> Any:
    torch.manual_seed(layers)
    made = torch.nn.LSTM(35, 12, layers)
    with torch.no_grad():  # torch's initial gates are all nearly half open
        for parameter in made.parameters():
            parameter.mul_(4.0)
    return made


def observed(vehicles: int, seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).uniform(-1, 1, (vehicles, 7, 5)).astype(np.float32)


@pytest.mark.parametrize("layers", [1, 3])
def test_the_file_computes_the_lstm_of_the_checkpoint(tmp_path: Path, layers: int) -> None:
    network = lstm(layers)
    path = zipped(tmp_path, recurrent_weights(network))
    made = export_zip(path, tmp_path / "out.onnx", {})
    assert (made["sizes"], made["ties"]) == ([35, *[12] * layers, 5], 0)
    policy, memory, state = OnnxPolicy(tmp_path / "out.onnx"), np.zeros((90, 24 * layers)), None
    for step in range(6):
        seen = observed(90, step)
        with torch.no_grad():
            out, state = network(torch.tensor(seen.reshape(1, 90, 35)), state)
        values, memory = policy.values_and_memory(seen, memory)
        np.testing.assert_allclose(values, out[0, :, :5], rtol=0, atol=1e-5)
    h, c = state
    parts = [each[index] for index in range(layers) for each in (h, c)]
    np.testing.assert_allclose(memory, torch.cat(parts, dim=1), rtol=0, atol=1e-5)


SETTINGS = {
    "as it comes": {},
    "two layers": {"n_lstm_layers": 2},
    "one LSTM for both": {"shared_lstm": True, "enable_critic_lstm": False},
    "no LSTM for the critic": {"enable_critic_lstm": False, "activation_fn": torch.nn.ReLU},
    "no hidden layers": {"net_arch": []},
}


@pytest.mark.parametrize("settings", SETTINGS.values(), ids=SETTINGS.keys())
def test_the_file_acts_as_a_recurrent_ppo(tmp_path: Path, settings: dict[str, Any]) -> None:
    contrib = pytest.importorskip("sb3_contrib", reason="`tox -e libraries` has it")
    kwargs = {"lstm_hidden_size": 16, "net_arch": [8], **settings}
    model = contrib.RecurrentPPO("MlpLstmPolicy", Blank(), policy_kwargs=kwargs, device="cpu")
    with torch.no_grad():  # untrained logits are all but equal
        for parameter in model.policy.parameters():
            parameter.mul_(3.0)
    model.save(tmp_path / "model.zip")
    export_zip(tmp_path / "model.zip", tmp_path / "out.onnx", {})
    policy = OnnxPolicy(tmp_path / "out.onnx")
    memory, state, chosen = np.zeros((50, policy.memory_width)), None, set()
    for step in range(12):
        seen, begins = observed(50, step), np.random.default_rng(step).random(50) < 0.1
        expected, state = model.predict(seen, state, begins, deterministic=True)
        memory[begins] = 0.0
        found, memory = policy.decide(seen, memory, np.zeros((50, 0)))
        np.testing.assert_array_equal(found, expected)
        chosen |= {*expected.tolist()}
    parts = [each[index] for index in range(len(state[0])) for each in state]
    np.testing.assert_allclose(memory, np.concatenate(parts, axis=1), rtol=0, atol=1e-5)
    assert len(chosen) > 2


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"lstm_actor__bias_hh_l1": None}, "has no lstm_actor.bias_hh_l1; expected the LSTM"),
        ({"lstm_actor__bias_hh_l0": None}, "has no lstm_actor.bias_hh_l0; expected the LSTM"),
        ({"lstm_actor__bias_hh_l0": torch.zeros(0)}, r"bias_hh_l0 is of shape \(0,\)"),
        (
            {"lstm_actor__weight_ih_l0": torch.zeros(48, 25)},
            "takes 25 numbers; expected 35, the obs.*--observation",
        ),
        ({"lstm_actor__weight_ih_l0_reverse": torch.zeros(48, 35)}, "weight_ih_l0_reverse"),
        ({"lstm_actor__bias_ih_l0": torch.zeros(48).double()}, "bias_ih_l0 is torch.float64; exp"),
        ({"lstm_actor__bias_ih_l1": torch.full((48,), torch.inf)}, "weights are not finite"),
        ({"lstm_actor__weight_hh_l1": torch.zeros(1).expand(48, 12)}, "repeats stored numbers"),
        ({"action_net__weight": torch.zeros(5, 35)}, "takes 35 .* 12, the outputs of the LSTM"),
    ],
)
def test_lstms_of_another_shape_are_named(
    tmp_path: Path, changes: dict[str, Any], message: str
) -> None:
    path = zipped(tmp_path, recurrent_weights(lstm(2), **changes))
    with pytest.raises(ModelError, match=message):
        export_zip(path, tmp_path / "out.onnx", {})
    assert not (tmp_path / "out.onnx").exists()


def test_a_stochastic_file_draws_each_action_with_its_probability(tmp_path: Path) -> None:
    logits = torch.tensor([0.5, -2.0, 1.0, 0.0, -8.0])
    path = zipped(tmp_path, ppo_weights(action_net__bias=logits))
    export_zip(path, tmp_path / "out.onnx", {}, stochastic=True)
    policy, count = OnnxPolicy(tmp_path / "out.onnx"), 200_000
    assert (policy.noise_draws, policy.memory_width) == (5, 0)
    draws = np.random.default_rng(0).random((count, 5))
    found = policy.decide(np.zeros((count, 7, 5), np.float32), np.zeros((count, 0)), draws)
    expected = count * torch.softmax(logits, dim=0).numpy()
    difference = np.bincount(found, minlength=5) - expected
    assert (np.abs(difference) < 4 * np.sqrt(expected)).all()


def test_a_draw_of_zero_and_of_almost_one_have_values(tmp_path: Path) -> None:
    export_zip(zipped(tmp_path, ppo_weights()), tmp_path / "out.onnx", {}, stochastic=True)
    policy, seen = OnnxPolicy(tmp_path / "out.onnx"), np.zeros((2, 7, 5), np.float32)
    draws = np.array([[0.0] * 5, [0.0, 0.5, np.nextafter(1, 0), 0.5, 1e-300]])
    values, _ = policy.values_and_memory(seen, noise=draws)
    assert np.isfinite(values).all()
    assert values[1].argmax() == 2


def test_a_recurrent_policy_can_be_stochastic_too(tmp_path: Path) -> None:
    path = zipped(tmp_path, recurrent_weights(lstm(1)))
    arguments = [path, tmp_path / "out.onnx", "--stochastic", "--json"]
    assert charms_bench("export", *arguments).returncode == 0
    policy, seen = OnnxPolicy(tmp_path / "out.onnx"), observed(30)
    certain, after = policy.decide(seen, np.zeros((30, 24)), np.full((30, 5), 0.5))
    drawn, again = policy.decide(seen, np.zeros((30, 24)), np.eye(5)[np.arange(30) % 5] * 0.999999)
    assert len({*certain.tolist()}) > 1
    np.testing.assert_array_equal(drawn, np.arange(30) % 5)
    np.testing.assert_array_equal(after, again)


def test_what_has_no_probabilities_is_not_stochastic(tmp_path: Path) -> None:
    path = zipped(tmp_path, dqn_weights())
    with pytest.raises(ModelError, match="does not draw its actions; --stochastic is for a PPO or"):
        export_zip(path, tmp_path / "out.onnx", {}, stochastic=True)
