"""The columns of recorded rows, declared once.

The recorder, the files of a run folder and the page on run folders follow this declaration. Later
versions add columns; they never rename a column or change its type or meaning.
"""

from collections.abc import Iterable, Mapping
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
    "steering": Column(
        pl.Float32(), "rad", "Steering angle commanded in the last simulation step."
    ),
    "length": Column(pl.Float64(), "m", "Length of the ego."),
    "lane": Column(pl.Int8(), "", "Lane nearest to the ego; 0 is the leftmost."),
    "target_lane": Column(
        pl.Int8(), "", "Lane that the ego steers to; with continuous actions, `lane`."
    ),
    "action": Column(
        pl.Int8(),
        "",
        "Index of the last meta-action in `ACTIONS`; null under a driver model and with continuous "
        "actions.",
    ),
    "leader": Column(
        pl.Int16(), "", "Leader on the ego's lane, by its place in the order of spawning."
    ),
    "leader_distance": Column(pl.Float32(), "m", "Distance to that leader, centre to centre."),
    "leader_length": Column(pl.Float64(), "m", "Length of that leader."),
    "leader_speed": Column(pl.Float32(), "m/s", "Speed of that leader."),
    "follower": Column(
        pl.Int16(), "", "Follower on the ego's lane, by its place in the order of spawning."
    ),
    "follower_distance": Column(pl.Float32(), "m", "Distance to that follower, centre to centre."),
    "follower_length": Column(pl.Float64(), "m", "Length of that follower."),
    "follower_speed": Column(pl.Float32(), "m/s", "Speed of that follower."),
    "follower_acceleration": Column(
        pl.Float32(),
        "m/s²",
        "Acceleration commanded by that follower; null if the follower has crashed.",
    ),
    "new_follower_acceleration": Column(
        pl.Float32(),
        "m/s²",
        "In the first row on another lane: the lowest acceleration commanded by `follower`, the "
        "new follower, at the decisions within 2 s, until it or the ego crashes; otherwise null.",
    ),
    "vehicles_near": Column(
        pl.Int16(), "", "Vehicles within 30 m and one lane of the ego, the ego included."
    ),
    "planar_ttc": Column(
        pl.Float32(),
        "s",
        "Least time until the rectangles of the ego and of another vehicle touch, if all keep "
        "their velocities and headings; null above 10 s.",
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
        "In a rear-end collision, whether the follower struck the ego; false if the ego struck its "
        "leader, and null for every other ending.",
    ),
    "at_fault": Column(
        pl.Boolean(),
        "",
        "Whether the ego is at fault for its crash (`engine.fault`); null if it did not crash.",
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

DRIVER: Mapping[str, Column] = {
    "episode": _SEED,
    "agent": Column(
        pl.String(),
        "",
        "Agent that drives the vehicles; for a network given by path, its copy in `networks`.",
    ),
    "is_ego": Column(
        pl.Boolean(), "", "Whether this is the ego's row; otherwise the row is one of the traffic."
    ),
    "vehicles": Column(pl.Int32(), "", "Vehicles that the agent drives."),
    "crashed": Column(pl.Int32(), "", "Vehicles that collided or left the road."),
    "at_fault": Column(pl.Int32(), "", "Vehicles that crashed and were at fault (`engine.fault`)."),
    "rear_end_striking": Column(
        pl.Int32(), "", "Vehicles that crashed into the rear of another vehicle."
    ),
    "rear_end_struck": Column(pl.Int32(), "", "Vehicles that were hit from behind."),
    "side": Column(pl.Int32(), "", "Vehicles that crashed in a side collision."),
    "distance_m": Column(pl.Float64(), "m", "Distance driven before the vehicles crashed."),
    "time_s": Column(pl.Float64(), "s", "Time driven before the vehicles crashed."),
    "harsh_s": Column(pl.Float64(), "s", "Time with more than 2.5 m/s², accelerating or braking."),
    "lane_changes": Column(pl.Int32(), "", "Changes of the nearest lane."),
    "abandoned": Column(
        pl.Int32(), "", "Lane changes given up before the new lane was the nearest lane."
    ),
    "gaps_lost": Column(
        pl.Int32(), "", "Lane changes given up because another vehicle took the gap."
    ),
    "gaps_taken": Column(
        pl.Int32(), "", "Gaps taken from a vehicle that then gave up its lane change."
    ),
    "hard_braking_by": Column(
        pl.Int32(), "", "Lane changes that made the new follower brake by more than 2 m/s²."
    ),
    "hard_braking_to": Column(
        pl.Int32(),
        "",
        "Times that a vehicle braked by more than 2 m/s² after another's lane change.",
    ),
    "conflicts_by": Column(pl.Int32(), "", "Conflicts (TTC below 1.5 s) that the vehicles caused."),
    "conflicts_to": Column(pl.Int32(), "", "Conflicts that another vehicle caused."),
    "near_misses_by": Column(
        pl.Int32(),
        "",
        "Near misses (TTC below 1.5 s or DRAC above 3.35 m/s², and no collision) that the vehicles "
        "caused.",
    ),
    "near_misses_to": Column(pl.Int32(), "", "Near misses that another vehicle caused."),
    "pet_by": Column(pl.Int32(), "", "Encroachments of at most 5 s in which the vehicles cut in."),
    "pet_by_sum_s": Column(
        pl.Float64(), "s", "Sum of the post-encroachment times (PET) in `pet_by`."
    ),
    "pet_below_2s_by": Column(pl.Int32(), "", "Encroachments in `pet_by` with a PET below 2 s."),
    "pet_to": Column(
        pl.Int32(), "", "Encroachments of at most 5 s in which another vehicle cut in."
    ),
    "pet_to_sum_s": Column(pl.Float64(), "s", "Sum of the post-encroachment times in `pet_to`."),
    "pet_below_2s_to": Column(pl.Int32(), "", "Encroachments in `pet_to` with a PET below 2 s."),
    "rss_by_s": Column(
        pl.Float64(), "s", "Time too close to a vehicle ahead by RSS, along and across the road."
    ),
    "rss_to_s": Column(pl.Float64(), "s", "Time in which a vehicle behind was too close by RSS."),
}
"""One row per episode and agent, and one more for the ego: sums over the agent's vehicles.

A vehicle counts until it collides or leaves the road. Its thresholds were applied during the
simulation, so other thresholds need a new simulation.
"""


def _schema(columns: Mapping[str, Column]) -> pl.Schema:
    return pl.Schema({name: column.dtype for name, column in columns.items()})


STEP_SCHEMA, EPISODE_SCHEMA, COUNT_SCHEMA, DRIVER_SCHEMA = map(
    _schema, (STEP, EPISODE, COUNT, DRIVER)
)
SCHEMAS = {
    "steps": STEP_SCHEMA,
    "counts": COUNT_SCHEMA,
    "drivers": DRIVER_SCHEMA,
    "episodes": EPISODE_SCHEMA,
}
"""The kinds of rows that a shard has."""
LENGTHS = ("length", "leader_length", "follower_length")
"""The columns that step rows of earlier versions lack: all vehicles had the profile's length."""
NO_DRIVERS = DRIVER_SCHEMA.to_frame()
"""No driver rows."""
DRIVER_KEYS = ("episode", "agent", "is_ego")
DRIVER_SUMS = tuple(name for name in DRIVER if name not in DRIVER_KEYS)


def with_lengths(steps: pl.DataFrame, standard_m: float) -> pl.DataFrame:
    """Step rows in which a vehicle without a recorded length has the profile's."""
    own, leader, follower = (pl.col(name).fill_null(standard_m) for name in LENGTHS)
    return steps.with_columns(
        own,
        pl.when(pl.col("leader_distance").is_not_null()).then(leader).alias("leader_length"),
        pl.when(pl.col("follower_distance").is_not_null()).then(follower).alias("follower_length"),
    )


def _record(schema: pl.Schema, names: Iterable[str]) -> np.dtype[np.void]:
    types = [(name, pl.Series(dtype=schema[name]).to_numpy().dtype) for name in names]
    return np.dtype(types, align=True)


STEP_RECORD = _record(STEP_SCHEMA, STEP)
"""A step row in memory."""
DRIVER_RECORD = _record(DRIVER_SCHEMA, DRIVER_SUMS)
"""The sums of a vehicle in memory."""


def table(columns: Mapping[str, Any], schema: pl.Schema) -> pl.DataFrame:
    """Returns recorded columns as rows of a schema.

    Raises:
        ValueError: The names are not those of the declaration, in its order.
    """
    if [*columns] != schema.names():
        raise ValueError(f"recorded columns {[*columns]}; declared columns {schema.names()}")
    return pl.DataFrame(columns).cast(schema)
