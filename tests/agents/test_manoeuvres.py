"""Intents from what a recorded driver goes on to do."""

from dataclasses import replace
from pathlib import Path

import polars as pl
import pytest
from charms_agents.human.manoeuvres import manoeuvres
from trios import Row, write_trio

from charms_bench.world.recording_folder import find_trios, read_recording

RATE, LANE_M = 10.0, 4.0
"""Frames per second, and the width of the lanes that `write_trio` marks."""


def intents(folder: Path, rows: list[Row]) -> pl.DataFrame:
    """The intents of one recorded vehicle, by frame."""
    write_trio(folder, rows, rate=RATE)
    return manoeuvres(read_recording(find_trios(folder)[0])).sort("frame")


def path(*legs: tuple[int, float]) -> list[Row]:
    """A vehicle that drives each leg: a number of frames, and its speed to the right, m/s."""
    rows, y = [], 35.0
    for frames, lateral in legs:
        for _ in range(frames):
            place = {"frame": len(rows) + 1, "x": 100.0 + 3.0 * len(rows), "y": y, "vy": lateral}
            rows.append(replace(Row(), **place))
            y += lateral / RATE
    return rows


def test_a_lane_change_lasts_from_its_onset_to_the_marking(tmp_path: Path) -> None:
    rows = path((10, 0.0), (40, 1.0), (10, 0.0))
    lane = read_lanes(tmp_path, rows)
    crossed = lane.index(lane[0] + 1)
    movement = intents(tmp_path, rows)["movement"].to_list()
    assert 10 < crossed < 50
    assert movement == [0] * 10 + [1] * (crossed - 10) + [0] * (60 - crossed)


def test_a_drift_that_returns_is_no_lane_change(tmp_path: Path) -> None:
    rows = path((10, 0.0), (10, 0.5), (10, -0.5), (10, 0.0))
    assert set(intents(tmp_path, rows)["movement"]) == {0}


def test_a_movement_back_across_the_marking_is_to_the_other_side(tmp_path: Path) -> None:
    rows = path((40, 1.0), (40, -1.0), (5, 0.0))
    movement = intents(tmp_path, rows)["movement"].to_list()
    assert 1 in movement[:40]
    assert -1 not in movement[:40]
    assert -1 in movement[40:]
    assert 1 not in movement[40:]


def test_another_vehicle_ends_a_movement(tmp_path: Path) -> None:
    one = path((20, 0.5))
    other = [replace(row, vehicle=2, frame=row.frame, x=row.x + 50) for row in path((60, 0.5))]
    found = intents(tmp_path, [*one, *other])
    assert set(found.filter(pl.col("vehicle") == 1)["movement"]) == {0}
    assert 1 in found.filter(pl.col("vehicle") == 2)["movement"]


def test_accelerations_are_the_mean_of_the_next_two_seconds(tmp_path: Path) -> None:
    rows = path((41, 0.0))
    speeds = [20.0 + max(0, k - 10) * 0.1 for k in range(41)]
    rows = [replace(row, vx=speed) for row, speed in zip(rows, speeds, strict=True)]
    found = intents(tmp_path, rows)["mean_acceleration"].to_list()
    assert found[0] == pytest.approx(0.5)  # 1 m/s in the second of two seconds
    assert found[10] == pytest.approx(1.0)
    assert found[35] == pytest.approx(1.0)  # until the recording ends
    assert found[40] == 0.0  # what the recording says of its last frame


def read_lanes(folder: Path, rows: list[Row]) -> list[int]:
    write_trio(folder, rows, rate=RATE)
    return list(read_recording(find_trios(folder)[0]).tracks.sort("frame")["lane"])
