"""NGSIM's raw tables, and what of highD's columns follows from the positions."""

from pathlib import Path

import numpy as np
import pytest
from command_line import charms_bench
from trios import Row, busy_road, driven, write_trio

from charms_bench.errors import DataError
from charms_bench.world.recording_folder import find_trios, read_folder

FOOT_M = 0.3048
HEADER = (
    "Vehicle_ID,Frame_ID,Total_Frames,Global_Time,Local_X,Local_Y,Global_X,Global_Y,v_length,"
    "v_Width,v_Class,v_Vel,v_Acc,Lane_ID,Preceding,Following,Space_Headway,Time_Headway,Location"
)


def table(
    folder: Path, frames: int = 40, place: str = "us-101", quoted: bool = False, lanes: int = 3
) -> Path:
    """Vehicles at 50 ft/s; number k is on lane k, whose centre is at 12 k - 6 ft."""
    lines = []
    for k in range(1, lanes + 1):
        for t in range(frames):
            right, along = 12 * k - 6, 100 * k + 5.0 * t
            kind, length = (3, 40) if k == 2 else (2, 15)
            lines.append(
                f"{k},{t + 7},{frames},0,{right},{along},0,0,{length},6.5,{kind},50,1.0,{k},"
                f"0,0,0,0,{place}"
            )
    header = ",".join(f'"{name}"' for name in HEADER.split(",")) if quoted else HEADER
    (folder / "trajectories.csv").write_text("\n".join([header, *lines]) + "\n")
    return folder


@pytest.mark.parametrize("quoted", [False, True])
def test_a_table_of_ngsim_is_read_in_metres(tmp_path: Path, quoted: bool) -> None:
    (recording,) = read_folder(table(tmp_path, quoted=quoted))
    assert (recording.frame_rate_hz, recording.lanes, recording.location) == (10, {2: 3}, "us-101")
    np.testing.assert_allclose(recording.lane_widths_m[2], 12 * FOOT_M)
    row = recording.tracks.filter(vehicle=2, frame=7).row(0, named=True)
    assert row["x"] == pytest.approx((200 - 20) * FOOT_M)
    assert (row["y"], row["lane"], row["on_road"], row["car"]) == (4.0, 1, True, False)
    assert row["speed"] == pytest.approx(50 * FOOT_M)
    assert (row["length"], row["width"]) == pytest.approx((40 * FOOT_M, 6.5 * FOOT_M))
    assert recording.lane_id_disagreements == 0


def test_the_file_itself_may_be_given_and_is_summarised(tmp_path: Path) -> None:
    path = table(tmp_path) / "trajectories.csv"
    (trio,) = find_trios(path)
    assert trio.paths == (path,)
    said = charms_bench("data", path).stdout
    assert "1 with 3 lanes" in said
    assert "2 cars, 1 truck, 120 rows" in said


def test_the_lateral_speed_is_that_of_a_second(tmp_path: Path) -> None:
    path = table(tmp_path) / "trajectories.csv"
    lines = path.read_text().splitlines()
    moved = [lines[0]]
    for line in lines[1:]:
        cells = line.split(",")
        cells[4] = str(float(cells[4]) + 0.1 * (int(cells[1]) - 7))  # 1 ft/s to the right
        moved.append(",".join(cells))
    path.write_text("\n".join(moved) + "\n")
    (recording,) = read_folder(tmp_path)
    np.testing.assert_allclose(recording.tracks["lateral_speed"].to_numpy(), FOOT_M, atol=1e-9)


@pytest.mark.parametrize(
    ("place", "message"), [("lankershim", "road with junctions; expected us-101 or i-80")]
)
def test_another_road_is_named(tmp_path: Path, place: str, message: str) -> None:
    with pytest.raises(DataError, match=message):
        list(read_folder(table(tmp_path, place=place)))


def test_two_places_in_one_table_are_named(tmp_path: Path) -> None:
    path = table(tmp_path) / "trajectories.csv"
    path.write_text(path.read_text().replace("us-101", "i-80", 1))
    with pytest.raises(DataError, match="has the locations i-80, us-101; keep one"):
        list(read_folder(tmp_path))


def test_commonroad_and_others_are_named(tmp_path: Path) -> None:
    (tmp_path / "USA_Peach-1.xml").write_text("<commonRoad/>")
    with pytest.raises(DataError, match="CommonRoad scenarios are not read as recordings; give"):
        find_trios(tmp_path)
    with pytest.raises(DataError, match="CommonRoad scenarios are not read"):
        find_trios(tmp_path / "USA_Peach-1.xml")


def _without(path: Path, *names: str) -> None:
    lines = [line.split(",") for line in path.read_text().splitlines()]
    kept = [k for k, name in enumerate(lines[0]) if name not in names]
    path.write_text("\n".join(",".join(line[k] for k in kept) for line in lines) + "\n")


def test_columns_that_follow_from_the_positions_may_be_missing(tmp_path: Path) -> None:
    upper = [Row(vehicle=2, y=15.0, vx=-28.0, lane_id=3, direction=1, x=900.0)]
    rows = [row for each in (Row(vy=0.0), *upper) for row in driven(each, 30)]
    (whole,) = read_folder(write_trio(tmp_path, rows))
    _without(tmp_path / "01_tracks.csv", "xVelocity", "yVelocity", "xAcceleration", "laneId")
    derived = ("initialFrame", "finalFrame", "numFrames", "drivingDirection")
    _without(tmp_path / "01_tracksMeta.csv", *derived)
    _without(tmp_path / "01_recordingMeta.csv", "numVehicles")
    (found,) = read_folder(tmp_path)
    assert (found.lanes, found.lane_id_disagreements) == (whole.lanes, 0)
    for name in whole.tracks.columns:
        one, other = whole.tracks[name].to_numpy(), found.tracks[name].to_numpy()
        np.testing.assert_allclose(one, other, atol=1e-6, err_msg=name)


def test_all_missing_columns_are_named_at_once(tmp_path: Path) -> None:
    write_trio(tmp_path, driven(Row(), 30))
    _without(tmp_path / "01_tracks.csv", "x", "width", "laneId")
    with pytest.raises(DataError, match=r"line 1: no columns 'x', 'width'\. .*Known: frame, id"):
        list(read_folder(tmp_path))


def test_quoted_cells_are_read(tmp_path: Path) -> None:
    (plain,) = read_folder(write_trio(tmp_path, busy_road(frames=5)))
    for path in tmp_path.glob("*.csv"):
        lines = path.read_text().splitlines()
        cells = (",".join(f'"{cell}"' for cell in line.split(",")) for line in lines)
        path.write_text("\n".join(cells) + "\n")
    (quoted,) = read_folder(tmp_path)
    assert quoted.tracks.equals(plain.tracks)


def test_a_two_lane_recording_is_shown_with_the_reason_why_nothing_is_learnt(
    tmp_path: Path,
) -> None:
    rows = [
        row
        for k in range(1, 6)
        for row in driven(Row(vehicle=k, x=100.0 + 30 * k, y=31.0, lane_id=5), 60)
    ]
    done = charms_bench("data", write_trio(tmp_path, rows, upper="10;14;18", lower="30;34;38"))
    assert done.returncode == 0, done
    assert "1 with 2 lanes" in done.stdout
    assert "charms: no row to learn from; rejected: carriageway of fewer than" in done.stdout


def test_the_tables_that_calibrate_reads_are_summarised(tmp_path: Path) -> None:
    import polars as pl

    times = np.arange(300) / 10
    frame = pl.DataFrame({"run": 1, "t_s": times, "speed_mps": 20.0, "gap_m": 30.0})
    frame.write_parquet(tmp_path / "i24.parquet")
    said = charms_bench("data", tmp_path / "i24.parquet").stdout
    assert "drivers" in said
    assert "1.50" in said  # the time gap, s
