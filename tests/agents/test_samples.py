"""Samples: labelled, rejected, undersampled, split and cached."""

from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl
import pytest
from charms_agents.human.samples import (
    REASONS,
    CharmsSampler,
    Samples,
    SampleSettings,
    SampleStore,
    collect,
    fingerprint,
)
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from trios import Row, busy_road, write_trio

from charms_bench.errors import DataError
from charms_bench.humans.survey import survey
from charms_bench.world.observations import COMMANDS, Neighbours
from charms_bench.world.recording_folder import find_trios

US_101 = Path(__file__).parents[2] / "../shared/data/us101_highd_format"
TRUCK, FEW_LANES, BESIDE, NO_LANE, HIDDEN, FEW_NEIGHBOURS, REPEATED = REASONS


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Five recordings of a busy road."""
    for number in range(1, 6):
        write_trio(tmp_path, busy_road(), number)
    return tmp_path


def measured_road() -> list[Row]:
    """The busy road, where no two vehicles measure the same at any time."""
    return [
        replace(row, vx=row.vx + row.vehicle / 1000, ax=row.ax + row.frame / 1000)
        for row in busy_road()
    ]


def sides(samples: Samples) -> tuple[set[int], set[int]]:
    """The drivers of the held-out samples and those of the training samples."""
    driver = samples.rows["driver"]
    return set(driver.filter(samples.held_out)), set(driver.filter(~samples.held_out))


def decisions(folder: Path, **settings: Any) -> pl.DataFrame:
    """All decisions of a folder, with their labels."""
    sampler = CharmsSampler(SampleSettings(**settings))
    survey(folder, {"charms": sampler})
    return sampler.decisions()


def test_rows_are_rejected_for_the_first_reason_that_holds(folder: Path) -> None:
    rows = decisions(folder)

    def rejected(lane: int, place: int) -> object:
        return rows.filter(vehicle=11 * lane + place + 1)["rejected"][0]

    assert rejected(1, 5) == TRUCK
    assert rejected(1, 0) == HIDDEN
    assert rejected(2, 4) == NO_LANE  # the 27th: drifts right on the right lane
    assert rejected(1, 4) is None


def test_other_reasons_are_beside_the_road_few_lanes_and_few_neighbours(tmp_path: Path) -> None:
    far = Row(vehicle=90, x=-500.0), Row(vehicle=91, x=1000.0)
    beside = Row(vehicle=92, x=200.0, y=44.0, lane_id=8)
    alone = Row(vehicle=93, x=450.0)
    narrow = Row(vehicle=94, y=15.0, vx=-30.0, lane_id=3, direction=1)
    write_trio(tmp_path, [*busy_road(frames=1), *far, beside, alone, narrow], upper="10;14;18")
    rows = decisions(tmp_path)
    reasons = dict(rows.select("vehicle", "rejected").iter_rows())
    assert [reasons[v] for v in (92, 93, 94)] == [BESIDE, FEW_NEIGHBOURS, FEW_LANES]


def test_trucks_are_samples_when_wanted(folder: Path) -> None:
    rows = decisions(folder, cars_only=False)
    assert TRUCK not in rows["rejected"].to_list()


def test_a_label_follows_from_what_was_measured(folder: Path) -> None:
    accepted = decisions(folder).filter(pl.col("rejected").is_null())
    # Of the drivers' magnitudes 0.5, 0.8, 0, 0 m/s2 and 0, 0, 0.1 m/s.
    numbers = accepted["vehicle"].to_numpy() - 1
    a = np.array([0.5, 0.8, 0.0, 0.0])[numbers % 4]
    v = np.array([0.0, 0.0, 0.1])[numbers % 3]
    faster_right = (numbers % 4 == 0) & (numbers % 3 == 2)
    p_speed = (0.5 / a.mean()) / (0.5 / a.mean() + 0.1 / v.mean())
    labels = accepted["label"].to_numpy()[faster_right]
    np.testing.assert_allclose(labels, [[0, 0, 1 - p_speed, p_speed, 0]] * len(labels), rtol=1e-6)
    assert len(labels) > 0


def test_idle_rows_are_drawn_down_to_their_ratio(folder: Path) -> None:
    for _, rows in decisions(folder, idle_ratio=0.1).filter("sampled").group_by("recording"):
        idle = (rows["longitudinal"] == 0) & (rows["lateral"] == 0)
        assert idle.sum() == int(0.1 * (~idle).sum())
    everything = decisions(folder, idle_ratio=9)
    assert (everything["sampled"] == everything["rejected"].is_null()).all()


def test_whole_drivers_are_held_out(folder: Path) -> None:
    samples = collect(folder, SampleSettings(held_out=0.4))
    held_out, training = sides(samples)
    drivers = samples.rows["driver"].n_unique()
    assert not held_out & training
    assert len(held_out) == round(0.4 * drivers)
    assert len(training) == drivers - len(held_out)


def test_a_driver_of_two_recordings_is_on_one_side_and_counts_once(tmp_path: Path) -> None:
    # The second recording begins 10 frames later, with another origin of x and other numbers.
    later = [
        replace(row, vehicle=row.vehicle + 50, frame=row.frame - 10, x=row.x - 7.0)
        for row in measured_road()
        if row.frame > 10
    ]
    write_trio(tmp_path, measured_road(), 1, start="07:50")
    write_trio(tmp_path, later, 2, start="07:50")
    rows = decisions(tmp_path)
    named = rows.select("recording", "vehicle", "driver").unique()
    drivers = {(recording, vehicle): driver for recording, vehicle, driver in named.iter_rows()}
    assert all(drivers[1, v] == drivers[2, v + 50] for v in range(1, 34))
    assert len(set(drivers.values())) == 33
    held_out, training = sides(collect(tmp_path))
    assert not held_out & training
    # Decisions are at the frames 1, 9, 18 and 26, and in the second recording at 11 and 19.
    assert (rows["rejected"] == REPEATED).sum() == 0


def test_the_same_decision_of_two_recordings_counts_once(tmp_path: Path) -> None:
    for number in (1, 2):
        write_trio(tmp_path, measured_road(), number, start="07:50")
    rows = decisions(tmp_path)
    first, second = (rows.filter(recording=number) for number in (1, 2))
    accepted = first["rejected"].is_null()
    assert accepted.any()
    assert second.filter(accepted)["rejected"].to_list() == [REPEATED] * accepted.sum()


def test_recordings_of_other_times_share_no_drivers(tmp_path: Path) -> None:
    for number in (1, 2):
        write_trio(tmp_path, measured_road(), number)
    rows = decisions(tmp_path)
    assert rows["driver"].n_unique() == 66
    assert (rows["rejected"] == REPEATED).sum() == 0


def test_stationary_vehicles_are_not_taken_for_the_same_driver(tmp_path: Path) -> None:
    for number in (1, 2):
        write_trio(tmp_path, [replace(row, vx=0.5) for row in busy_road()], number, start="07:50")
    assert decisions(tmp_path)["driver"].n_unique() == 66


@pytest.mark.skipif(not US_101.is_dir(), reason="needs ../shared/data, human recordings")
def test_no_driver_of_us_101_is_on_both_sides() -> None:
    samples = collect(US_101)
    held_out, training = sides(samples)
    assert not held_out & training
    # Read again from the files: no moving vehicle's values are on both sides. The origin of x
    # differs between recordings.
    tracks = pl.concat(
        pl.read_csv(trio.tracks).with_columns(recording=pl.lit(trio.number, dtype=pl.Int64))
        for trio in find_trios(US_101)
    ).filter(pl.col("xVelocity") > 1)
    keys = ["y", "width", "height", "xVelocity", "yVelocity", "xAcceleration", "yAcceleration"]
    rows = samples.rows.select("recording", "vehicle", held_out=samples.held_out).unique()
    named = tracks.join(rows, left_on=["recording", "id"], right_on=["recording", "vehicle"])
    both = named.group_by(keys).agg(sides=pl.col("held_out").n_unique())
    assert both["sides"].max() == 1


def test_a_driver_of_a_single_recording_is_on_one_side_too(tmp_path: Path) -> None:
    found = collect(write_trio(tmp_path, busy_road()))
    sides = found.rows.with_columns(held_out=found.held_out).group_by("vehicle", "direction")
    assert sides.agg(pl.col("held_out").n_unique())["held_out"].max() == 1
    assert 0 < found.held_out.sum() < len(found.labels)


def test_the_seed_decides_on_what_is_drawn_and_held_out(folder: Path) -> None:
    runs = [collect(folder, SampleSettings(seed=seed)) for seed in (0, 0, 1)]
    assert runs[0].rows.equals(runs[1].rows)
    assert not runs[0].rows.equals(runs[2].rows)


def test_the_cache_is_read_back_and_its_bytes_do_not_vary(folder: Path, tmp_path: Path) -> None:
    caches = [tmp_path / name for name in ("one", "two")]
    stores = [SampleStore(folder, caches[k], SampleSettings()) for k in (0, 0, 1)]
    made = collect(folder)
    for samples in (store.load() for store in stores):
        np.testing.assert_array_equal(samples.observations, made.observations)
        np.testing.assert_array_equal(samples.labels, made.labels)
        np.testing.assert_array_equal(samples.held_out, made.held_out)
        assert samples.rows.equals(made.rows)
    files = [path for cache in caches for path in cache.iterdir()]
    assert [path.name for path in files] == [
        SampleStore(folder, caches[0], SampleSettings()).path.name
    ] * 2
    assert files[0].read_bytes() == files[1].read_bytes()


def test_the_fingerprint_follows_files_and_settings(folder: Path) -> None:
    before = fingerprint(find_trios(folder), SampleSettings())
    assert fingerprint(find_trios(folder), SampleSettings(seed=1)) != before
    path = folder / "03_tracks.csv"
    path.write_text(path.read_text().replace(",0.5,", ",0.6,", 1))
    assert fingerprint(find_trios(folder), SampleSettings()) != before


@pytest.mark.parametrize("content", [b"", b"no parquet"])
def test_a_damaged_cache_says_so(folder: Path, tmp_path: Path, content: bytes) -> None:
    SampleStore(folder, tmp_path / "cache", SampleSettings()).load()
    (path,) = (tmp_path / "cache").iterdir()
    path.write_bytes(content)
    with pytest.raises(DataError, match=r"cannot be read: .*; delete it and try again"):
        SampleStore(folder, tmp_path / "cache", SampleSettings()).load()


def test_another_table_in_the_cache_is_rejected(folder: Path, tmp_path: Path) -> None:
    SampleStore(folder, tmp_path / "cache", SampleSettings()).load()
    (path,) = (tmp_path / "cache").iterdir()
    pl.DataFrame({"a": [1]}).write_parquet(path)
    with pytest.raises(DataError, match="holds other columns or too many rows; delete it"):
        SampleStore(folder, tmp_path / "cache", SampleSettings()).load()


def test_a_road_of_one_lane_leaves_nothing_to_learn(tmp_path: Path) -> None:
    write_trio(tmp_path, [replace(Row(), y=31.0, lane_id=6)], lower="30;34")
    with pytest.raises(DataError, match=f"no row to learn from; rejected: {FEW_LANES} 1"):
        collect(tmp_path)


@settings(
    max_examples=150,
    deadline=None,
    derandomize=True,
    suppress_health_check=[HealthCheck.function_scoped_fixture],
)
@given(
    kind=st.sampled_from(["tracks", "tracksMeta", "recordingMeta"]),
    at=st.floats(0, 1),
    length=st.integers(0, 40),
    text=st.text(st.sampled_from("0123456789.,;-+enaxif=\"'\r\n \t\0é"), max_size=12),
)
def test_damage_is_an_error_of_the_data_or_does_no_harm(
    tmp_path: Path, kind: str, at: float, length: int, text: str
) -> None:
    path = write_trio(tmp_path, busy_road(frames=1)) / f"01_{kind}.csv"
    content = path.read_text()
    start = int(at * len(content))
    path.write_text(content[:start] + text + content[start + length :], newline="")
    with suppress(DataError):
        samples = collect(tmp_path)
        assert np.isfinite(samples.observations).all()
        np.testing.assert_allclose(samples.labels.sum(axis=1), 1, rtol=1e-6)


def test_labels_of_small_steps_accelerate_as_the_drivers_go_on_to_do(folder: Path) -> None:
    rows = decisions(folder, labels="manoeuvre", step_mps=0.25).filter(
        pl.col("rejected").is_null(), lateral=0
    )
    labels, acceleration = rows["label"].to_numpy(), rows["acceleration"].to_numpy()
    # 0.25 m/s at each of three decisions per second are 0.75 m/s2 at most.
    found = 0.75 * labels @ np.array([0.0, 0.0, 0.0, 1.0, -1.0])
    np.testing.assert_allclose(found, acceleration.clip(-0.75, 0.75), atol=1e-6)
    assert set(acceleration) == {-0.8, 0.0, 0.5}


def test_step_labels_need_manoeuvres() -> None:
    with pytest.raises(ValueError, match="step_mps is for labels: manoeuvre"):
        SampleSettings(step_mps=0.25)


def test_samples_with_commands_are_cached_beside_those_without(
    folder: Path, tmp_path: Path
) -> None:
    cache, seen = tmp_path / "cache", Neighbours(commands=True)
    plain = SampleStore(folder, cache, SampleSettings()).load()
    for _ in range(2):  # collects them, then reads them
        found = SampleStore(folder, cache, SampleSettings(), seen).load()
        assert found.observations.shape == (len(plain.labels), 8, 5)
        np.testing.assert_array_equal(found.observations[:, :COMMANDS], plain.observations)
        assert found.observations[:, COMMANDS].any()
    assert len(list(cache.iterdir())) == 2
