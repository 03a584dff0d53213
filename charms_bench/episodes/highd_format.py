"""Replayed episodes as recordings in highD's format [Krajewski et al. 2018], one per episode.

The road is the lower carriageway of the image, which drives towards larger x; the upper one has as
many lanes and no vehicles. `world.highd` reads the format and describes its axes.

As in highD, lanes and neighbours follow from the lane markings that enclose a vehicle's centre, and
0 stands for a value or a vehicle that does not exist, -1 in `tracksMeta`. `dhw` is the gap from
bumper to bumper, `thw` is `dhw` divided by the speed, and `ttc` is `dhw` divided by the closing
speed, negative behind a faster vehicle [highD-dataset, issue 9].
"""

from datetime import datetime, timedelta
from pathlib import Path

import numpy as np
import polars as pl

from charms_bench.episodes.replay import Replay
from charms_bench.world.gaps import gap_to
from charms_bench.world.scene import Bools, Floats, Ints
from charms_bench.world.trajectories import LOWER
from charms_bench.world.vehicle_types import TRUCK_LENGTH_M

MEDIAN_M = 4.0
WEEK_DAYS = ("Mon", "Tue", "Wed", "Thu", "Fri", "Sat", "Sun")
NO_NEIGHBOUR = 0
_NO_LANE = -100
"""Of a vehicle that is not there: beside no lane."""
BESIDE = {"left": -1, "right": 1}
"""By how much the lane on either side differs from a vehicle's own."""
PAIRS_AT_ONCE = 2**21
"""Pairs of vehicles compared together; limits the memory that large scenes need."""


def write_recording(replay: Replay, folder: Path) -> None:
    """Writes the three files of an episode; its seed is the number of the recording.

    Vehicle k of the replay has the id k + 1.
    """
    tracks = _tracks(replay)
    files = {
        "tracks": tracks,
        "tracksMeta": _tracks_meta(tracks),
        "recordingMeta": _recording_meta(replay),
    }
    for kind, table in files.items():
        # polars cannot write to every name that a folder can have.
        (folder / f"{replay.episode:02}_{kind}.csv").write_bytes(table.write_csv().encode())


def drivers(replay: Replay) -> pl.DataFrame:
    """Returns which agent drives which vehicle, which highD's format cannot say."""
    seen = np.nonzero(replay.present.any(axis=0))[0].tolist()
    return pl.DataFrame(
        {
            "recording": [replay.episode] * len(seen),
            "id": [vehicle + 1 for vehicle in seen],
            "agent": [replay.agents[vehicle] for vehicle in seen],
            "ego": [vehicle == replay.ego for vehicle in seen],
        }
    )


def _markings(replay: Replay) -> tuple[Floats, Floats]:
    """Returns y of the markings of the upper and of the lower carriageway, m."""
    upper = replay.settings.profile.lane_width_m * np.arange(replay.settings.lanes + 1.0)
    return upper, upper[-1] + MEDIAN_M + upper


def _tracks(replay: Replay) -> pl.DataFrame:
    """Returns one row per vehicle and frame, sorted by both; frames are counted from 1."""
    settings, x, length, width = replay.settings, replay.x, replay.length, replay.width
    upper, lower = _markings(replay)
    frames, vehicles = x.shape
    y = replay.y + lower[0] + settings.profile.lane_width_m / 2
    velocity = replay.speed * np.cos(replay.heading), replay.speed * np.sin(replay.heading)
    was_there = np.concatenate([replay.present[:1], replay.present[:-1]])
    along, across = (
        np.diff(each, axis=0, prepend=each[:1]) * settings.simulation_hz * was_there
        for each in velocity
    )
    # A centre on a marking belongs to the lane to its left, as in `world.highd`.
    lane = np.searchsorted(np.concatenate([upper, lower]), y, side="left") + 1
    lane = np.where(replay.present, lane, _NO_LANE)
    some = max(1, PAIRS_AT_ONCE // vehicles**2)
    parts = [
        _neighbours(x[first : first + some], lane[first : first + some], length[0])
        for first in range(0, frames, some)
    ]
    neighbours = {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}
    preceding = neighbours["precedingId"]
    exists = preceding != NO_NEIGHBOUR
    leader = np.maximum(preceding - 1, 0)
    leader_speed = np.take_along_axis(velocity[0], leader, axis=1)
    leader_x, leader_length = (np.take_along_axis(each, leader, axis=1) for each in (x, length))
    gap = np.where(exists, gap_to(leader_x - x, length, leader_length), 0.0).clip(min=0.0)
    columns = {
        "frame": np.broadcast_to(np.arange(1, frames + 1)[:, None], x.shape),
        "id": np.broadcast_to(np.arange(1, vehicles + 1), x.shape),
        "x": x - length / 2,
        "y": y - width / 2,
        "width": length,
        "height": width,
        "xVelocity": velocity[0],
        "yVelocity": velocity[1],
        "xAcceleration": along,
        "yAcceleration": across,
        "frontSightDistance": x[replay.present].max() - x,
        "backSightDistance": x - x[replay.present].min(),
        "dhw": gap,
        "thw": _ratio(gap, velocity[0]),
        "ttc": _ratio(gap, velocity[0] - leader_speed),
        "precedingXVelocity": np.where(exists, leader_speed, 0.0),
        **neighbours,
        "laneId": lane,
    }
    is_there = pl.Series(replay.present.T.ravel())
    rows = pl.DataFrame({name: values.T.ravel() for name, values in columns.items()})
    return rows.filter(is_there)


def _ratio(gap: Floats, speed: Floats) -> Floats:
    """Returns gap / speed, and 0 where there is no gap or no speed."""
    ratio = np.zeros_like(gap)
    np.divide(gap, speed, out=ratio, where=(gap > 0) & (speed != 0))
    return ratio


def _neighbours(x: Floats, lane: Ints, length: Floats) -> dict[str, Ints]:
    """Returns highD's eight columns of ids, [T, N] each, of vehicles of these lengths (N,)."""
    ahead = x[:, None, :] - x[:, :, None]  # [T, N, N]: of each vehicle, the distance to the others
    towards = lane[:, None, :] - lane[:, :, None]
    is_other = ~np.eye(x.shape[1], dtype=bool)
    order = np.arange(x.shape[1])
    in_lane = (towards == 0) & is_other
    is_first = (ahead > 0) | ((ahead == 0) & (order > order[:, None]))
    found = {
        "precedingId": _nearest(ahead, in_lane & is_first),
        "followingId": _nearest(-ahead, in_lane & ~is_first),
    }
    alongside = np.abs(ahead) < (length + length[:, None]) / 2
    for side, lanes in BESIDE.items():
        there = towards == lanes
        found[f"{side}PrecedingId"] = _nearest(ahead, there & ~alongside & (ahead > 0))
        found[f"{side}AlongsideId"] = _nearest(np.abs(ahead), there & alongside)
        found[f"{side}FollowingId"] = _nearest(-ahead, there & ~alongside & (ahead < 0))
    return found


def _nearest(distance: Floats, among: Bools) -> Ints:
    """Returns the ids of the nearest vehicles; `NO_NEIGHBOUR` if there is none."""
    candidates = np.where(among, distance, np.inf)
    return np.where(among.any(axis=2), candidates.argmin(axis=2) + 1, NO_NEIGHBOUR)


def _tracks_meta(tracks: pl.DataFrame) -> pl.DataFrame:
    """Returns one row per vehicle."""

    def smallest(name: str) -> pl.Expr:
        values = pl.col(name).filter((pl.col("precedingId") != NO_NEIGHBOUR) & (pl.col(name) > 0))
        return values.min().fill_null(-1.0).alias(f"min{name.upper()}")

    frame, speed = pl.col("frame"), pl.col("xVelocity")
    return tracks.group_by("id", maintain_order=True).agg(
        pl.first("width", "height"),
        frame.first().alias("initialFrame"),
        frame.last().alias("finalFrame"),
        pl.len().alias("numFrames"),
        pl.when(pl.first("width") < TRUCK_LENGTH_M)
        .then(pl.lit("Car"))
        .otherwise(pl.lit("Truck"))
        .alias("class"),
        pl.lit(LOWER).alias("drivingDirection"),
        (pl.col("x").last() - pl.col("x").first()).alias("traveledDistance"),
        speed.min().alias("minXVelocity"),
        speed.max().alias("maxXVelocity"),
        speed.mean().alias("meanXVelocity"),
        smallest("dhw"),
        smallest("thw"),
        smallest("ttc"),
        (pl.col("laneId").diff() != 0).sum().alias("numLaneChanges"),
    )


def _recording_meta(replay: Replay) -> pl.DataFrame:
    """Returns the only row of the recording."""
    seen = np.asarray(replay.present.any(axis=0))
    duration = float(replay.t_s[-1])
    vehicles = int(seen.sum())
    cars = int((seen & (replay.length[0] < TRUCK_LENGTH_M)).sum())
    first, last = replay.present.argmax(axis=0), replay.present[::-1].argmax(axis=0)
    last = len(replay.present) - 1 - last
    everyone, frames = np.arange(seen.size), max(1, len(replay.present) - 1)
    driven = replay.x[last, everyone] - replay.x[first, everyone]
    # No two recordings start at the same time, which would mean that they show the same traffic.
    start = datetime(1970, 1, 1) + timedelta(minutes=replay.episode)
    upper, lower = (";".join(f"{y:z.2f}" for y in each) for each in _markings(replay))
    row = {
        "id": replay.episode,
        "frameRate": replay.settings.simulation_hz,
        "locationId": 1,
        "speedLimit": replay.settings.profile.speed_limit_mps,
        "month": f"{start.month}.{start.year}",
        "weekDay": WEEK_DAYS[start.weekday()],
        "startTime": f"{start:%H:%M}",
        "duration": duration,
        "totalDrivenDistance": float(driven[seen].sum()),
        "totalDrivenTime": duration * float((last - first)[seen].sum() / frames),
        "numVehicles": vehicles,
        "numCars": cars,
        "numTrucks": vehicles - cars,
        "upperLaneMarkings": upper,
        "lowerLaneMarkings": lower,
    }
    return pl.DataFrame([row])
