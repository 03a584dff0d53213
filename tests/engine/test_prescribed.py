"""Prescribed motion: what a scenario asks for is what a vehicle does, in both engines."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from charms_baselines.idm_mobil import IdmMobil

from charms_bench.engine import MakeEngine
from charms_bench.engine.batched import BatchedEngine
from charms_bench.engine.simulation import Simulation
from charms_bench.engine.state import check_settings
from charms_bench.engine.state_file import save_state
from charms_bench.errors import InputError
from charms_bench.plugins.specs import TrafficSpec
from charms_bench.testing.reference_engine import ENGINES
from charms_bench.world.scenario import Scenario
from charms_bench.world.scene import SceneSettings

PROFILE = {"name": "charms", "speed_min_mps": 0.0, "ego_control_rate": "simulation"}


def settings_of(vehicles: list[dict[str, Any]], **parameters: Any) -> SceneSettings:
    made = Scenario.model_validate(
        {"parameters": parameters, "ego": {"lane": 2, "speed_mps": 20}, "vehicles": vehicles}
    )
    scene = SceneSettings.model_validate({"profile": PROFILE, "duration_s": 10.0})
    return scene.of_scenario(made)


def states(
    vehicles: list[dict[str, Any]], engine: MakeEngine = BatchedEngine, **parameters: Any
) -> dict[str, np.ndarray]:
    """The states [T + 1, N] of the first point's episode, without the ego."""
    settings = settings_of(vehicles, **parameters)
    assert settings.scenario is not None
    traffic = TrafficSpec(scenario=settings.scenario).make()
    agents = {"idm_mobil": IdmMobil()}
    simulation = Simulation(settings, 2, "idm_mobil", traffic, agents, engine)
    simulation.reset(np.arange(2, dtype=np.uint64))
    names = ("x", "y", "speed", "acceleration", "target_lane", "crashed")
    frames = [{name: getattr(simulation.scene, name)[0, 1:].copy() for name in names}]
    for _ in range(150):
        simulation.advance()
        frames.append({name: getattr(simulation.scene, name)[0, 1:].copy() for name in names})
    return {name: np.stack([frame[name] for frame in frames]) for name in names}


def leader(*actions: dict[str, Any], lane: int = 1) -> list[dict[str, Any]]:
    at = {"name": "leader", "lane": lane, "ahead_of": "ego", "gap_m": 60, "speed_mps": 24}
    return [{**at, "actions": list(actions)}]


@pytest.mark.parametrize("engine", ENGINES)
def test_a_leader_brakes_at_6_mps2_after_3_s(engine: MakeEngine) -> None:
    found = states(leader({"at_s": 3, "acceleration_mps2": -6}), engine)
    speed, t = found["speed"][:, 0], np.arange(151) / 15
    np.testing.assert_allclose(speed, np.clip(24 - 6 * (t - 3), 0, 24), atol=1e-9)
    # 24 m/s for 3 s and 24^2 / 12 m to a standstill; the engine moves by the speed before a step.
    stopped = found["x"][-1, 0] - found["x"][0, 0]
    assert stopped == pytest.approx(72 + 48 + 24 / 15 / 2, abs=1e-6)


def test_an_acceleration_ends_at_its_speed() -> None:
    actions = ({"at_s": 1, "acceleration_mps2": -2, "until_mps": 20},
               {"at_s": 6, "acceleration_mps2": 3, "until_mps": 21})  # fmt: skip
    speed = states(leader(*actions))["speed"][:, 0]
    assert speed[6 * 15] == pytest.approx(20, abs=1e-9)
    assert speed[-1] == pytest.approx(21, abs=1e-9)
    assert speed.min() == pytest.approx(20, abs=1e-9)


@pytest.mark.parametrize("engine", ENGINES)
def test_a_cut_in_follows_its_path(engine: MakeEngine) -> None:
    actions = ({"at_s": 1, "lane": 1, "duration_s": 4}, {"at_s": 6, "lane": 0, "duration_s": 2})
    found = states(leader(*actions, lane=0), engine)
    t = np.arange(151) / 15
    path = 4 * np.clip((t - 1) / 4, 0, 1) - 4 * np.clip((t - 6) / 2, 0, 1)
    np.testing.assert_allclose(found["y"][:, 0], path, atol=1e-9)
    assert found["target_lane"][[0, 30, 105], 0].tolist() == [0, 1, 0]


def test_a_prescribed_vehicle_that_crashes_becomes_a_wreck() -> None:
    wall = {"name": "wall", "lane": 1, "ahead_of": "leader", "gap_m": 20, "speed_mps": 0}
    found = states([*leader(), wall])
    assert found["crashed"][-1].all()
    assert found["speed"][-1, 0] < 1.0


@pytest.mark.parametrize("saved_in", ENGINES)
@pytest.mark.parametrize("continued_in", ENGINES)
def test_a_scenario_continues_from_a_state_as_if_never_interrupted(
    saved_in: MakeEngine, continued_in: MakeEngine, tmp_path: Path
) -> None:
    settings = settings_of(
        leader({"at_s": 2, "acceleration_mps2": -6}, {"at_s": 1, "lane": 2, "duration_s": 3}),
        distance=[40, 80],
    )
    assert settings.scenario is not None
    traffic = TrafficSpec(scenario=settings.scenario).make()
    original, later = (
        Simulation(settings, 2, "idm_mobil", traffic, {"idm_mobil": IdmMobil()}, engine)
        for engine in (saved_in, continued_in)
    )
    original.reset(np.array([4, 5], dtype=np.uint64))
    for _ in range(20):
        original.advance()
    state = original.state()
    later.restore(state)
    for _ in range(60):
        original.advance()
        later.advance()
    for name in ("x", "y", "speed", "heading"):
        found, expected = (getattr(each.scene, name) for each in (later, original))
        np.testing.assert_allclose(found, expected, rtol=0, atol=1e-6)
    with pytest.raises(InputError, match="a state of a scenario stays in memory"):
        save_state(state, tmp_path / "state.json")
    other = settings_of(leader(), distance=[40, 80])
    with pytest.raises(InputError, match="another scenario"):
        check_settings(state.settings, other)
