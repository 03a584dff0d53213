"""Vehicles of the profile `naturalistic` queue behind stationary leaders, and start after them."""

from typing import Any

import numpy as np
import pytest

from charms_bench.engine import MakeEngine
from charms_bench.engine.batched import BatchedEngine
from charms_bench.engine.simulation import Simulation
from charms_bench.plugins.registry import make_agent
from charms_bench.plugins.specs import TrafficSpec
from charms_bench.testing.reference_engine import ENGINES
from charms_bench.world.scenario import Scenario
from charms_bench.world.scene import Floats, SceneSettings

STOP = {"at_s": 1, "acceleration_mps2": -4, "until_mps": 0}
START = {"at_s": 25, "acceleration_mps2": 1.5, "until_mps": 25}


def queue(engine: MakeEngine, profile: object = "naturalistic") -> tuple[Simulation, Floats]:
    """The speeds (T, N) of vehicles behind two leaders that stop side by side, and then start."""
    leaders: list[dict[str, Any]] = [
        {"name": f"leader {k}", "lane": k, "x_m": 250, "speed_mps": 20, "actions": [STOP, START]}
        for k in range(2)
    ]
    car = {"behind": "ego", "gap_m": 20, "speed_mps": 25, "agent": "idm_mobil"}
    others = [{"name": f"follower {k}", "lane": k, **car} for k in range(2)]
    ego = {"lane": 0, "speed_mps": 25, "x_m": 100}
    scenario = Scenario.model_validate({"ego": ego, "vehicles": [*leaders, *others]})
    fields = {"profile": profile, "lanes": 2, "duration_s": 60}
    settings = SceneSettings.model_validate(fields).of_scenario(scenario)
    agents = {"idm_mobil": make_agent("idm_mobil")}
    traffic = TrafficSpec(scenario=scenario).make()
    made = Simulation(settings, 1, "idm_mobil", traffic, agents, engine)
    made.reset(np.zeros(1, dtype=np.uint64))
    speeds = []
    while made.scene.active.any():
        made.advance()
        if made.phase == settings.steps_per_decision:
            made.finish_step()
        speeds.append(made.scene.speed[0].copy())
    return made, np.array(speeds)


def test_vehicles_stop_behind_a_stationary_leader_and_start_after_it() -> None:
    made, speeds = queue(BatchedEngine)
    assert not made.scene.crashed.any()
    assert (speeds >= 0.0).all()
    assert (speeds.min(axis=0) == 0.0).all()
    started = (speeds[::-1] == 0.0).argmax(axis=0)  # steps since a vehicle last stood
    assert (started[[1, 2]] > started[[0, 4]].max()).all()
    assert (speeds[-1] > 20.0).all()


def test_a_stationary_vehicle_has_no_acceleration() -> None:
    made, speeds = queue(BatchedEngine, {"name": "naturalistic", "road_length_m": 5000.0})
    stands = speeds[300] == 0.0
    assert stands.all()
    made.reset(np.zeros(1, dtype=np.uint64))
    for _ in range(60):
        made.step()
    np.testing.assert_allclose(made.scene.acceleration, 0.0, rtol=0, atol=1e-12)


def test_highway_envs_vehicles_roll_back_instead() -> None:
    _, speeds = queue(BatchedEngine, {"name": "naturalistic", "can_reverse": True})
    assert speeds.min() < 0.0


@pytest.mark.parametrize("profile", ["naturalistic", {"name": "highway-env", "can_reverse": False}])
def test_both_engines_stop_and_start_alike(profile: object) -> None:
    (ours, speeds), (theirs, expected) = (queue(engine, profile) for engine in ENGINES)
    np.testing.assert_allclose(speeds, expected, rtol=0, atol=1e-9)
    np.testing.assert_allclose(ours.scene.x, theirs.scene.x, rtol=0, atol=1e-9)
    np.testing.assert_allclose(ours.scene.acceleration, theirs.scene.acceleration, atol=1e-9)
