"""What a recorded driver saw."""

from pathlib import Path
from typing import Any

import numpy as np
import polars as pl
import pytest
from charms_baselines.idm_mobil import IdmMobil
from trios import Row, driven, write_trio

from charms_bench.engine.simulation import Simulation
from charms_bench.errors import DataError
from charms_bench.humans.situations import nearest_to_decisions, situations
from charms_bench.plugins.traffic import OneAgent
from charms_bench.world.observations import COMMANDS, Neighbours, neighbours
from charms_bench.world.recording_folder import read_folder
from charms_bench.world.scene import SceneSettings

FIVE_LANES = {"upper": "", "lower": "0;3.5;7;10.5;14;17.5"}


def seen(folder: Path, *rows: Row, **meta: Any) -> tuple[pl.DataFrame, np.ndarray]:
    (recording,) = read_folder(write_trio(folder, rows, **meta))
    return situations(recording, decision_hz=3)


@pytest.mark.parametrize(
    ("rate", "frames"),
    [(25, [0, 8, 17, 25]), (10, [0, 3, 7, 10, 13, 17, 20, 23]), (3, list(range(26)))],
)
def test_a_decision_takes_the_frame_nearest_to_it(rate: int, frames: list[int]) -> None:
    taken = nearest_to_decisions(np.arange(26), rate / 3)
    assert np.flatnonzero(taken).tolist() == frames


def test_frames_count_from_the_recordings_first(tmp_path: Path) -> None:
    rows, _ = seen(tmp_path, *driven(Row(frame=4), 20))
    assert rows["frame"].to_list() == [4, 12, 21]


def test_the_observation_is_relative_and_scaled(tmp_path: Path) -> None:
    ego = Row(x=100.0, y=35.0, vx=30.0)
    leader = Row(vehicle=2, x=133.0, y=35.5, vx=26.7)
    left_rear = Row(vehicle=3, x=83.5, y=31.0, vx=33.3, vy=0.66, lane_id=6)
    beyond = Row(vehicle=4, x=200.0, y=39.0, lane_id=8)  # 100 m ahead
    rows, observations = seen(tmp_path, ego, leader, left_rear, beyond)
    expected = np.zeros((7, 5))
    expected[0] = 1, 1, 4 / 12, 30 / 66, 0
    expected[2] = 1, -16.5 / 165, -4 / 12, 3.3 / 66, 0.66 / 66
    expected[3] = 1, 33 / 165, 0.5 / 12, -3.3 / 66, 0
    found = observations[rows["vehicle"].to_list().index(1)]
    np.testing.assert_allclose(found, expected, atol=1e-6)


def test_the_upper_carriageway_sees_what_the_lower_one_sees(tmp_path: Path) -> None:
    lower = [Row(), Row(vehicle=2, x=120.0, y=39.0, vx=25.0, vy=-0.3, lane_id=8)]
    upper = [
        Row(vehicle=3, x=500.0, y=15.0, vx=-30.0, lane_id=3, direction=1),
        Row(vehicle=4, x=480.0, y=11.0, vx=-25.0, vy=0.3, lane_id=2, direction=1),
    ]
    rows, observations = seen(tmp_path, *lower, *upper)
    assert rows["vehicle"].to_list() == [3, 4, 1, 2]
    np.testing.assert_array_equal(observations[:2], observations[2:])


@pytest.mark.parametrize(
    ("lane", "y", "left", "right"),
    [(0, 0, False, True), (1, 4, True, True), (2, 4, True, True), (4, 8, True, False)],
)
def test_a_wide_road_is_shown_as_the_three_lanes_around_the_driver(
    tmp_path: Path, lane: int, y: float, left: bool, right: bool
) -> None:
    abreast = [
        Row(vehicle=other, x=100.0 + other, y=3.5 * other + 0.75, lane_id=2 + other)
        for other in range(5)
    ]
    rows, observations = seen(tmp_path, *abreast, **FIVE_LANES)
    found = observations[rows["vehicle"].to_list().index(lane)]
    assert found[0, 2] == pytest.approx(y / 12)
    # Vehicles are staggered to the right: the left one is behind, the right one ahead.
    assert found[1:, 0].tolist() == [0, left, 0, 0, right, 0]


def test_a_recorded_scene_is_observed_as_the_simulation_observes_it(tmp_path: Path) -> None:
    made = Simulation(
        SceneSettings(density=1.5), 1, "idm_mobil", OneAgent("idm_mobil"), {"idm_mobil": IdmMobil()}
    )
    made.reset(np.array([7], dtype=np.uint64))
    for _ in range(9):
        made.step()
    scene = made.scene
    vx, vy = scene.speed * np.cos(scene.heading), scene.speed * np.sin(scene.heading)
    recorded = [
        Row(i, 1, *map(float, (scene.x[0, i] - 2.5, scene.y[0, i] + 31.0, vx[0, i], vy[0, i])))
        for i in range(21)
    ]
    rows, observations = seen(tmp_path, *recorded)
    everybody = np.zeros(21, dtype=np.int64), rows["vehicle"].to_numpy()
    np.testing.assert_allclose(observations, neighbours(scene, everybody), atol=1e-6)
    assert observations[:, 1:, 0].sum() > 40


def test_a_leader_is_followed_within_fifty_metres(tmp_path: Path) -> None:
    rows, _ = seen(tmp_path, Row(1, x=0.0), Row(2, x=49.0), Row(3, x=100.0))
    assert rows["leader_distance"].to_list() == [49.0, None, None]


def test_an_empty_row_near_the_sections_end_may_only_look_so(tmp_path: Path) -> None:
    lanes = [(31.0, 6), (35.0, 7), (39.0, 8)]
    cars = [
        Row(vehicle=10 * place + lane_id, x=60.0 * place, y=y, lane_id=lane_id)
        for place in range(5)
        for y, lane_id in lanes
    ]
    rows, _ = seen(tmp_path, *cars)
    # 60 m from an end the neighbours on that side are there; at the end they may be beyond.
    at_an_end = rows["x"].is_in([2.5, 242.5])
    assert rows["view_cut"].to_list() == at_an_end.to_list()


def test_a_carriageway_of_two_lanes_is_not_observed(tmp_path: Path) -> None:
    rows, observations = seen(tmp_path, Row(y=31.0, lane_id=6), lower="30;34;38")
    assert rows["lanes"].to_list() == [2]
    assert not observations.any()


def test_a_frame_rate_below_the_decision_rate_is_rejected(tmp_path: Path) -> None:
    with pytest.raises(DataError, match="'frameRate': 2 Hz; expected at least the 3 Hz of deci"):
        seen(tmp_path, Row(), rate=2)


def test_more_vehicles_than_a_scene_holds_are_rejected(tmp_path: Path) -> None:
    crowd = [Row(vehicle=k, x=float(k)) for k in range(502)]
    with pytest.raises(DataError, match="frame 1: 502 vehicles in one direction; expected at most"):
        seen(tmp_path, *crowd)


def test_a_recorded_driver_is_about_to_do_what_its_acceleration_says(tmp_path: Path) -> None:
    # With the speed controller's 0.8 s, 1.5 m/s2 are those of a target 1.2 m/s above the speed.
    rows = [*driven(Row(ax=1.5), 3), Row(vehicle=2, x=130.0, ax=-0.5)]
    (recording,) = read_folder(write_trio(tmp_path, rows))
    found, observations = situations(recording, 3, Neighbours(commands=True))
    first, second = (observations[found["vehicle"].to_list().index(vehicle)] for vehicle in (1, 2))
    np.testing.assert_allclose(first[COMMANDS], [0.12, 0, 0, 0.15, 0], atol=1e-6)
    np.testing.assert_allclose(second[COMMANDS], [-0.04, 0, 0, -0.05, 0], atol=1e-6)
    _, plain = situations(recording, 3)
    np.testing.assert_array_equal(observations[:, :COMMANDS], plain)
