"""Moments of recordings: which there are, how recordings are split, and what is rejected."""

import csv
import re
from contextlib import suppress
from pathlib import Path
from typing import Any

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from pydantic import ValidationError
from trios import Row, driven, flowing_road, write_trio

from charms_bench.errors import DataError
from charms_bench.world.recorded_moments import moments_of, scene_of
from charms_bench.world.scene import SceneSettings

SLOW = {"name": "charms", "speed_min_mps": 0.0, "target_speed_min_mps": 0.0}
US_101 = Path(__file__).parents[2] / "../shared/data/us101_corrected"


def scene(folder: Path, duration_s: float = 2.0, **fields: Any) -> SceneSettings:
    recording = {"folder": str(folder), **fields.pop("recording", {})}
    return scene_of(
        {"profile": SLOW, "simulation_hz": 30, "duration_s": duration_s, "recording": recording}
        | fields
    )


def starts(made: SceneSettings) -> set[tuple[int, int, int]]:
    """Recording, vehicle and frame of every moment."""
    words = [name.replace(",", "").split() for name in moments_of(made).names]
    return {(int(each[1]), int(each[5]), int(each[7])) for each in words}


def test_the_recordings_decide_lanes_widths_and_places(tmp_path: Path) -> None:
    lower = "30;33.7;37.4;41.1"
    write_trio(tmp_path, driven(Row(), 51) + driven(Row(vehicle=2, x=60), 51), lower=lower)
    made = scene(tmp_path)
    assert (made.lanes, made.profile.lane_width_m, made.vehicles) == (3, 3.7, 2)
    assert made.profile.name == "charms"


def test_a_moment_is_followed_by_an_episode_of_its_vehicle(tmp_path: Path) -> None:
    # 25 Hz, so an episode of 2 s takes 50 frames after the first.
    write_trio(tmp_path, driven(Row(), 51) + driven(Row(vehicle=2, x=60), 50))
    assert starts(scene(tmp_path)) == {(1, 1, 1)}


def test_the_episodes_of_a_vehicle_do_not_overlap_in_time(tmp_path: Path) -> None:
    write_trio(tmp_path, driven(Row(), 140))
    assert starts(scene(tmp_path)) == {(1, 1, 1), (1, 1, 51)}


def test_egos_start_on_main_lanes(tmp_path: Path) -> None:
    right = Row(vehicle=2, y=39.0, lane_id=8)
    write_trio(tmp_path, driven(Row(), 51) + driven(right, 51))
    assert starts(scene(tmp_path, recording={"main_lanes": 2})) == {(1, 1, 1)}


def test_no_episode_starts_while_vehicles_overlap(tmp_path: Path) -> None:
    # Vehicle 3 drives into vehicle 2 after frame 40, and vehicle 1 is far away.
    ahead, behind = Row(vehicle=2, x=200.0, vx=20.0), Row(vehicle=3, x=179.0, vx=30.0)
    write_trio(tmp_path, driven(Row(vx=25.0), 121) + driven(ahead, 71) + driven(behind, 71))
    made = scene(tmp_path)
    assert not {frame for _, _, frame in starts(made)} & set(range(42, 66))


def test_a_vehicle_that_is_lost_for_a_frame_has_two_tracks(tmp_path: Path) -> None:
    rows = [row for row in driven(Row(), 120) if row.frame != 60]
    write_trio(tmp_path, rows)
    assert starts(scene(tmp_path)) == {(1, 1, 1), (1, 1, 61)}


@pytest.mark.parametrize("by", ["driver", "time", "place"])
def test_train_and_test_share_no_driver_no_time_or_no_place(tmp_path: Path, by: str) -> None:
    for number in (1, 2, 3):
        write_trio(tmp_path, flowing_road(10), number=number, rate=10, place=f"place {number}")
    parts = {
        part: starts(scene(tmp_path, 1.0, recording={"split": {"by": by, "part": part}}))
        for part in ("train", "test")
    }
    train, test = parts["train"], parts["test"]
    assert train
    assert test
    if by == "driver":
        assert not {each[:2] for each in train} & {each[:2] for each in test}
    elif by == "time":
        for number in (1, 2, 3):  # an episode takes 10 frames
            latest = max(frame + 10 for k, _, frame in train if k == number)
            assert latest < min(frame for k, _, frame in test if k == number)
    else:
        assert {each[0] for each in test} == {3}
        assert {each[0] for each in train} == {1, 2}


def test_seeds_give_moments_in_an_order_of_their_own(tmp_path: Path) -> None:
    write_trio(tmp_path, flowing_road(10), rate=10)
    found = [*starts(scene(tmp_path))]
    names = moments_of(scene(tmp_path)).names
    assert len(set(names)) == len(names) == len(found)
    assert list(names) != sorted(names)


def test_content_and_not_the_path_identifies_recordings(tmp_path: Path) -> None:
    for name in ("here", "there"):
        (tmp_path / name).mkdir()
        write_trio(tmp_path / name, driven(Row(), 51))
    here, there = (scene(tmp_path / name).recording for name in ("here", "there"))
    assert here is not None
    assert there is not None
    assert here.sha256 == there.sha256


def test_settings_that_were_read_once_need_no_recordings(tmp_path: Path) -> None:
    made = scene(write_trio(tmp_path, driven(Row(), 51)))
    kept = made.model_dump(mode="json")
    for path in tmp_path.iterdir():
        path.unlink()
    again = SceneSettings.model_validate(kept, strict=False)
    assert again.vehicles == made.vehicles
    with pytest.raises(DataError, match=r"no recordings; expected files named like 01_tracks\.csv"):
        moments_of(again)


def test_recordings_that_have_changed_are_rejected(tmp_path: Path) -> None:
    made = scene(write_trio(tmp_path, driven(Row(), 51)))
    write_trio(tmp_path, driven(Row(x=101.0), 51))
    with pytest.raises(DataError, match="the recordings have changed since the settings were made"):
        moments_of(made)


MISTAKES: list[tuple[dict[str, Any], str]] = [
    ({"lanes": 5}, "no carriageway has 5 lanes; expected lanes: 3"),
    ({"traffic_vehicles": 3}, "traffic_vehicles: the recordings decide this; remove it"),
    ({"profile": {**SLOW, "lane_width_m": 3.5}}, "lane_width_m: the recordings decide this"),
    ({"profile": "charms"}, r"speeds from 12.0 to 14.0 m/s are outside the profile's, 22 to 33"),
    ({"duration_s": 60.0}, "no moment is followed by 60 s of a vehicle that is recorded"),
    ({"recording": {"main_lane": 1}}, "unknown key. .*main_lanes"),
    ({"recording": {"split": {"by": "place", "part": "test"}}}, "a split by place needs two loc"),
]


@pytest.mark.parametrize(("fields", "message"), MISTAKES)
def test_what_does_not_fit_is_rejected(
    tmp_path: Path, fields: dict[str, Any], message: str
) -> None:
    write_trio(tmp_path, flowing_road(10), rate=10)
    with pytest.raises(ValidationError, match=message):
        scene(tmp_path, **fields)


def test_lanes_of_different_widths_are_rejected_and_named(tmp_path: Path) -> None:
    write_trio(tmp_path, driven(Row(y=37.0, lane_id=7), 51), lower="30;34;38;41")
    with pytest.raises(
        ValidationError, match=r"lanes of 4.00, 4.00, 3.00 m in direction 2; .* 15%"
    ):
        scene(tmp_path)


@pytest.mark.parametrize("by", ["driver", "time"])
def test_recordings_that_may_show_the_same_drivers_are_not_split(tmp_path: Path, by: str) -> None:
    for number in (1, 2):
        write_trio(tmp_path, driven(Row(), 51), number=number, start="08:00")
    with pytest.raises(ValidationError, match="recordings 1 and 2 state the same place and time"):
        scene(tmp_path, recording={"split": {"by": by, "part": "train"}})


def test_a_vehicle_too_long_for_a_scene_is_named(tmp_path: Path) -> None:
    write_trio(tmp_path, driven(Row(length=40.0), 51))
    with pytest.raises(ValidationError, match="vehicle 1: width 40 m; expected 1 to 30 m"):
        scene(tmp_path)


@settings(
    suppress_health_check=[HealthCheck.function_scoped_fixture],
    max_examples=60,
    derandomize=True,
    deadline=None,
)
@given(
    kind=st.sampled_from(["tracks", "tracksMeta", "recordingMeta"]),
    line=st.integers(0, 80),
    column=st.integers(0, 10),
    cell=st.sampled_from(["", "x", "nan", "-1", "0", "1e9", "7;8", "Truck", '"', "3,4", "\n"]),
)
def test_a_malformed_recording_gives_one_clear_error(
    tmp_path: Path, kind: str, line: int, column: int, cell: str
) -> None:
    write_trio(tmp_path, driven(Row(), 51) + driven(Row(vehicle=2, x=60.0), 51))
    path = tmp_path / f"01_{kind}.csv"
    with path.open() as file:
        table = [*csv.reader(file)]
    row = table[line % len(table)]
    row[column % len(row)] = cell
    path.write_text("\n".join(",".join(each) for each in table) + "\n")
    with suppress(ValidationError):
        assert len(moments_of(scene(tmp_path))) > 0
        return
    with pytest.raises(ValidationError, match=re.escape(str(tmp_path))) as found:
        scene(tmp_path)
    assert len(found.value.errors()) == 1


@pytest.mark.skipif(not US_101.is_dir(), reason=f"no recordings in {US_101}")
def test_us_101_has_a_moment_for_every_episode_of_the_suite() -> None:
    made = scene(US_101, 8.0, recording={"main_lanes": 5})
    assert (made.lanes, made.profile.lane_width_m) == (6, 3.72)
    assert len(moments_of(made)) >= 300
