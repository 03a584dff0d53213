"""Reads NGSIM's raw tables of vehicle trajectories on motorways (US-101 and I-80).

A table has one row per vehicle and frame, 10 frames per second, in feet and feet per second.
`Local_X` is the position to the right of the road's left edge, and `Local_Y` that of the front
along the road [FHWA, NGSIM vehicle trajectories]. Lanes are numbered from the left.
The tables have no lane markings. They are taken to lie midway between the lanes' median positions.
"""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import polars as pl

from charms_bench.errors import DataError
from charms_bench.foundation.arrays import Floats
from charms_bench.world.csv_table import Columns, Numbers, header_of, read_table, reject
from charms_bench.world.trajectories import LOWER, TRACKS, Recording, Trio, lateral, slope

FOOT_M = 0.3048
RATE_HZ = 10.0
LANE_WIDTH_M = 3.66
"""That of a road of one lane."""
SPACINGS_M = (2.5, 5.5)
"""Between the centres of neighbouring lanes; lanes further apart are those of ramps."""
MOTORWAYS = ("us-101", "i-80")
_TRUCK = 3
_AROUND = 5
"""Frames before and after one from which its lateral speed follows: positions are noisy."""
_COUNT = Numbers(0, 1e9, whole=True)
COLUMNS: Columns = {
    "Vehicle_ID": _COUNT,
    "Frame_ID": _COUNT,
    "Local_X": Numbers(-1e3, 1e3, "ft"),
    "Local_Y": Numbers(-1e4, 1e5, "ft"),
    "v_Length": Numbers(0.5, 200, "ft"),
    "v_Width": Numbers(0.5, 40, "ft"),
    "v_Class": Numbers(1, _TRUCK, whole=True),
    "v_Vel": Numbers(0, 300, "ft/s"),
    "v_Acc": Numbers(-300, 300, "ft/s2"),
    "Lane_ID": Numbers(0, 1000, whole=True),
}
_LOCATION = "Location"


def is_ngsim(path: Path) -> bool:
    """Whether a file has the columns of such a table; raises a `DataError` as `header_of`."""
    header = {name.casefold() for name in header_of(path)}
    return {"vehicle_id", "frame_id", "local_x", "local_y"} <= header


def read_ngsim(trio: Trio) -> Recording:
    """A recording of a table; raises a `DataError` if it cannot be read or is of another road."""
    path = trio.tracks
    names = {name.casefold(): name for name in header_of(path)}
    own = {names.get(name.casefold(), name): cells for name, cells in COLUMNS.items()}
    place = names.get(_LOCATION.casefold(), _LOCATION)
    table = read_table(path, own, optional=(place,))
    table = table.rename({name: each for each in COLUMNS if (name := names[each.casefold()])})
    location = _location(path, table[place].unique().to_list()) if place in table else ""
    table = table.with_row_index("line", offset=2).sort("Vehicle_ID", "Frame_ID")
    again = (pl.col("Vehicle_ID").diff() == 0) & (pl.col("Frame_ID").diff() == 0)
    twice = "vehicle {} already has a row for this frame; keep the rows of one place and time"
    reject(path, table, again, "Vehicle_ID", twice)
    metres = pl.col("Local_X", "Local_Y", "v_Length", "v_Width", "v_Vel", "v_Acc") * FOOT_M
    table = table.with_columns(metres)
    right = table["Local_X"].to_numpy()
    markings = _markings(path, table)
    y, lane, on_road = lateral(right, markings)
    aside = slope(table["Vehicle_ID"], table["Frame_ID"], right, RATE_HZ, _AROUND)
    columns = {
        "vehicle": table["Vehicle_ID"],
        "frame": table["Frame_ID"],
        "direction": np.full(table.height, LOWER),
        "car": table["v_Class"] != _TRUCK,
        "x": table["Local_Y"] - table["v_Length"] / 2,
        "y": y,
        "lane": lane,
        "on_road": on_road,
        "speed": table["v_Vel"],
        "lateral_speed": aside,
        "acceleration": table["v_Acc"],
        "length": table["v_Length"],
        "width": table["v_Width"],
    }
    wrong = int((on_road & (table["Lane_ID"].to_numpy() != lane + 1)).sum())
    tracks = pl.DataFrame(columns, schema_overrides=TRACKS)
    lanes, widths = {LOWER: markings.size - 1}, {LOWER: np.diff(markings)}
    occasion = ", ".join(filter(None, (location, path.stem)))
    return Recording(trio, RATE_HZ, lanes, widths, tracks, wrong, occasion, location)


def _location(path: Path, found: Sequence[str]) -> str:
    if len(found) > 1:
        raise DataError(f"{path}: has the locations {', '.join(sorted(found))}; keep one of them")
    if found[0].casefold() not in MOTORWAYS:
        raise DataError(
            f"{path}: is of {found[0][:40]}, a road with junctions; expected {MOTORWAYS[0]} or "
            f"{MOTORWAYS[1]}"
        )
    return found[0]


def _markings(path: Path, table: pl.DataFrame) -> Floats:
    """The markings from left to right, m: midway between the median positions of the lanes."""
    medians = table.group_by("Lane_ID").agg(pl.median("Local_X")).sort("Lane_ID")
    centres: list[float] = []
    for number, centre in medians.iter_rows():
        if number != len(centres) + 1:
            continue
        if centres and not SPACINGS_M[0] <= centre - centres[-1] <= SPACINGS_M[1]:
            break
        centres.append(centre)
    if not centres:
        raise DataError(f"{path}: has no row with Lane_ID 1, the leftmost lane")
    places = np.array(centres)
    half = (np.diff(places).mean() if places.size > 1 else LANE_WIDTH_M) / 2
    inner = (places[1:] + places[:-1]) / 2
    return np.concatenate([[places[0] - half], inner, [places[-1] + half]])
