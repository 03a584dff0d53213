"""Drivers: which vehicles of overlapping recordings are the same driver.

The recordings of US-101 overlap in time, so one driver can be a vehicle of several recordings. The
same moment then has the same measured values in each of them, to the printed digits, apart from x,
whose origin is each recording's own. Two moving vehicles of US-101 at the same moment never have
the same values.
"""

from collections.abc import Sequence

import numpy as np
import polars as pl
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from charms_bench.world.trajectories import Recording

MEASURED = ("length", "width", "y", "speed", "lateral_speed", "acceleration")
MOVING_MPS = 1.0
"""Slower vehicles are not compared: the values of a stationary vehicle do not identify it."""


def moments(recording: Recording, rows: pl.DataFrame) -> pl.Series:
    """(M,) a hash of the values that were measured of each row of `tracks`; null if not moving.

    Only recordings that state the same occasion can give the same hash; see `Recording.occasion`.
    """
    occasion = pl.lit(recording.occasion).alias("occasion")
    hashed = pl.struct(occasion, "direction", *MEASURED).hash()
    moving = pl.when(pl.col("speed") > MOVING_MPS).then(hashed)
    return rows.select(moment=moving)["moment"]


def drivers(vehicles: Sequence[pl.DataFrame]) -> pl.DataFrame:
    """Columns recording, vehicle and driver, one row per vehicle; drivers are numbered from 0.

    Args:
        vehicles: For each recording, columns recording, vehicle and moment, a row or more per
            vehicle. Two vehicles that share a moment are the same driver.
    """
    rows = pl.concat(vehicles)
    found = rows.select("recording", "vehicle").unique().sort("recording", "vehicle")
    found = found.with_row_index("number")
    shared = (
        rows.drop_nulls("moment")
        .filter(pl.col("moment").is_duplicated())
        .join(found, on=["recording", "vehicle"])
        .sort("moment", "number")
    )
    number, moment = shared["number"].to_numpy(), shared["moment"].to_numpy()
    same = np.flatnonzero(moment[1:] == moment[:-1])
    edges = (np.ones(same.size), (number[same], number[same + 1]))
    graph = coo_array(edges, shape=(found.height, found.height))
    _, driver = connected_components(graph, directed=False)
    return found.select("recording", "vehicle", driver=pl.Series(driver, dtype=pl.Int64))
