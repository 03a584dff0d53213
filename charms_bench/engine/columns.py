"""The columns of recorded rows, declared once.

The recorder, the files of a run folder and the page on run folders follow this declaration. Later
versions add columns; they never rename a column or change its type or meaning.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import polars as pl


@dataclass(frozen=True)
class Column:
    """A column of recorded rows."""

    dtype: pl.DataType
    unit: str
    """Empty for a number without a unit, an index or a word."""
    meaning: str


_SEED = Column(pl.UInt64(), "", "Seed of the episode.")

STEP: Mapping[str, Column] = {
    "episode": _SEED,
    "step": Column(pl.Int32(), "", "Number of ego decisions made so far; the first row has 1."),
    "x": Column(pl.Float32(), "m", "Position of the ego's centre along the road."),
    "y": Column(pl.Float32(), "m", "Position across the road, to the right of lane 0's centre."),
    "heading": Column(pl.Float32(), "rad", "Heading of the ego, positive to the right."),
    "speed": Column(pl.Float32(), "m/s", "Speed of the ego."),
    "acceleration": Column(
        pl.Float32(), "m/s²", "Acceleration commanded in the last simulation step."
    ),
    "steering": Column(pl.Float32(), "rad", "Steering angle commanded in that step."),
    "lane": Column(pl.Int8(), "", "Lane nearest to the ego; 0 is the leftmost."),
    "target_lane": Column(pl.Int8(), "", "Lane that the ego steers to."),
    "action": Column(
        pl.Int8(), "", "Index of the last meta-action in `ACTIONS`; null under a driver model."
    ),
    "leader": Column(
        pl.Int16(), "", "Leader on the ego's lane, by its place in the order of spawning."
    ),
    "leader_distance": Column(pl.Float32(), "m", "Distance to that leader, centre to centre."),
    "leader_speed": Column(pl.Float32(), "m/s", "Speed of that leader."),
    "follower": Column(pl.Int16(), "", "Follower on the ego's lane, likewise."),
    "follower_distance": Column(pl.Float32(), "m", "Distance to that follower, centre to centre."),
    "follower_speed": Column(pl.Float32(), "m/s", "Speed of that follower."),
    "follower_acceleration": Column(
        pl.Float32(),
        "m/s²",
        "Acceleration commanded by that follower; null if the follower has crashed.",
    ),
    "vehicles_near": Column(
        pl.Int16(), "", "Vehicles within 30 m and one lane of the ego, the ego included."
    ),
}
"""One row per decision of the ego, with the state after it."""

EPISODE: Mapping[str, Column] = {
    "episode": _SEED,
    "ending": Column(
        pl.String(), "", "How the episode ended: `time`, `rear_end`, `side` or `off_road`."
    ),
    "struck": Column(
        pl.Boolean(),
        "",
        "In a rear-end collision, whether the ego was struck by its follower, and not its leader "
        "by the ego; null for every other ending.",
    ),
    "steps": Column(pl.Int32(), "", "Decisions of the ego."),
    "duration_s": Column(pl.Float64(), "s", "Simulated time."),
    "distance_m": Column(pl.Float64(), "m", "Distance driven by the ego along the road."),
    "traffic_vehicles": Column(pl.Int32(), "", "Vehicles in the traffic."),
    "traffic_crashed": Column(
        pl.Int32(), "", "Vehicles of the traffic that collided or left the road."
    ),
    "traffic_distance_m": Column(
        pl.Float64(), "m", "Distance driven by all vehicles of the traffic together."
    ),
}
"""One row per episode."""

COUNT: Mapping[str, Column] = {
    "episode": _SEED,
    "quantity": Column(
        pl.String(),
        "",
        "`speed` of a vehicle that follows a leader, or `dhw`, the distance headway at the start "
        "of a lane change.",
    ),
    "bin": Column(
        pl.Int16(),
        "0.5 m/s or 0.5 m",
        "Lower edge of the bin; the last bin, 99, has no upper edge.",
    ),
    "count": Column(pl.Int32(), "", "Vehicles counted in that bin, at all decisions together."),
}
"""One row per episode, quantity and bin with a count above 0."""


def _schema(columns: Mapping[str, Column]) -> pl.Schema:
    return pl.Schema({name: column.dtype for name, column in columns.items()})


STEP_SCHEMA, EPISODE_SCHEMA, COUNT_SCHEMA = map(_schema, (STEP, EPISODE, COUNT))
SCHEMAS = {"steps": STEP_SCHEMA, "counts": COUNT_SCHEMA, "episodes": EPISODE_SCHEMA}
"""The kinds of rows that a shard has."""

STEP_RECORD = np.dtype(
    [(name, pl.Series(dtype=dtype).to_numpy().dtype) for name, dtype in STEP_SCHEMA.items()],
    align=True,
)
"""A step row in memory."""


def table(columns: Mapping[str, Any], schema: pl.Schema) -> pl.DataFrame:
    """Returns recorded columns as rows of a schema.

    Raises:
        ValueError: The names are not those of the declaration, in its order.
    """
    if [*columns] != schema.names():
        raise ValueError(f"recorded columns {[*columns]}; declared columns {schema.names()}")
    return pl.DataFrame(columns).cast(schema)
