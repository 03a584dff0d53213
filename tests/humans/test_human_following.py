"""What recorded drivers do while they follow."""

from pathlib import Path

import numpy as np
import polars as pl
import pytest
from trios import Row, driven, write_trio

from charms_bench.errors import DataError
from charms_bench.humans.following_samples import Followers, followers, lane_change_starts
from charms_bench.humans.situations import situations
from charms_bench.world.recording_folder import read_folder

US_101 = Path(__file__).parents[2] / "../shared/data/us101_highd_format"
RATE = 25


def found(folder: Path, rows: list[Row], rate: float = RATE) -> Followers:
    return followers(read_folder(write_trio(folder, rows, rate=rate)))


def changing(vehicle: int, drift: list[float], x: float = 100.0) -> list[Row]:
    """A vehicle, from the middle lane to the left one, with a lateral speed a frame."""
    y, rows = 35.0, []
    for k, vy in enumerate(drift):
        y += vy / RATE
        lane_id = 7 if y + 1 > 34 else 6
        rows.append(Row(vehicle, frame=k + 1, x=x + k * 30.0 / RATE, y=y, vy=vy, lane_id=lane_id))
    return rows


def test_who_follows_has_a_leader_within_fifty_metres_at_a_decision(tmp_path: Path) -> None:
    # Boxes are equally long, so centres are as far apart as the left edges.
    near, far, leader = (Row(vehicle=v, x=x, vx=20.0 + v) for v, x in enumerate((99, 48, 149)))
    other_lane = Row(vehicle=8, x=140, y=31.0, lane_id=6)
    other_way = Row(vehicle=9, x=130, y=12, vx=-30.0, lane_id=2, direction=1)
    result = found(tmp_path, [near, far, leader, other_lane, other_way])
    assert result.speed.tolist() == [20.0]  # 50 m; `far` has 51
    assert (result.vehicles, result.lane_changes, result.dhw.size) == (5, 0, 0)


def test_a_leader_on_two_lanes_leads_on_both(tmp_path: Path) -> None:
    # Its centre, 0.9 m left of the marking at 34 m, is 2.9 m from the middle lane's.
    leader = Row(vehicle=1, x=130.0, y=32.1, lane_id=6, vx=29.0)
    behind = Row(vehicle=2, x=100.0), Row(vehicle=3, x=100.0, y=31.0, lane_id=6, vx=28.0)
    assert sorted(found(tmp_path, [leader, *behind]).speed) == [28.0, 30.0]


def test_a_driver_is_counted_three_times_a_second(tmp_path: Path) -> None:
    rows = [*driven(Row(vehicle=1), 50), *driven(Row(vehicle=2, x=130.0), 50)]
    assert found(tmp_path, rows).speed.size == 6  # 2 s


def test_a_lane_change_starts_when_the_vehicle_begins_to_move_over(tmp_path: Path) -> None:
    drift = [0.3] * 5 + [-0.07] * 25 + [-1.0] * 60 + [0.0] * 25
    rows = changing(1, drift) + driven(Row(vehicle=2, x=140.0), len(drift))
    folder = write_trio(tmp_path, rows)
    (recording,) = read_folder(folder)
    assert lane_change_starts(recording).rows() == [(1, 30)]
    result = followers([recording])
    np.testing.assert_allclose(result.dhw, [40.0])
    assert result.lane_changes == 1


def test_a_vehicle_that_is_on_its_way_when_first_seen_starts_nothing(tmp_path: Path) -> None:
    rows = changing(1, [-1.0] * 60 + [0.0] * 25)
    result = found(tmp_path, rows + driven(Row(vehicle=2, x=140.0), 85))
    assert (result.lane_changes, result.dhw.size) == (1, 0)


def test_fewer_frames_than_decisions_are_rejected(tmp_path: Path) -> None:
    with pytest.raises(DataError, match="2 Hz; expected at least the 3 Hz of decisions"):
        found(tmp_path, driven(Row(), 5, rate=2), rate=2)


@pytest.mark.skipif(not US_101.exists(), reason=f"no recordings in {US_101}")
def test_on_us_101_leaders_are_those_of_the_simulations_tables() -> None:
    speeds, expected = [], []
    for recording in read_folder(US_101):
        if min(recording.lanes.values()) < 3:
            continue  # of which the simulation's tables say nothing
        rows, _ = situations(recording, 3)
        expected.append(rows.filter("on_road", pl.col("leader_distance").is_not_null())["speed"])
        speeds.append(followers([recording]).speed)
    np.testing.assert_array_equal(np.sort(np.concatenate(speeds)), pl.concat(expected).sort())
