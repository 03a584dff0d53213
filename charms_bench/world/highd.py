"""Reads recordings in highD's published format into the simulation's frame of reference.

A recording consists of three files, `NN_tracks.csv`, `NN_tracksMeta.csv` and `NN_recordingMeta.csv`
[Krajewski et al. 2018]. The files use image coordinates: y grows downwards, a position is the upper
left corner of a box, a vehicle's length is called `width`, and direction 1 drives towards smaller
x. A `Recording` uses the drivers' frame of reference; see `TRACKS`.

Columns that follow from the positions may be missing: velocities, accelerations and lanes, and the
frames, directions and numbers of vehicles.
"""

from pathlib import Path

import numpy as np
import polars as pl

from charms_bench.errors import DataError
from charms_bench.foundation.arrays import Floats
from charms_bench.world.csv_table import Columns, Numbers, read_table, reject
from charms_bench.world.trajectories import LOWER, TRACKS, UPPER, Recording, Trio, lateral, slope

_COUNT = Numbers(0, 1e9, whole=True)
_TRACKS: Columns = {
    "frame": _COUNT,
    "id": _COUNT,
    "x": Numbers(-1e5, 1e5, "m"),
    "y": Numbers(-1e3, 1e3, "m"),
    "width": Numbers(0.1, 50, "m"),
    "height": Numbers(0.1, 10, "m"),
    "xVelocity": Numbers(-100, 100, "m/s"),
    "yVelocity": Numbers(-50, 50, "m/s"),
    "xAcceleration": Numbers(-100, 100, "m/s2"),
    "laneId": Numbers(-1e9, 1e9, whole=True),
}
_TRACKS_META: Columns = {
    "id": _COUNT,
    "initialFrame": _COUNT,
    "finalFrame": _COUNT,
    "numFrames": Numbers(1, 1e9, whole=True),
    "class": None,
    "drivingDirection": Numbers(UPPER, LOWER, whole=True),
}
_SUMMARY = {"numFrames": "rows", "initialFrame": "first", "finalFrame": "last"}
"""The columns that must say what the tracks tell of each vehicle, and what messages call that."""
_FOUND = "_found"
"""The end of the name of a column that has what the tracks tell."""
_DERIVED = ("xVelocity", "yVelocity", "xAcceleration", "laneId")
"""The columns of tracks that follow from the positions."""
_META_LIMIT_BYTES = 2**24
"""A hundred times the size of the file of a long recording."""
_MARKINGS = {UPPER: "upperLaneMarkings", LOWER: "lowerLaneMarkings"}
_RECORDING_META: Columns = {
    "frameRate": Numbers(0.1, 1000, "Hz"),
    "numVehicles": Numbers(0, 1e12, whole=True),
    **dict.fromkeys(_MARKINGS.values()),
}
_OCCASION = ("locationId", "month", "weekDay", "startTime")
_LANE_WIDTHS_M = (1.0, 10.0)
KINDS = ("tracks", "tracksMeta", "recordingMeta")


def read_highd(trio: Trio) -> Recording:
    """A recording of three files; raises a `DataError` if they cannot be read or contradict."""
    frame_rate, vehicles, markings, stated = _read_recording_meta(trio.recording_meta)
    meta = _read_tracks_meta(trio, vehicles)
    tracks = read_table(trio.tracks, _TRACKS, optional=_DERIVED).with_row_index("line", offset=2)
    tracks = _derived(tracks.sort("id", "frame", maintain_order=True), frame_rate)
    meta = _completed(meta, tracks)
    lanes = {d: markings[d].size - 1 for d in meta["drivingDirection"].unique().sort()}
    for direction, count in lanes.items():
        if count < 1:
            raise DataError(
                f"{trio.recording_meta}: line 2: column '{_MARKINGS[direction]}': "
                f"{markings[direction].size} markings, but vehicles drive in direction "
                f"{direction}; expected two or more"
            )
    # laneId 1 lies above the first marking; each marking of either direction begins another lane.
    last = markings[UPPER].size + markings[LOWER].size + 1
    expected = f"{trio.recording_meta.name} has {last - 1}, so expected 1 to {last}"
    outside = f"column 'laneId': {{}} is outside the markings; {expected}"
    if "laneId" in tracks.columns:
        reject(trio.tracks, tracks, ~pl.col("laneId").is_between(1, last), "laneId", outside)
    tracks = _joined(trio, tracks, meta)
    if tracks.is_empty():
        raise DataError(f"{trio.tracks}: has no rows; expected a row for each vehicle and frame")
    parts = [_normalised(trio, tracks, direction, markings) for direction in lanes]
    every = pl.concat(part for part, _ in parts).sort("vehicle", "frame")
    wrong = sum(count for _, count in parts)
    widths = {d: np.diff(_to_the_right(markings[d], d)) for d in lanes}
    occasion = ", ".join(f"{name} {value}" for name, value in stated.items())
    location = stated.get("locationId", "")
    return Recording(trio, frame_rate, lanes, widths, every, wrong, occasion, location)


def _derived(tracks: pl.DataFrame, rate_hz: float) -> pl.DataFrame:
    """The tracks, with velocities and accelerations that follow from positions if they lack any."""
    for name, source in (("xVelocity", "x"), ("yVelocity", "y"), ("xAcceleration", "xVelocity")):
        if name not in tracks.columns:
            values = slope(tracks["id"], tracks["frame"], tracks[source].to_numpy(), rate_hz)
            tracks = tracks.with_columns(pl.Series(name, values))
    return tracks


def _completed(meta: pl.DataFrame, tracks: pl.DataFrame) -> pl.DataFrame:
    """What the tracks say of each vehicle, in columns of their own where `meta` says it, too."""
    frame = pl.col("frame")
    found = tracks.group_by("id").agg(
        initialFrame=frame.min(),
        finalFrame=frame.max(),
        numFrames=pl.len().cast(pl.Int64),
        drivingDirection=pl.when(pl.mean("xVelocity") < 0).then(UPPER).otherwise(LOWER),
    )
    meta = meta.join(found, on="id", how="left", maintain_order="left", suffix=_FOUND)
    return meta.drop_nulls([*_SUMMARY, "drivingDirection"])


def _read_recording_meta(path: Path) -> tuple[float, int | None, dict[int, Floats], dict[str, str]]:
    """Frame rate, number of vehicles, markings of each direction by image y, and `_OCCASION`."""
    table = read_table(path, _RECORDING_META, _META_LIMIT_BYTES, ("numVehicles", *_OCCASION))
    if table.height != 1:
        raise DataError(f"{path}: {table.height} rows; expected one")
    row = table.row(0, named=True)
    if row.get("numVehicles") == 0:
        raise DataError(f"{path}: line 2: column 'numVehicles': no vehicles; remove this recording")
    markings = {d: _markings(path, column, row[column] or "") for d, column in _MARKINGS.items()}
    stated = {name: row[name] for name in _OCCASION if row.get(name)}
    return row["frameRate"], row.get("numVehicles"), markings, stated


def _markings(path: Path, column: str, text: str) -> Floats:
    where = f"{path}: line 2: column '{column}'"
    try:
        values = np.array([float(part) for part in text.split(";") if part.strip()])
    except ValueError as error:
        raise DataError(f"{where}: {error}; expected numbers separated by ;") from error
    low, high = _LANE_WIDTHS_M
    widths = np.diff(values)
    if not (np.isfinite(values).all() and ((widths >= low) & (widths <= high)).all()):
        raise DataError(
            f"{where}: '{text[:80]}'; expected growing numbers, with {low:g} to {high:g} m "
            "between markings"
        )
    return values


def _read_tracks_meta(trio: Trio, vehicles: int | None) -> pl.DataFrame:
    path = trio.tracks_meta
    derived = ("drivingDirection", *_SUMMARY)
    meta = read_table(path, _TRACKS_META, _META_LIMIT_BYTES, derived)
    meta = meta.with_row_index("line", offset=2)
    if vehicles is not None and meta.height != vehicles:
        raise DataError(
            f"{path}: {meta.height:,} vehicles, but {trio.recording_meta.name} announces "
            f"{vehicles:,}; is the file cut short?"
        )
    reject(path, meta, ~pl.col("id").is_first_distinct(), "id", "vehicle {} appears twice")
    unknown = ~pl.col("class").is_in(["Car", "Truck"]).fill_null(False)
    reject(path, meta, unknown, "class", "column 'class': expected Car or Truck, found {!r}")
    return meta.drop("line")


def _joined(trio: Trio, tracks: pl.DataFrame, meta: pl.DataFrame) -> pl.DataFrame:
    """The tracks with classes and directions; every vehicle is complete and has no frame twice."""
    columns = meta.select("id", "class", "drivingDirection")
    tracks = tracks.join(columns, on="id", how="left", maintain_order="left")
    unknown = f"vehicle {{}} is not in {trio.tracks_meta.name}"
    reject(trio.tracks, tracks, pl.col("drivingDirection").is_null(), "id", unknown)
    again = (pl.col("id").diff() == 0) & (pl.col("frame").diff() == 0)
    twice = "vehicle {} already has a row for this frame; delete one of the two rows"
    reject(trio.tracks, tracks, again, "id", twice)
    for row in meta.iter_rows(named=True):
        for column, what in _SUMMARY.items():
            found = row.get(f"{column}{_FOUND}", row[column]) or 0
            if row[column] != found:
                raise DataError(
                    f"{trio.tracks}: vehicle {row['id']}: {what} {found}, but "
                    f"{trio.tracks_meta.name} says {column} {row[column]}; is the file cut short?"
                )
    return tracks


def _normalised(
    trio: Trio, tracks: pl.DataFrame, direction: int, markings: dict[int, Floats]
) -> tuple[pl.DataFrame, int]:
    """The tracks of one direction in the drivers' frame, and how many `laneId`s disagree with y."""
    part = tracks.filter(pl.col("drivingDirection") == direction)
    sign = _sign(direction)
    own = _to_the_right(markings[direction], direction)
    lanes = own.size - 1
    centre = sign * (part["y"] + part["height"] / 2).to_numpy()
    y, lane, on_road = lateral(centre, own)
    lane_id = lanes + 1 - lane if direction == UPPER else markings[UPPER].size + 2 + lane
    speed = sign * part["xVelocity"]
    mean = speed.mean()
    if isinstance(mean, float) and mean < 0:
        raise DataError(
            f"{trio.tracks}: vehicles of drivingDirection {direction} have a mean xVelocity of "
            f"{sign * mean:.1f} m/s; expected it {'below' if direction == UPPER else 'above'} 0"
        )
    columns = {
        "vehicle": part["id"],
        "frame": part["frame"],
        "direction": part["drivingDirection"],
        "car": part["class"] == "Car",
        "x": sign * (part["x"] + part["width"] / 2),
        "y": y,
        "lane": lane,
        "on_road": on_road,
        "speed": speed,
        "lateral_speed": sign * part["yVelocity"],
        "acceleration": sign * part["xAcceleration"],
        "length": part["width"],
        "width": part["height"],
    }
    said = part["laneId"].to_numpy() if "laneId" in part.columns else lane_id
    wrong = on_road & (said != lane_id)
    return pl.DataFrame(columns, schema_overrides=TRACKS), int(wrong.sum())


def _sign(direction: int) -> float:
    return -1.0 if direction == UPPER else 1.0


def _to_the_right(markings: Floats, direction: int) -> Floats:
    """The markings of a direction in its drivers' frame, from left to right."""
    return np.sort(_sign(direction) * markings)
