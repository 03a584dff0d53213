"""Files of networks say what a policy needs beside its weights."""

# ruff: noqa: E402  (nothing below can be imported without the extra 'train')

import json
from pathlib import Path

import numpy as np
import pytest

torch = pytest.importorskip("torch", reason="needs the extra 'train'")
pytest.importorskip("onnx", reason="needs the extra 'train'")

from charms_agents.training.network_file import export

from charms_bench.plugins.onnx_policy import OnnxPolicy


def test_speed_steps_are_read_as_they_were_written(tmp_path: Path) -> None:
    network = torch.nn.Sequential(torch.nn.Linear(35, 5))
    facts = {"target_speed_steps_mps": json.dumps([0.1, 0.25, 2])}
    export(network, tmp_path / "policy.onnx", facts, np.zeros((1, 7, 5), dtype=np.float32))
    assert OnnxPolicy(tmp_path / "policy.onnx").target_speed_steps_mps == (0.1, 0.25, 2.0)
