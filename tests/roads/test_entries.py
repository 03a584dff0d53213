"""How a vehicle enters a road: gaps, braking and post-encroachment time, calculated by hand."""

from typing import Any

import numpy as np
import pytest

from charms_bench.foundation.compiled import compiled_of_scenes
from charms_bench.roads.entries import Entries
from charms_bench.roads.episodes import Episodes
from charms_bench.roads.locating import forget, locate
from charms_bench.roads.scenes import IDM, NOTHING, here_of, put_on_lane

DT = 1 / 15


@compiled_of_scenes
def move_to(scenes: Any, i: int, x: float, y: float) -> None:
    """Moves vehicle i of the only scene, and finds its lane."""
    here = here_of(scenes, 0)
    scenes.vehicles[0, i].x, scenes.vehicles[0, i].y = x, y
    forget(here, i)
    locate(here, i)


class Scene:
    """A scene of `merge-v0`, in which vehicle 4 comes from the ramp; vehicles are placed by hand.

    The motorway has its lanes at y = 0 and 4 m; the lane of the ramp is at y = 8 m, from x = 230 m
    to 310 m.
    """

    def __init__(self) -> None:
        self.episodes = Episodes("merge-v0", 1, {"simulation_frequency": 15})
        episodes, self.rows = self.episodes, np.arange(1)
        episodes.seed(self.rows, np.zeros(1, dtype=np.uint64))
        episodes.start(self.rows)
        self.table = episodes.scenes.vehicles[0]
        self.table["kind"][:4] = NOTHING
        main = episodes.task.main_lanes(episodes.scenes)
        self.entries = Entries(1, episodes.scenes, main)
        self.entries.start(self.rows, episodes.task.entering(episodes.scenes))
        move_to(episodes.scenes, 4, 250.0, 8.0)
        self.note()

    def put(self, i: int, x: float, y: float, acceleration: float = 0.0) -> None:
        self.table["kind"][i] = IDM
        self.table["acceleration"][i], self.table["heading"][i] = acceleration, 0.0
        move_to(self.episodes.scenes, i, x, y)

    def note(self) -> None:
        self.entries.note(self.episodes.scenes, self.rows)

    def measure(self, name: str) -> float:
        return float(self.entries.measures[f"entry_{name}"][0])


def test_gaps_are_bumper_to_bumper_on_the_entered_lane() -> None:
    scene = Scene()
    scene.put(1, 280.0, 4.0)
    scene.put(2, 200.0, 4.0)  # on the part of the motorway before the ramp's lane
    scene.put(3, 245.0, 0.0)  # on the left lane
    scene.put(4, 252.0, 5.0)
    scene.note()
    assert scene.measure("lead_gap_m") == pytest.approx(280.0 - 252.0 - 5.0)
    assert scene.measure("lag_gap_m") == pytest.approx(252.0 - 200.0 - 5.0)


def test_there_is_no_gap_to_a_vehicle_more_than_100_m_away() -> None:
    scene = Scene()
    scene.put(1, 353.0, 4.0)
    scene.put(2, 151.0, 4.0)
    scene.put(4, 252.0, 5.0)
    scene.note()
    assert np.isnan(scene.measure("lead_gap_m"))
    assert np.isnan(scene.measure("braking_mps2"))
    assert scene.measure("lag_gap_m") != scene.measure("lag_gap_m")


def test_the_braking_is_the_strongest_one_within_two_seconds() -> None:
    scene = Scene()
    scene.put(1, 200.0, 4.0, acceleration=1.0)
    scene.put(4, 252.0, 5.0)
    scene.note()
    assert scene.measure("braking_mps2") == 0.0
    for step in range(1, 40):
        scene.table["acceleration"][1] = {10: -1.5, 30: -2.5, 31: -9.0}.get(step, 0.0)
        scene.note()
    assert scene.measure("braking_mps2") == pytest.approx(2.5)


def test_the_pet_is_the_time_until_the_follower_is_where_the_rear_was() -> None:
    scene = Scene()
    scene.put(1, 232.0, 4.0)
    scene.put(4, 252.0, 5.0)  # its rear is at 249.5 m, which the front reaches at x = 247 m
    scene.note()
    for step in range(1, 40):
        scene.put(1, 232.0 + 10.0 * step * DT, 4.0)
        scene.put(4, 252.0 + 20.0 * step * DT, 4.0)
        scene.note()
    assert scene.measure("pet_s") == pytest.approx(1.5)


def test_a_follower_that_leaves_the_lane_has_no_pet() -> None:
    scene = Scene()
    scene.put(1, 232.0, 4.0)
    scene.put(4, 252.0, 5.0)
    scene.note()
    scene.put(1, 240.0, 0.0)
    scene.note()
    scene.put(1, 260.0, 4.0)
    scene.note()
    assert np.isnan(scene.measure("pet_s"))


def test_in_a_roundabout_the_ego_enters_the_ring_ahead_of_a_vehicle_in_it() -> None:
    episodes = Episodes("roundabout-v0", 1, {"simulation_frequency": 15})
    scenes, rows = episodes.scenes, np.arange(1)
    episodes.seed(rows, np.zeros(1, dtype=np.uint64))
    episodes.start(rows)
    scenes.vehicles["kind"][0, 1:] = NOTHING
    entries = Entries(1, scenes, episodes.task.main_lanes(scenes))
    entries.start(rows, episodes.task.entering(scenes))
    entries.note(scenes, rows)
    ring, before = (episodes.task.lanes[*road, 1] for road in (("se", "ex"), ("sx", "se")))
    put = getattr(put_on_lane, "py_func", put_on_lane)
    put(scenes, 0, 0, IDM, ring, 2.0, 8.0)
    length = float(scenes.road.lanes["length"][before])
    put(scenes, 0, 1, IDM, before, length - 10.0, 8.0)
    for i, lane in enumerate((ring, before)):
        scenes.vehicles["lane"][0, i] = lane
    entries.note(scenes, rows)
    assert entries.measures["entry_lag_gap_m"][0] == pytest.approx(2.0 + 10.0 - 5.0)
    assert np.isnan(entries.measures["entry_lead_gap_m"][0])
