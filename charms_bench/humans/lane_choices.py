"""When drivers change lanes: one threshold and one noise scale, fitted to recorded choices.

Once per second, a driver changes to a side lane with probability v / (1 + exp((threshold - gain) /
scale)), where v is the driver's speed divided by the mean speed of the recording: published rates
of lane changes are rates per distance. The gain is the acceleration of IDM in that lane minus that
in the driver's own lane; an acceleration below -2 m/s2 counts as -2. A lane in which the driver or
the new follower would have to brake harder is not open. IDM's desired speed is at least the speed
of the driver, or no lane would be open to drivers who are faster than the median driver wants to
be. MOBIL's other constants are not identified by a few dozen lane changes, so the politeness is 0
and the limit of braking is the profile's. Lane changes to and from exits are left out.
"""

from collections.abc import Collection, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
import polars as pl
from scipy.special import expit

from charms_bench.foundation.compiled import compiled
from charms_bench.humans.calibration import of_drivers
from charms_bench.humans.car_following import idm
from charms_bench.humans.population import LaneChanges
from charms_bench.humans.trips import CAR_LENGTH_M, I75_MAIN_LANES, RATE_HZ, Trip, numbered_through
from charms_bench.metrics.rows import UNDONE_WITHIN_S
from charms_bench.world.csv_table import read_parquet
from charms_bench.world.profile import CHARMS
from charms_bench.world.scene import Bools, Floats, Ints
from charms_bench.world.trajectories import STAY_S

START_S = 2.0
"""Time from the decision until the vehicle's centre is in the new lane, as in the references."""
FEWEST_CHANGES = 10
"""With fewer, no threshold is fitted."""
_THRESHOLDS_MPS2, _SCALES_MPS2 = (-50.0, 100.0), (0.01, 10.0)
_NOT_ASKED = 9
"""A side that no driver can choose."""


class Choices(NamedTuple):
    """N possible lane changes, one per second and open side lane."""

    gain: Floats
    """(N,) m/s2."""
    changed: Bools
    """(N,) whether the driver changed."""
    speed: Floats
    """(N,) the driver's, m/s."""
    recorded: int
    """Number of lane changes, including those to a lane that is not open by the model's rule."""
    driven_km: float


def read_choices(path: Path, p: Floats, held_out: Collection[int] = ()) -> Choices:
    """The choices in recordings, as `read_trips` reads them, for an IDM driver with p (5,).

    Those of the `held_out` drivers are left out; their vehicles are only neighbours.
    """
    found = [_choices(rows, p, held_out) for rows in _rows_with_lanes(path)]
    return Choices(
        np.concatenate([np.empty(0), *(each.gain for each in found)]),
        np.concatenate([np.empty(0, dtype=np.bool_), *(each.changed for each in found)]),
        np.concatenate([np.empty(0), *(each.speed for each in found)]),
        sum(each.recorded for each in found),
        sum(each.driven_km for each in found),
    )


def read_lane_counts(path: Path, trips: Sequence[Trip]) -> Floats:
    """(L, 4) kilometres, lane changes, undone ones and collisions of the drivers of some trips.

    No recorded driver collides. Without lanes, lane changes are not a number, and the kilometres
    are those of the trips.
    """
    by_driver, found = of_drivers(trips), []
    for rows in _rows_with_lanes(path):
        rate = _rate_of(rows)
        changes = _changes(rows, rate)
        back = (pl.col("side") == -pl.col("side").shift(1)) & (
            pl.col("end") - pl.col("end").shift(1) <= UNDONE_WITHIN_S
        )
        changes = changes.with_columns(undone=back.over("vehicle").fill_null(False))
        per_vehicle = changes.group_by("vehicle").agg(pl.len(), pl.sum("undone"))
        km = rows.group_by("vehicle").agg(km=pl.col("speed").sum() / rate / 1000)
        km = km.filter(pl.col("vehicle").is_in(list(by_driver)))
        joined = km.join(per_vehicle, on="vehicle", how="left").fill_null(0).sort("vehicle")
        joined = joined.select("km", "len", "undone", collisions=pl.lit(0))
        found.append(joined.to_numpy().astype(np.float64))
    if found:
        return np.concatenate(found)
    driven = [sum(trip.speed.sum() for trip in own) for own in by_driver.values()]
    return np.array([[m / RATE_HZ / 1000, np.nan, np.nan, 0.0] for m in driven])


def _rows_with_lanes(path: Path) -> list[pl.DataFrame]:
    """Columns vehicle, lane, x, speed, length, group and second of each recording with lanes.

    Vehicles have the numbers of the drivers of `read_trips`.
    """
    tables = []
    if path.suffix != ".parquet":
        for recording, first in numbered_through(path):
            second = (pl.col("frame") - pl.col("frame").min()) / recording.frame_rate_hz
            rows = recording.tracks.filter("on_road")
            columns = (pl.col("vehicle") + first, "lane", "x", "speed", "length")
            tables.append(rows.select(*columns, group="direction", second=second))
    elif "lead_id" in (table := read_parquet(path)).columns:
        rows, length = table.filter(pl.col("lane").is_in(I75_MAIN_LANES)), pl.lit(CAR_LENGTH_M)
        names = {"x": "s", "speed": "v", "second": "t"}
        tables.append(rows.select("vehicle", "lane", **names, length=length, group=pl.lit(0)))
    return [rows.sort("vehicle", "second") for rows in tables]


def _rate_of(rows: pl.DataFrame) -> float:
    step = rows["second"].unique().sort().diff().median()
    return 1 / step if isinstance(step, float) and step > 0 else 1.0


def _changes(rows: pl.DataFrame, rate: float) -> pl.DataFrame:
    """The vehicle, the end of the stay in the lane that it leaves, and the side (-1 or 1)."""
    return (
        rows.with_columns(stay=pl.struct("vehicle", "lane").rle_id())
        .group_by("stay")
        .agg(pl.len(), pl.first("vehicle", "lane"), end=pl.last("second"))
        .filter(pl.col("len") >= STAY_S * rate)
        .sort("stay")
        .with_columns(next_lane=pl.col("lane").shift(-1).over("vehicle"))
        .filter((pl.col("next_lane") - pl.col("lane")).abs() == 1)
        .select("vehicle", "end", side=pl.col("next_lane") - pl.col("lane"))
    )


def fit_choices(choices: Choices) -> LaneChanges | None:
    """The most likely scale, and the threshold with which as many changes are expected as recorded.

    None if there are too few lane changes.
    """
    from scipy.optimize import brentq, minimize

    if choices.changed.sum() < FEWEST_CHANGES:
        return None
    sign = np.where(choices.changed, 1.0, -1.0)

    def cost(p: Floats) -> float:
        return float(np.logaddexp(0, sign * (p[0] - choices.gain) / np.exp(p[1])).sum())

    bounds = [_THRESHOLDS_MPS2, tuple(np.log(_SCALES_MPS2))]
    scale = np.exp(minimize(cost, [5.0, 0.0], method="Nelder-Mead", bounds=bounds).x[1])

    mean_mps = float(choices.speed.mean())

    def excess(threshold: float) -> float:
        likely = expit((choices.gain - threshold) / scale) * choices.speed / mean_mps
        return float(likely.sum() - choices.recorded)

    threshold = brentq(excess, *_THRESHOLDS_MPS2)
    numbers = {"threshold_mps2": round(threshold, 4), "scale_mps2": round(float(scale), 4)}
    return LaneChanges(**numbers, speed_mps=round(mean_mps, 4), changes=choices.recorded)


def _choices(rows: pl.DataFrame, p: Floats, held_out: Collection[int]) -> Choices:
    """The choices of one recording; columns vehicle, lane, x, speed, length, group, second."""
    rate = _rate_of(rows)
    is_fitted = ~pl.col("vehicle").is_in(list(held_out))
    driven_km = float(rows.filter(is_fitted)["speed"].sum()) / rate / 1000
    stays = _changes(rows, rate)
    # The choice that comes last before the vehicle starts to move is the one that it makes.
    rounded = (pl.col("second") * rate).round().cast(pl.Int64)
    decided = rows.filter(rounded % round(rate) == 0).with_columns(
        until=pl.col("second") + START_S + 1
    )
    decided = decided.sort("until").join_asof(
        stays.sort("end"), left_on="until", right_on="end", by="vehicle", strategy="backward",
        check_sortedness=False,
    )  # fmt: skip
    moves = pl.col("end") >= pl.col("second")
    is_first = (pl.col("end") > pl.col("until") - 1).fill_null(False)
    side = pl.when(moves.fill_null(False)).then("side").otherwise(0)
    chosen = pl.when(is_first).then(side).otherwise(side * _NOT_ASKED)
    decided = decided.with_columns(chosen=pl.when(is_fitted).then(chosen).otherwise(_NOT_ASKED))
    decided = decided.with_columns(moment=pl.struct("group", "second").rank("dense"))
    decided = decided.sort("moment", "x")
    columns = {name: decided[name].to_numpy() for name in decided.columns if name != "until"}
    lanes = int(columns["lane"].max()) + 1
    gain, speeds = np.empty(2 * decided.height), np.empty(2 * decided.height)
    changed = np.zeros(2 * decided.height, dtype=np.bool_)
    count = _weigh(
        (columns["moment"], columns["lane"], columns["chosen"]),
        (columns["x"], columns["speed"], columns["length"]),
        lanes,
        p,
        CHARMS.idm_mobil.imposed_braking_mps2,
        (gain, changed, speeds),
    )
    arrays = gain[:count], changed[:count], speeds[:count]
    return Choices(*arrays, stays.filter(is_fitted).height, driven_km)


@compiled
def _weigh(
    places: tuple[Ints, Ints, Ints],
    states: tuple[Floats, Floats, Floats],
    lanes: int,
    p: Floats,
    limit: float,
    answers: tuple[Floats, Bools, Floats],
) -> int:
    """Fills in the gains, choices and speeds of rows sorted by moment and x; returns their number.

    `places` are moments, lanes and chosen sides, `states` are x, speeds and lengths.
    """
    (moment, lane, chosen), (x, speed, length), (gain, changed, speeds) = places, states, answers
    count, median, own = 0, p[0], p.copy()
    for i in range(x.size):
        if abs(chosen[i]) > 1:
            continue  # the vehicle already moves to the new lane, or is held out
        for side in (-1, 1):
            new = lane[i] + side
            if new < 0 or new >= lanes:
                continue
            accelerations = np.zeros(2)
            for k in range(2):
                aim, j = lane[i] + k * side, i + 1
                while j < x.size and moment[j] == moment[i] and lane[j] != aim:
                    j += 1
                is_led = j < x.size and moment[j] == moment[i]
                gap = x[j] - x[i] - (length[i] + length[j]) / 2 if is_led else 1e9
                ahead = speed[j] if is_led else speed[i]
                own[0] = max(median, speed[i])
                accelerations[k] = idm(speed[i], gap, ahead, own)
            j = i - 1
            while j >= 0 and moment[j] == moment[i] and lane[j] != new:
                j -= 1
            braking = 0.0
            if j >= 0 and moment[j] == moment[i]:
                gap = x[i] - x[j] - (length[i] + length[j]) / 2
                own[0] = max(median, speed[j])
                braking = -idm(speed[j], gap, speed[i], own) if gap > 0 else 1e9
            if braking <= limit and accelerations[1] >= -limit:
                gain[count] = accelerations[1] - max(accelerations[0], -limit)
                changed[count] = chosen[i] == side
                speeds[count] = speed[i]
                count += 1
    return count
