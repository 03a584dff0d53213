"""Trips of recorded drivers behind a leader, from which drivers are calibrated and judged.

A trip is a stretch of at least 20 s in which a driver stays in one lane behind one leader, with a
gap of 1 to 100 m. Three kinds of recordings are read: folders in highD's format, and the tables
that this project keeps of I-24 (CIRCLES) and I-75 (HIGH-SIM).
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import polars as pl

from charms_bench.errors import DataError
from charms_bench.world.csv_table import read_parquet
from charms_bench.world.recording_folder import read_folder
from charms_bench.world.scene import Floats
from charms_bench.world.trajectories import Recording

RATE_HZ = 10
"""Rows per second of every trip."""
SHORTEST_S = 20.0
GAPS_M = (1.0, 100.0)
"""Gaps of a trip, bumper to bumper."""
CAR_LENGTH_M = 5.0
"""Assumed where a recording has no lengths."""
JUMP_M = 2.0
"""On I-24, a gap that changes by more within 0.1 s is the gap to another leader."""
I75_MAIN_LANES = (0, 1, 2)
"""Lane -1 of I-75 is auxiliary and leads to an exit."""
SPLIT_SEED = 29
DRIVERS_LIMIT = 200
"""Most drivers of either half; more make the fit slow and hardly more precise."""
_SMOOTHED_S = 3.1
_I24 = ("run", "t_s", "speed_mps", "gap_m")
_I75 = ("vehicle", "frame", "lane", "s", "v", "lead_id", "dhw")
_I75_FRAMES_A_ROW = 3


@dataclass(frozen=True, eq=False)
class Trip:
    """A driver behind one leader, at 10 Hz."""

    driver: int
    gap: Floats
    """(n,) from bumper to bumper, m."""
    speed: Floats
    """(n,) the driver's, m/s."""
    leader_x: Floats
    """(n,) the leader's rear bumper, m; the driver's front bumper starts at 0."""
    leader_speed: Floats
    """(n,) m/s."""


Driver = Callable[[Trip, np.random.Generator], tuple[Floats, Floats]]
"""Gaps and speeds (M, n) of M repetitions, or draws, that replace a trip's driver."""


def read_trips(path: Path) -> list[Trip]:
    """The trips in a folder in highD's format, or in the table of I-24 or of I-75.

    Raises a `DataError` if the recordings cannot be read, or contain no trip.
    """
    if path.suffix == ".parquet":
        rows = _table_rows(path)
    else:
        rows = pl.concat(_recording_rows(*each) for each in numbered_through(path))
    allowed = pl.col("gap").is_between(*GAPS_M).fill_null(False)
    pieces = rows.with_columns(piece=pl.struct("driver", "stretch", allowed).rle_id())
    pieces = pieces.filter(allowed, pl.len().over("piece") >= round(SHORTEST_S * RATE_HZ))
    if pieces.is_empty():
        raise DataError(
            f"{path}: no driver follows one leader for {SHORTEST_S:g} s with a gap of "
            f"{GAPS_M[0]:g} to {GAPS_M[1]:g} m. The recorded section must be long enough to see a "
            f"driver for {SHORTEST_S:g} s: at 30 m/s, {30 * SHORTEST_S:g} m"
        )
    return [_trip(part) for part in pieces.partition_by("piece", maintain_order=True)]


def split(trips: Sequence[Trip]) -> tuple[list[Trip], list[Trip]]:
    """The trips of a random half of the drivers, which are fitted, and of held-out drivers."""
    drivers = np.unique([trip.driver for trip in trips])
    drivers = np.random.default_rng(SPLIT_SEED).permutation(drivers)
    half = (drivers.size + 1) // 2
    fitted = set(drivers[: min(half, DRIVERS_LIMIT)].tolist())
    held_out = set(drivers[half : half + DRIVERS_LIMIT].tolist())
    return (
        [trip for trip in trips if trip.driver in fitted],
        [trip for trip in trips if trip.driver in held_out],
    )


def _table_rows(path: Path) -> pl.DataFrame:
    """Columns driver, stretch, gap and speed of the table of I-24 or I-75, in order of time."""
    table = read_parquet(path)
    if set(_I24) <= set(table.columns):
        rows = table.sort("run", "t_s").with_columns(driver="run", gap="gap_m", speed="speed_mps")
        new = (pl.col("gap").diff().abs() > JUMP_M) | (pl.col("t_s").diff() > 1.5 / RATE_HZ)
    elif set(_I75) <= set(table.columns):
        main = pl.col("lane").is_in(I75_MAIN_LANES) & (pl.col("lead_id") != 0)
        gap = pl.when(main).then(pl.col("dhw") - CAR_LENGTH_M)
        rows = table.sort("vehicle", "frame").with_columns(driver="vehicle", gap=gap, speed="v")
        new = pl.any_horizontal(pl.col("lead_id", "lane").diff() != 0)
        new |= pl.col("frame").diff() != _I75_FRAMES_A_ROW
    else:
        raise DataError(
            f"{path}: expected the columns {', '.join(_I24)} (I-24) or {', '.join(_I75)} (I-75); "
            f"found {', '.join(table.columns[:20])}"
        )
    new |= pl.col("driver").diff() != 0
    numbers = pl.col("gap", "speed").cast(pl.Float64)
    rows = rows.with_columns(numbers, stretch=new.fill_null(True).cum_sum())
    return rows.select("driver", "stretch", "gap", "speed")


def numbered_through(folder: Path) -> Iterator[tuple[Recording, int]]:
    """The recordings of a folder, and what to add to the vehicles of each to tell all apart."""
    first = 0
    for recording in read_folder(folder):
        yield recording, first
        first += int(recording.tracks["vehicle"].max()) + 1  # type: ignore[arg-type]


def _recording_rows(recording: Recording, first: int) -> pl.DataFrame:
    """The same of a recording, the numbers of whose drivers begin after `first`."""
    lane = ("direction", "frame", "lane")
    ahead = pl.col("vehicle", "x", "length").shift(-1).over(lane, order_by="x").name.prefix("next_")
    between = pl.col("next_x") - pl.col("x") - (pl.col("next_length") + pl.col("length")) / 2
    rows = (
        recording.tracks.filter("on_road")
        .with_columns(ahead)
        .with_columns(gap=between, driver=pl.col("vehicle") + first)
        .sort("vehicle", "frame")
    )
    new = pl.any_horizontal(pl.col("vehicle", "lane", "next_vehicle").diff() != 0)
    new |= pl.col("frame").diff() != 1
    rows = rows.with_columns(stretch=new.fill_null(True).cum_sum())
    rows = rows.select("driver", "stretch", "gap", "speed")
    if recording.frame_rate_hz == RATE_HZ:
        return rows
    return pl.concat(
        _resampled(part, recording.frame_rate_hz)
        for part in rows.partition_by("stretch", maintain_order=True)
    )


def _resampled(rows: pl.DataFrame, rate_hz: float) -> pl.DataFrame:
    """One stretch at 10 Hz."""
    given = np.arange(rows.height) / rate_hz
    times = np.arange(int(given[-1] * RATE_HZ + 1e-9) + 1) / RATE_HZ
    columns = {
        name: np.interp(times, given, rows[name].fill_null(np.nan).to_numpy())
        for name in ("gap", "speed")
    }
    first = rows.select(pl.first("driver", "stretch"))
    return pl.DataFrame(columns).join(first, how="cross").select(rows.columns)


def _trip(rows: pl.DataFrame) -> Trip:
    from scipy.signal import savgol_filter

    gap, speed = rows["gap"].to_numpy(), rows["speed"].to_numpy()
    x = np.concatenate([[0.0], np.cumsum((speed[1:] + speed[:-1]) / 2)]) / RATE_HZ
    window = round(_SMOOTHED_S * RATE_HZ)
    leader_x = savgol_filter(x + gap, window, 2)
    leader_speed = savgol_filter(x + gap, window, 2, deriv=1, delta=1 / RATE_HZ)
    return Trip(rows["driver"][0], gap, speed, leader_x, np.maximum(leader_speed, 0.0))
