"""Files of networks say what a policy needs beside its weights."""

from copy import deepcopy
from pathlib import Path

import numpy as np
import onnx
import pytest
import torch
from charms_agents.training.network_file import export

from charms_bench.errors import ModelError
from charms_bench.plugins.onnx_policy import OnnxPolicy
from charms_bench.world.actions import ACTIONS, DEFAULT_ACTIONS, MetaAction, with_speed_steps

BRAKE = MetaAction("BRAKE", speed_from_present_mps=-6.0)


@pytest.mark.parametrize(
    ("actions", "keys"),
    [
        (DEFAULT_ACTIONS, {"actions": ", ".join(ACTIONS)}),
        (
            with_speed_steps(0.1, 0.25, 2),
            {"actions": ", ".join(ACTIONS), "target_speed_steps_mps": "[0.1, 0.25, 2.0]"},
        ),
        (
            (*DEFAULT_ACTIONS, BRAKE),
            {"actions": '["LANE_LEFT", "IDLE", "LANE_RIGHT", "FASTER", "SLOWER", '
                        '{"name": "BRAKE", "speed_from_present_mps": -6.0}]'},
        ),
        (with_speed_steps(0.25, 0.5, actions=(*DEFAULT_ACTIONS, BRAKE)), None),
    ],
)  # fmt: skip
@pytest.mark.parametrize("masked", [False, True])
def test_actions_are_read_as_they_were_written(
    tmp_path: Path, actions: tuple[MetaAction, ...], keys: dict[str, str] | None, masked: bool
) -> None:
    network = torch.nn.Sequential(torch.nn.Linear(35, len(actions)))
    seen, path = np.zeros((1, 7 + masked, 5), dtype=np.float32), tmp_path / "policy.onnx"
    export(network, path, {}, seen, masked=masked, stochastic=True, actions=actions)
    assert OnnxPolicy(path).actions == actions
    said = {prop.key: prop.value for prop in onnx.load(path).metadata_props}
    assert keys is None or {key: said.get(key) for key in said if key != "observation"} == keys


@pytest.mark.parametrize(("value", "is_a_tie"), [(40.0, False), (400.0, True)])
def test_larger_values_may_differ_by_more(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, value: float, is_a_tie: bool
) -> None:
    layer = torch.nn.Linear(35, 5)
    with torch.no_grad():
        layer.weight.zero_()
        layer.bias.copy_(torch.tensor([value, value + 2e-4, 0.0, 0.0, 0.0]))
    # As if onnxruntime had rounded the second value down below the first.
    monkeypatch.setattr(OnnxPolicy, "actions_of", lambda _, values: np.zeros(len(values), int))
    seen, path = np.zeros((3, 7, 5), dtype=np.float32), tmp_path / "policy.onnx"
    if is_a_tie:
        assert export(torch.nn.Sequential(layer), path, {}, seen)["ties"] == 3
    else:
        with pytest.raises(ModelError, match="in 3 of 3 observations"):
            export(torch.nn.Sequential(layer), path, {}, seen)


def test_values_may_differ_by_what_the_network_itself_rounds(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The first layer adds 10^6, which the last one takes off, so values are rounded to 0.06."""
    rng, first, last = np.random.default_rng(0), torch.nn.Linear(35, 5), torch.nn.Linear(5, 5)
    with torch.no_grad():
        first.bias.fill_(1e6)
        last.weight.copy_(torch.eye(5))
        last.bias.fill_(-1e6)
    network = torch.nn.Sequential(first, torch.nn.ReLU(), last)
    seen = rng.uniform(-1, 1, (2000, 7, 5)).astype(np.float32)
    with torch.no_grad():
        values = network(torch.from_numpy(seen).flatten(1)).numpy()
        exact = deepcopy(network).double()(torch.from_numpy(seen).double().flatten(1)).numpy()
    second = np.argsort(values, axis=1)[:, -2]
    lost = values.max(axis=1) - values[np.arange(2000), second]
    close = lost < 4 * np.abs(values - exact).max()
    assert close.any()
    chosen = np.where(close, second, values.argmax(axis=1))
    monkeypatch.setattr(OnnxPolicy, "actions_of", lambda _, values: chosen[: len(values)])
    made = export(network, tmp_path / "policy.onnx", {}, seen)
    assert made["ties"] == (chosen != values.argmax(axis=1)).sum() > 100
