"""Concrete scenarios in which prescribed vehicles collide with one another."""

from typing import Any

import numpy as np
import pytest

from charms_bench.engine.pile_ups import pile_ups
from charms_bench.world.scenario import Scenario
from charms_bench.world.scene import SceneSettings

ENDS_S = 4.0
SETTINGS = SceneSettings.model_validate(
    {"profile": {"name": "charms", "speed_min_mps": 0.0}, "duration_s": ENDS_S}
)


def collide(first: dict[str, Any], second: dict[str, Any], points: list[float]) -> list[bool]:
    """Whether two vehicles 5 m long collide, by the gap between them."""
    vehicles = [
        {"name": "first", "lane": 1, "ahead_of": "ego", "gap_m": 60, **first},
        {"name": "second", "lane": 1, "ahead_of": "first", "gap_m": "gap", **second},
    ]
    scenario = Scenario.model_validate(
        {
            "parameters": {"gap": [0.0, 1000.0]},
            "points": [{"gap": gap} for gap in points],
            "ego": {"lane": 1, "speed_mps": 30},
            "vehicles": vehicles,
        }
    )
    found = pile_ups(SETTINGS.of_scenario(scenario), np.arange(len(points)))
    return [bool(each) for each in found]


def test_a_vehicle_that_drives_into_a_stationary_one_is_a_pile_up() -> None:
    # At 20 m/s, it drives 80 m until the end.
    assert collide({"speed_mps": 20}, {"speed_mps": 0}, [5, 79, 81]) == [True, True, False]


def test_a_vehicle_that_leaves_the_lane_in_time_is_none() -> None:
    # It is 2 m wide: half of the 4 m to the next lane, which take 2 s, are too few after 20 m.
    moves = {"speed_mps": 20, "actions": [{"at_s": 0, "lane": 0, "duration_s": 2}]}
    assert collide(moves, {"speed_mps": 0}, [15, 30]) == [True, False]


@pytest.mark.parametrize("driven", [0, 1])
def test_what_an_agent_drives_into_is_no_pile_up(driven: int) -> None:
    vehicles: list[dict[str, Any]] = [{"speed_mps": 20}, {"speed_mps": 0}]
    vehicles[driven]["agent"] = "level_0"
    assert collide(vehicles[0], vehicles[1], [5]) == [False]


def test_the_ego_has_no_part_in_it() -> None:
    # The ego would hit the first vehicle, which is slower than itself, and push it ahead.
    slow: dict[str, Any] = {"speed_mps": 1, "gap_m": 1}
    assert collide(slow, {"speed_mps": 1}, [2]) == [False]
