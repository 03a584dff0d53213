"""Remarks name the egos that often command lanes that do not exist."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
from command_line import charms_bench

import charms_bench as bench
from charms_bench.world.actions import LANE_RIGHT

SUITE = """
suite: keeper
episodes: 4
egos: [{agent: keeper.onnx, label: Keeper}, {agent: level_0, label: Level 0}]
traffic_models: [{traffic: level_0, label: Others}]
"""


def test_a_network_is_checked_in_a_scene_that_its_rate_divides(
    network_file: Callable[..., Path], tmp_path: Path
) -> None:
    network_file(
        np.zeros((35, 5), dtype=np.float32), name="seven.onnx", metadata={"decision_hz": "7"}
    )
    checked = charms_bench("check", tmp_path / "seven.onnx")
    assert checked.returncode == 0, checked.stderr


def test_an_ego_that_always_keeps_right_is_remarked_on(
    network_file: Callable[..., Path], tmp_path: Path
) -> None:
    weights = np.zeros((35, 5), dtype=np.float32)
    weights[0, LANE_RIGHT] = 1.0  # the presence of the vehicle itself
    network_file(weights, name="keeper.onnx")
    (tmp_path / "suite.yaml").write_text(SUITE)
    run = bench.run(tmp_path / "suite.yaml", tmp_path / "run", workers=1)
    first, meaning = run.remarks()
    assert first.startswith("Keeper in Others: chose a lane that does not exist in ")
    assert "(LANE_LEFT 0 %, LANE_RIGHT " in first
    assert "has no effect" in meaning
    assert run.remarks(ego="Level 0") == []
    for command in ("show", "edge-cases"):
        said = charms_bench(command, tmp_path / "run").stdout
        assert first in said.splitlines()
