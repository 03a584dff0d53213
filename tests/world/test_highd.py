"""highD's format, in the frame of the simulation."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from trios import LOWER_MARKINGS, Row, busy_road, driven, write_trio

from charms_bench.errors import DataError
from charms_bench.world.csv_table import ROW_LIMIT
from charms_bench.world.recording_folder import find_trios, read_folder
from charms_bench.world.trajectories import TRACKS, Recording

US_101 = Path(__file__).parents[2] / "../shared/data/us101_highd_format"
OLD_NEW = tuple[str, str, str, str]


def read(folder: Path, *rows: Row, **meta: Any) -> Recording:
    (recording,) = read_folder(write_trio(folder, rows, **meta))
    return recording


def test_the_lower_carriageway_keeps_its_axes_and_takes_the_centre(tmp_path: Path) -> None:
    tracks = read(tmp_path, Row(x=200.0, y=31.5, vx=30.0, vy=0.2, ax=-1.0, lane_id=6)).tracks
    assert dict(tracks.schema) == TRACKS
    # The box's centre is at (202.5, 32.5), half a metre right of the left lane's centre.
    assert tracks.row(0) == (1, 1, 2, True, 202.5, 0.5, 0, True, 30.0, 0.2, -1.0, 5.0, 2.0)


def test_the_upper_carriageway_is_turned_around(tmp_path: Path) -> None:
    row = Row(x=100.0, y=10.5, vx=-30.0, vy=-0.2, ax=1.0, lane_id=2, direction=1, kind="Truck")
    recording = read(tmp_path, row)
    # Driving towards smaller x, the uppermost lane is the rightmost, and up is to the right.
    expected = (1, 1, 1, False, -102.5, 8.5, 2, True, 30.0, 0.2, -1.0, 5.0, 2.0)
    assert recording.tracks.row(0) == expected
    assert (recording.lanes, recording.lane_id_disagreements) == ({1: 3}, 0)


def test_a_lane_is_stretched_to_four_metres(tmp_path: Path) -> None:
    # The centre at 38.75 is a quarter into the second lane, which is 3 m wide.
    row = Row(y=37.75, lane_id=4)
    recording = read(tmp_path, row, upper="", lower="34;38;41")
    assert recording.tracks["y"].to_list() == [3.0]
    assert recording.tracks["lane"].to_list() == [1]


def test_a_vehicle_beside_the_road_is_on_the_nearest_lane_and_not_on_the_road(
    tmp_path: Path,
) -> None:
    tracks = read(tmp_path, Row(y=43.0, lane_id=9)).tracks
    assert tracks.select("lane", "on_road", "y").row(0) == (2, False, 12.0)


def test_y_decides_on_the_lane_and_disagreement_is_counted(tmp_path: Path) -> None:
    recording = read(tmp_path, Row(y=35.0, lane_id=8), Row(frame=2, y=35.0, lane_id=7))
    assert recording.tracks["lane"].to_list() == [1, 1]
    assert recording.lane_id_disagreements == 1


def test_a_lane_change_lies_between_two_stays(tmp_path: Path) -> None:
    left, right = Row(y=31.0, lane_id=6), Row(y=35.0, lane_id=7)
    lanes = [right] * 20 + [left] * 10 + [right] * 20 + [left] * 25  # 10 frames are 0.4 s
    recording = read(tmp_path, *(replace(row, frame=k) for k, row in enumerate(lanes)))
    # The brush parts the stay in the right lane in two; the vehicle leaves from the second.
    assert recording.lane_changes.rows() == [(1, 1, 0, 30, 49)]


def test_recordings_come_by_number_and_with_their_frame_rates(tmp_path: Path) -> None:
    for number, rate in ((10, 25), (2, 29.97)):
        write_trio(tmp_path, [Row()], number=number, rate=rate)
    found = [(r.trio.number, r.frame_rate_hz) for r in read_folder(tmp_path)]
    assert found == [(2, 29.97), (10, 25.0)]


def test_a_folder_without_recordings_says_what_was_expected(tmp_path: Path) -> None:
    with pytest.raises(DataError, match=r"no recordings; expected files named like 01_tracks\.csv"):
        find_trios(tmp_path)
    with pytest.raises(
        DataError, match=r"nowhere: cannot be read: No such .*give the folder of your own"
    ):
        find_trios(tmp_path / "nowhere")


@pytest.mark.parametrize("kind", ["tracks", "tracksMeta", "recordingMeta"])
def test_a_missing_file_is_named(tmp_path: Path, kind: str) -> None:
    (write_trio(tmp_path, [Row()]) / f"01_{kind}.csv").unlink()
    with pytest.raises(DataError, match=rf"recording 01 has no 01_{kind}\.csv; add it"):
        find_trios(tmp_path)


def test_a_number_is_given_once(tmp_path: Path) -> None:
    write_trio(tmp_path, [Row()])
    for path in sorted(tmp_path.iterdir()):
        (tmp_path / path.name.replace("01_", "001_")).write_bytes(path.read_bytes())
    with pytest.raises(DataError, match="recording 1 appears twice"):
        find_trios(tmp_path)


# file, what stands in it, what is put there, what is said of it
MISTAKES: list[OLD_NEW] = [
    ("tracks", "width", "widht", r"line 1: no column 'width'. Did you mean"),
    ("tracks", "yAcceleration", "x", "line 1: the column 'x' appears twice"),
    ("tracks", "\n2,1,", "\n=1+1,1,", r"line 3: column 'frame': expected a whole .* '=1\+1'"),
    ("tracks", "\n2,1,101.2", "\n2,1,nan", "line 3: column 'x': .* -100000 to 100000 m, found 'n"),
    ("tracks", "\n2,1,101.2", "\n2,1,inf", "line 3: column 'x': expected a number .* found 'inf'"),
    ("tracks", "\n2,1,101.2", "\n2,1,", "line 3: column 'x': expected .*, found nothing"),
    ("tracks", "\n2,1,101.2", "\n2.5,1,1", "line 3: column 'frame': .*whole.*, found '2.5'"),
    ("tracks", "\n2,1,101.2", "\n2,1,1,2", "line 3: 12 fields, but the header has 11"),
    ("tracks", "30.0,0.0,0.0,0,7\n3", "300,0,0,0,7\n3", "column 'xVelocity': .*, found '300'"),
    ("tracks", "\n2,1,", "\n1,1,", "line 3: vehicle 1 already has a row for this frame"),
    ("tracks", "\n2,1,", "\n2,9,", r"line 3: vehicle 9 is not in 01_tracksMeta\.csv"),
    ("tracks", ",7\n3", ",11\n3", "line 3: column 'laneId': 11 is outside .* expected 1 to 9"),
    ("tracks", "\n3,1,", "\n4,1,", "vehicle 1: last 4, but .* says finalFrame 3"),
    ("tracksMeta", ",3,3,Car", ",3,4,Car", "vehicle 1: rows 3, but .* says numFrames 4; is the"),
    ("tracksMeta", "Car", "Bike", "line 2: column 'class': expected Car or Truck, found 'Bike'"),
    ("tracksMeta", "Car,2", "Car,3", "line 2: column 'drivingDirection': .*1 to 2, found '3'"),
    ("tracksMeta", "Car,2", "Car,1", "of drivingDirection 1 have a mean xVelocity of 30.0 m/s"),
    ("tracksMeta", "\n1,1", "\n1,1,3,3,Car,2\n1,1", "2 vehicles, but .* announces 1"),
    (
        "recordingMeta",
        "1,25,1",
        "1,0,1",
        "column 'frameRate': expected a number from 0.1 to 1000 Hz",
    ),
    ("recordingMeta", "1,25,1", "1,-25,1", "expected a number from 0.1 to 1000 Hz, found '-25'"),
    ("recordingMeta", "1,25,1", "1,1e9,1", "expected a number from 0.1 to 1000 Hz, found '1e9'"),
    ("recordingMeta", "1,25,1", "1,25,0", "column 'numVehicles': no vehicles"),
    ("recordingMeta", "1,25,1", "1,25,1000000000", "1 vehicles, but .* announces 1,000,000,000"),
    ("recordingMeta", LOWER_MARKINGS, "30", "'lowerLaneMarkings': 1 markings, but vehicles drive"),
    ("recordingMeta", LOWER_MARKINGS, "30;x", "'lowerLaneMarkings': .*expected numbers separated"),
    ("recordingMeta", LOWER_MARKINGS, "30;29", "'lowerLaneMarkings': '30;29'; expected growing"),
    ("recordingMeta", "1,25,1", "1,25,1,08:00,a,b,c\n1,25,1", "2 rows; expected one"),
]


@pytest.mark.parametrize(("kind", "old", "new", "message"), MISTAKES)
def test_a_mistake_is_said_with_file_and_line(
    tmp_path: Path, kind: str, old: str, new: str, message: str
) -> None:
    path = write_trio(tmp_path, driven(Row(), 3)) / f"01_{kind}.csv"
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new, 1))
    with pytest.raises(DataError, match=message):
        list(read_folder(tmp_path))


@pytest.mark.parametrize("kind", ["tracks", "tracksMeta", "recordingMeta"])
@pytest.mark.parametrize("fraction", [0.0, 0.4, 0.9])
def test_a_file_cut_short_is_rejected(tmp_path: Path, kind: str, fraction: float) -> None:
    path = write_trio(tmp_path, busy_road(frames=3)) / f"01_{kind}.csv"
    content = path.read_bytes()
    path.write_bytes(content[: int(fraction * len(content))])
    with pytest.raises(DataError, match=rf"01_{kind}\.csv"):
        list(read_folder(tmp_path))


def test_a_file_larger_than_any_recording_is_rejected_unread(tmp_path: Path) -> None:
    path = write_trio(tmp_path, [Row()]) / "01_tracks.csv"
    with path.open("r+b") as file:
        file.truncate(2**40)  # takes no space
    with pytest.raises(DataError, match="larger than 1,073,741,824 bytes"):
        list(read_folder(tmp_path))


def test_more_rows_than_any_recording_are_rejected(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("charms_bench.world.csv_table.ROW_LIMIT", 2)
    with pytest.raises(DataError, match="more than 2 rows; split the recording"):
        list(read_folder(write_trio(tmp_path, driven(Row(), 3))))
    assert ROW_LIMIT > 1_500_000  # a long recording of highD


@pytest.mark.skipif(not US_101.exists(), reason=f"no recordings in {US_101}")
def test_us_101_is_what_its_description_says() -> None:
    recordings = list(read_folder(US_101))
    speeds = np.concatenate([recording.tracks["speed"].to_numpy() for recording in recordings])
    assert len(recordings) == 32
    assert {recording.frame_rate_hz for recording in recordings} == {10.0}
    assert sum(r.tracks["vehicle"].n_unique() for r in recordings) == 997
    assert sum(recording.lane_changes.height for recording in recordings) == 80
    assert (speeds.size, round(speeds.mean(), 1)) == (66_654, 13.2)
