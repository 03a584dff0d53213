"""Recordings in highD's format: what our own reader, and highD's conventions, make of them."""

from pathlib import Path

import numpy as np
import polars as pl
import pytest
from handmade_replay import replay_of

from charms_bench.episodes import highd_format
from charms_bench.episodes.ego_view import ego_view
from charms_bench.episodes.highd_format import drivers, write_recording
from charms_bench.episodes.recorded_cell import RecordedCell
from charms_bench.episodes.replay import Replay, replay
from charms_bench.runs.runner import run
from charms_bench.runs.suite import Suite
from charms_bench.world.recording_folder import find_trios, read_recording
from charms_bench.world.trajectories import Recording

SUITE = {
    "suite": "small",
    "episodes": 3,
    "seed": 900_000_000,
    "scene": {"duration_s": 8.0, "traffic_vehicles": 10, "density": 1.5},
    "egos": [{"agent": "outside_policy"}],
    "traffic_models": [{"traffic": {"mixture": {"idm_mobil": 0.5, "outside_policy": 0.5}}}],
}
COLUMNS = (
    "frame,id,x,y,width,height,xVelocity,yVelocity,xAcceleration,yAcceleration,"
    "frontSightDistance,backSightDistance,dhw,thw,ttc,precedingXVelocity,precedingId,followingId,"
    "leftPrecedingId,leftAlongsideId,leftFollowingId,rightPrecedingId,rightAlongsideId,"
    "rightFollowingId,laneId"
)
META = (
    "id,width,height,initialFrame,finalFrame,numFrames,class,drivingDirection,traveledDistance,"
    "minXVelocity,maxXVelocity,meanXVelocity,minDHW,minTHW,minTTC,numLaneChanges"
)
RECORDING = (
    "id,frameRate,locationId,speedLimit,month,weekDay,startTime,duration,totalDrivenDistance,"
    "totalDrivenTime,numVehicles,numCars,numTrucks,upperLaneMarkings,lowerLaneMarkings"
)


@pytest.fixture(scope="module")
def replays(tmp_path_factory: pytest.TempPathFactory) -> list[Replay]:
    folder = tmp_path_factory.mktemp("run") / "small"
    finished = run(Suite.model_validate(SUITE), folder, workers=1)
    return replay(RecordedCell(finished, 0, Path()), range(900_000_000, 900_000_003))


@pytest.fixture(scope="module")
def recordings(replays: list[Replay], tmp_path_factory: pytest.TempPathFactory) -> list[Recording]:
    folder = tmp_path_factory.mktemp("highd")
    for each in replays:
        write_recording(each, folder)
    return [read_recording(trio) for trio in find_trios(folder)]


def tracks_of(replayed: Replay, folder: Path) -> pl.DataFrame:
    write_recording(replayed, folder)
    return pl.read_csv(folder / f"{replayed.episode:02}_tracks.csv")


def test_the_files_have_highds_names_and_columns(tmp_path: Path) -> None:
    write_recording(replay_of(x=[[0.0, 30.0]] * 2), tmp_path)
    for kind, columns in (("tracks", COLUMNS), ("tracksMeta", META), ("recordingMeta", RECORDING)):
        assert (tmp_path / f"07_{kind}.csv").read_text().partition("\n")[0] == columns


def test_our_reader_finds_the_same_trajectories(
    replays: list[Replay], recordings: list[Recording]
) -> None:
    changed_lanes = 0
    for replayed, recording in zip(replays, recordings, strict=True):
        frames, vehicles = replayed.x.shape
        assert recording.trio.number == replayed.episode
        assert (recording.frame_rate_hz, recording.lanes) == (15.0, {2: 3})
        assert recording.lane_id_disagreements == 0

        def found(name: str) -> np.ndarray:
            return recording.tracks[name].to_numpy().reshape(vehicles, frames).T  # noqa: B023

        np.testing.assert_allclose(found("x"), replayed.x, atol=1e-9)
        np.testing.assert_allclose(found("y"), replayed.y, atol=1e-9)
        np.testing.assert_array_equal(found("lane"), replayed.lane)
        speed = replayed.speed * np.exp(1j * replayed.heading)
        np.testing.assert_allclose(found("speed"), speed.real, rtol=1e-12)
        np.testing.assert_allclose(found("lateral_speed"), speed.imag, atol=1e-12)
        changed_lanes += recording.lane_changes.height
    assert changed_lanes


def test_gaps_and_neighbours_are_those_of_the_trajectories_that_our_reader_finds(
    recordings: list[Recording],
) -> None:
    compared = 0
    for recording in recordings:
        written = pl.read_csv(recording.trio.tracks).sort("frame", "id")
        read = recording.tracks.sort("frame", "vehicle")
        for frame in range(1, written["frame"].max() + 1, 10):
            rows = written.filter(frame=frame).rows(named=True)
            seen = read.filter(frame=frame).rows(named=True)
            for row, me in zip(rows, seen, strict=True):
                there = [v for v in seen if v["lane"] == me["lane"] and v["x"] > me["x"]]
                leader = min(there, key=lambda v: v["x"], default=None)
                assert row["precedingId"] == (leader["vehicle"] if leader else 0)
                if leader is None:
                    assert (row["dhw"], row["thw"], row["ttc"]) == (0, 0, 0)
                    continue
                gap, closing = leader["x"] - me["x"] - 5.0, me["speed"] - leader["speed"]
                assert rows[leader["vehicle"] - 1]["followingId"] == me["vehicle"]
                if gap <= 0:
                    assert (row["dhw"], row["ttc"]) == (0, 0)
                    continue
                assert row["dhw"] == pytest.approx(gap)
                assert row["thw"] == pytest.approx(gap / me["speed"])
                assert row["ttc"] * closing == pytest.approx(gap if closing else 0)
                compared += 1
    assert compared > 100


def test_the_egos_gap_and_ttc_are_those_of_its_metrics(
    replays: list[Replay], recordings: list[Recording]
) -> None:
    compared = 0
    for replayed, recording in zip(replays, recordings, strict=True):
        view = ego_view(replayed)
        straight = replayed.heading[:, [replayed.ego]] == 0
        rows = pl.read_csv(recording.trio.tracks).filter(id=replayed.ego + 1)
        same = (rows["precedingId"] == view.leader + 1).to_numpy() & ~np.isnan(view.gap_ahead)
        np.testing.assert_allclose(rows["dhw"].to_numpy()[same], view.gap_ahead[same])
        closing = same & ~np.isnan(view.ttc) & straight[:, 0]
        closing &= replayed.heading[np.arange(len(view.leader)), view.leader] == 0
        np.testing.assert_allclose(rows["ttc"].to_numpy()[closing], view.ttc[closing])
        compared += int(closing.sum())
    assert compared > 10


def test_large_scenes_are_compared_some_frames_at_a_time(
    replays: list[Replay], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    whole = tracks_of(replays[0], tmp_path)
    monkeypatch.setattr(highd_format, "PAIRS_AT_ONCE", 7 * 11**2)
    assert tracks_of(replays[0], tmp_path).equals(whole)


def test_neighbours_are_named_as_in_highd(tmp_path: Path) -> None:
    # Vehicle 1 in the middle lane; beside it overlapping boxes, which are 5 m long, are alongside.
    x = [[100.0, 130.0, 70.0, 104.0, 120.0, 60.0, 106.0, 94.0]]
    y = [[4.0, 4.0, 4.0, 0.0, 0.0, 0.0, 8.0, 8.0]]
    row = tracks_of(replay_of(x=x, y=y), tmp_path).row(0, named=True)
    assert {name: row[name] for name in COLUMNS.split(",")[16:]} == {
        "precedingId": 2,
        "followingId": 3,
        "leftPrecedingId": 5,
        "leftAlongsideId": 4,
        "leftFollowingId": 6,
        "rightPrecedingId": 7,
        "rightAlongsideId": 0,
        "rightFollowingId": 8,
        "laneId": 7,  # markings at 0, 4, 8, 12 above, and 16, 20, 24, 28 below
    }


def test_a_row_is_written_in_image_coordinates(tmp_path: Path) -> None:
    # 20 m apart; the ego gains 30 m/s - 20 m/s on its leader and reaches it after 1.5 s.
    row = tracks_of(replay_of(x=[[100.0, 120.0]], speed=[[30.0, 20.0]]), tmp_path).row(
        0, named=True
    )
    assert (row["x"], row["y"], row["width"], row["height"]) == (97.5, 17.0, 5.0, 2.0)
    assert (row["dhw"], row["thw"], row["ttc"]) == (15.0, 0.5, 1.5)
    assert (row["frontSightDistance"], row["backSightDistance"]) == (20.0, 0.0)


def test_a_faster_leader_has_a_negative_ttc_and_the_smallest_one_is_missing(tmp_path: Path) -> None:
    first, _ = tracks_of(
        replay_of(x=[[100.0, 120.0]], speed=[[20.0, 30.0]]), tmp_path
    ).rows(named=True)  # fmt: skip
    assert first["ttc"] == -1.5
    meta = pl.read_csv(tmp_path / "07_tracksMeta.csv")
    assert meta["minTTC"].to_list() == [-1.0, -1.0]
    assert meta["minDHW"].to_list() == [15.0, -1.0]


def test_accelerations_are_those_of_the_velocities(tmp_path: Path) -> None:
    speed = [[20.0, 20.0], [21.0, 20.0], [21.0, 20.0]]  # 1 m/s within 1/15 s
    rows = tracks_of(replay_of(x=[[0.0, 50.0]] * 3, speed=speed), tmp_path).filter(id=1)
    assert rows["xAcceleration"].to_list() == pytest.approx([0.0, 15.0, 0.0])


def test_no_two_recordings_start_at_the_same_time(recordings: list[Recording]) -> None:
    assert len({recording.occasion for recording in recordings}) == len(recordings)


def test_the_drivers_are_named(replays: list[Replay]) -> None:
    replayed = replays[0]
    table = drivers(replayed)
    assert table["agent"].to_list() == list(replayed.agents)
    assert table.filter("ego")["id"].to_list() == [replayed.ego + 1]
    assert set(table["recording"]) == {900_000_000}


def test_trucks_have_their_own_sizes_and_class(tmp_path: Path) -> None:
    replayed = replay_of(
        x=[[100.0, 130.5], [102.0, 132.5]], length=[[5.0, 16.0]] * 2, width=[[2.0, 2.5]] * 2
    )
    ego = tracks_of(replayed, tmp_path).row(0, named=True)
    assert (ego["width"], ego["height"], ego["dhw"]) == (5.0, 2.0, 20.0)
    meta = pl.read_csv(tmp_path / "07_tracksMeta.csv")
    assert meta.select("width", "height", "class").rows() == [(5, 2, "Car"), (16, 2.5, "Truck")]
