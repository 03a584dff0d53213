"""Gipps's driver model against its equations, in traffic and on another road."""

import math
from typing import Any

import numpy as np
import pytest

from charms_bench.engine.simulation import Simulation
from charms_bench.plugins.registry import make_agent
from charms_bench.plugins.traffic import OneAgent, Placed
from charms_bench.roads.engine import RoadEngine
from charms_bench.roads.settings import on_road
from charms_bench.world.named_road import NamedRoad
from charms_bench.world.road import side_lanes
from charms_bench.world.scenario import Scenario
from charms_bench.world.scene import SceneSettings

DRIVER = {"acceleration_mps2": 1.7, "braking_mps2": 3.4, "desired_speed_mps": 30.0}
TAU_S = 2 / 3


def placed(*vehicles: dict[str, Any], lanes: int = 2) -> Simulation:
    """The ego far away, and vehicles of which those with the agent `gipps` are alike."""
    scenario = Scenario.model_validate(
        {
            "ego": {"lane": 0, "speed_mps": 25.0, "x_m": 5000.0},
            "vehicles": [
                {"name": f"v{k}", **({"driver_parameters": DRIVER} if "agent" in each else {})}
                | each
                for k, each in enumerate(vehicles)
            ],
        }
    )
    profile = {"name": "charms", "speed_min_mps": 0.0, "target_speed_min_mps": 0.0}
    settings = SceneSettings.model_validate(
        {"profile": profile, "lanes": lanes, "duration_s": 40.0}
    ).of_scenario(scenario)
    agents = {"gipps": make_agent("gipps"), "idm_mobil": make_agent("idm_mobil")}
    simulation = Simulation(settings, 1, "idm_mobil", Placed(scenario.agents), agents)
    simulation.reset(np.zeros(1, dtype=np.uint64))
    return simulation


def acceleration_of(simulation: Simulation, place: int) -> float:
    simulation.advance()
    return float(simulation.scene.acceleration[0, place])


def test_alone_it_approaches_its_desired_speed_as_gipps_says() -> None:
    alone = placed({"agent": "gipps", "lane": 1, "x_m": 200.0, "speed_mps": 20.0})
    expected = 2.5 * 1.7 * (1 - 20 / 30) * math.sqrt(0.025 + 20 / 30)
    assert acceleration_of(alone, 1) == pytest.approx(expected)


def test_behind_a_leader_it_keeps_a_speed_from_which_it_can_stop_as_gipps_says() -> None:
    gap_m, own, leader = 25.0, 26.0, 22.0
    following = placed(
        {"agent": "gipps", "lane": 1, "x_m": 200.0, "speed_mps": own},
        {"lane": 1, "x_m": 200.0 + 5.0 + gap_m, "speed_mps": leader},
        {"lane": 0, "x_m": 202.0, "speed_mps": own},  # no room beside it
    )
    b, b_hat = 3.4, 3.2
    under = (b * TAU_S) ** 2 + b * (2 * (gap_m - 2.0) - own * TAU_S + leader**2 / b_hat)
    speed = -b * TAU_S + math.sqrt(under)
    assert acceleration_of(following, 1) == pytest.approx((speed - own) / TAU_S)


def test_it_stops_behind_a_vehicle_that_stands() -> None:
    stopping = placed(
        {"agent": "gipps", "lane": 1, "x_m": 200.0, "speed_mps": 28.0},
        {"lane": 1, "x_m": 400.0, "speed_mps": 0.0},
        *({"lane": 0, "x_m": 180.0 + 12 * k, "speed_mps": 0.0} for k in range(25)),
    )
    strongest = 0.0
    for _ in range(30 * 15):
        stopping.advance()
        strongest = min(strongest, float(stopping.scene.acceleration[0, 1]))
    assert not stopping.scene.crashed[0, 1]
    assert stopping.scene.speed[0, 1] == pytest.approx(0.0, abs=0.05)
    assert 1.0 < 400.0 - 5.0 - stopping.scene.x[0, 1] < 2.5  # it looks more often than every tau
    assert strongest > -1.25 * 3.4


@pytest.mark.parametrize(("behind_m", "lane"), [(60.0, 0), (6.0, 1)])
def test_it_passes_a_slower_leader_if_its_new_follower_need_not_brake_hard(
    behind_m: float, lane: int
) -> None:
    passing = placed(
        {"agent": "gipps", "lane": 1, "x_m": 300.0, "speed_mps": 26.0},
        {"lane": 1, "x_m": 340.0, "speed_mps": 20.0},
        {"lane": 0, "x_m": 300.0 - 5.0 - behind_m, "speed_mps": 26.0},
    )
    for _ in range(20):
        passing.advance()
    assert passing.scene.target_lane[0, 1] == lane


def test_on_other_roads_it_changes_to_lanes_beside_its_own_only() -> None:
    settings = on_road(SceneSettings(), NamedRoad(name="merge-v0"))
    agents = {"gipps": make_agent("gipps")}
    made = Simulation(settings, 10, "gipps", OneAgent("gipps"), agents, RoadEngine)
    made.reset(np.arange(10, dtype=np.uint64))
    lanes = set()
    for _ in range(12 * settings.steps_per_decision):
        made.advance()
        if made.phase == settings.steps_per_decision:
            made.finish_step()
        there = made.scene.present & ~made.scene.crashed
        pairs = zip(made.scene.lane[there], made.scene.target_lane[there], strict=True)
        lanes |= {(int(lane), int(target)) for lane, target in pairs if lane != target}
    known = {(lane, side) for lane, _ in lanes for side in side_lanes(made.scene.road, lane)}
    assert lanes
    assert lanes <= known


def test_its_traffic_flows_without_collisions() -> None:
    settings = SceneSettings(traffic_vehicles=20)
    agents = {"gipps": make_agent("gipps")}
    simulation = Simulation(settings, 40, "gipps", OneAgent("gipps"), agents)
    simulation.reset(np.arange(970_000_000, 970_000_040, dtype=np.uint64))
    lanes = simulation.scene.lane.copy()
    for _ in range(settings.decisions):
        simulation.step()
    assert not simulation.scene.crashed.any()
    assert (simulation.scene.lane != lanes).mean() > 0.02
