"""Recorded speeds can be followed by meta-actions as the engine carries them out."""

import importlib.util
from pathlib import Path

import numpy as np
import pytest

from charms_bench.engine.simulation import Simulation
from charms_bench.plugins.traffic import OneAgent
from charms_bench.world.profile import PROFILES
from charms_bench.world.scene import SceneSettings

TOOL = Path(__file__).parents[2] / "tools" / "recorded_through_interface.py"


@pytest.mark.parametrize(
    ("name", "own"), [("charms", ()), ("naturalistic", ()), ("charms", (0.25, 0.5, 1.0, 2.0))]
)
def test_speeds_are_those_of_the_engine(name: str, own: tuple[float, ...]) -> None:
    spec = importlib.util.spec_from_file_location("recorded_through_interface", TOOL)
    assert spec is not None
    assert spec.loader is not None
    tool = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(tool)
    profile = PROFILES[name]
    recorded = profile.ego_speed_mps + 2.0 * np.sin(np.arange(60) / 8)
    expected, actions = tool.through_interface(recorded, profile, own)
    settings = SceneSettings(profile=profile, traffic_vehicles=0, ego_slots=1, duration_s=30.0)
    made = Simulation(settings, 1, None, OneAgent(""), {}, outside_steps_mps=own)
    made.reset(np.zeros(1, dtype=np.uint64))
    for action, speed in zip(actions, expected[1:], strict=True):
        made.step(np.array([action]))
        assert made.scene.speed[0, 0] == pytest.approx(speed, abs=1e-9)
    assert len(set(actions)) == 3
    assert np.abs(expected - recorded).max() < 1.0
