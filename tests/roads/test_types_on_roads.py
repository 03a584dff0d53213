"""Types of vehicles on roads: their sizes, their desired speeds, and the gaps to them."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from road_simulations import simulation

from charms_bench.roads.episodes import Episodes
from charms_bench.roads.scenes import IDM, put_on_lane
from charms_bench.roads.stepping import decide

MOTORWAY = Path(__file__).parents[2] / "suites" / "places" / "motorway.json"
TRUCKS = [
    {"name": "car", "proportion": 0.5},
    {"name": "truck", "proportion": 0.5, "length_m": 12.0, "desired_speed_mps": [7.0, 8.0]},
]


@pytest.mark.parametrize("traffic", ["environment", "idm_mobil"])
@pytest.mark.parametrize("road", ["exit-v1", "motorway"])
def test_trucks_are_long_and_slow(road: str, traffic: str) -> None:
    made = simulation(road, traffic, vehicle_types=TRUCKS, ego_type="truck", duration_s=30.0)
    state = made.engine.state
    assert (state.length[:, 0] == 12.0).all()
    others = state.present & (np.arange(state.x.shape[1]) > 0)
    trucks = others & (state.length == 12.0)
    assert 0.3 < trucks.sum() / others.sum() < 0.7
    assert (state.length[others & ~trucks] == 5.0).all()
    for _ in range(30):
        made.step()
    stayed = others & state.present & (state.entry < state.x.shape[1]) & ~state.crashed
    assert state.speed[stayed & trucks].max() < 8.1
    assert np.median(state.speed[stayed & ~trucks]) > 8.1


def test_vehicles_that_come_later_have_types() -> None:
    made = simulation("intersection-v2", "environment", vehicle_types=TRUCKS, duration_s=30.0)
    state, first = made.engine.state, made.engine.state.entry.max()
    for _ in range(20):
        made.step()
    later = state.present & (state.entry > first)
    assert set(state.length[later]) == {5.0, 12.0}


def test_vehicles_that_come_back_at_once_have_numbers_of_their_own() -> None:
    made = simulation("motorway", "environment", duration_s=30.0)
    for _ in range(60):
        made.step()
        made.ending[:] = 0
    state = made.engine.state
    for row in range(len(state.x)):
        numbers = state.entry[row, state.present[row]]
        assert numbers.max() >= state.x.shape[1]  # some have come back
        assert np.unique(numbers).size == numbers.size


def test_a_long_vehicle_stops_as_far_from_a_long_one_as_cars_do() -> None:
    rest = []
    for length in (5.0, 16.0):
        episodes = Episodes("merge-v0", 1)
        scenes = episodes.scenes
        scenes.constants["mixed_sizes"] = True
        scenes.vehicles["kind"] = 0
        for i, (s, speed) in enumerate(((200.0, 0.0), (60.0, 10.0))):
            put_on_lane(scenes, 0, i, IDM, 0, s, speed)
            scenes.vehicles["length"][0, i] = length
            scenes.vehicles["target_speed"][0, i] = speed
            scenes.vehicles["changes_lanes"][0, i] = False
        for _ in range(60):
            decide(scenes, episodes.everyone, np.zeros((1, 0), dtype=np.int64), 15, 1.0)
        ahead, behind = scenes.vehicles["x"][0, :2]
        rest.append(ahead - behind - length)
    # IDM's jam distance of 10 m between the centres of two cars of 5 m.
    assert rest == pytest.approx([5.0, 5.0], abs=0.3)


def test_nobody_overlaps_at_the_start() -> None:
    long: Any = [{"name": "truck", "proportion": 1.0, "length_m": 18.0}]
    made = simulation("exit-v1", "environment", vehicle_types=long)
    state = made.engine.state
    for row in range(len(state.x)):
        there = np.nonzero(state.present[row])[0]
        x, y = state.x[row, there], state.y[row, there]
        apart = (abs(x[:, None] - x) >= 18.0) | (abs(y[:, None] - y) >= 2.0)
        assert apart[~np.eye(there.size, dtype=bool)].all()
