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

    meaning: str
    dtype: pl.DataType = pl.Int32()  # noqa: RUF009  # immutable
    unit: str = ""
    """Empty for a count, another number without a unit, an index or a word."""


I8, I16, F32, F64 = pl.Int8(), pl.Int16(), pl.Float32(), pl.Float64()
BOOL, TEXT = pl.Boolean(), pl.String()
_SEED = Column("Seed of the episode.", pl.UInt64())

STEP: Mapping[str, Column] = {
    "episode": _SEED,
    "step": Column("Number of ego decisions made so far; the first row has 1."),
    "x": Column("Position of the ego's centre along the road.", F32, "m"),
    "y": Column("Position across the road, to the right of lane 0's centre.", F32, "m"),
    "heading": Column("Heading of the ego, positive to the right.", F32, "rad"),
    "speed": Column("Speed of the ego.", F32, "m/s"),
    "acceleration": Column("Acceleration commanded in the last simulation step.", F32, "m/s²"),
    "steering": Column("Steering angle commanded in the last simulation step.", F32, "rad"),
    "length": Column("Length of the ego.", F64, "m"),
    "lane": Column("Lane nearest to the ego; 0 is the leftmost.", I8),
    "target_lane": Column("Lane that the ego steers to; with continuous actions, `lane`.", I8),
    "action": Column(
        "Index of the last meta-action among the ego's, by default `ACTIONS`; null under a driver "
        "model and with continuous actions.",
        I8,
    ),
    "leader": Column("Leader on the ego's lane, by its place in the order of spawning.", I16),
    "leader_distance": Column("Distance to that leader, centre to centre.", F32, "m"),
    "leader_length": Column("Length of that leader.", F64, "m"),
    "leader_speed": Column("Speed of that leader.", F32, "m/s"),
    "follower": Column("Follower on the ego's lane, by its place in the order of spawning.", I16),
    "follower_distance": Column("Distance to that follower, centre to centre.", F32, "m"),
    "follower_length": Column("Length of that follower.", F64, "m"),
    "follower_speed": Column("Speed of that follower.", F32, "m/s"),
    "follower_acceleration": Column(
        "Acceleration commanded by that follower; null if the follower has crashed.", F32, "m/s²"
    ),
    "new_follower_acceleration": Column(
        "In the first row on another lane: the lowest acceleration commanded by `follower`, the "
        "new follower, at the decisions within 2 s, until it or the ego crashes; otherwise null.",
        F32,
        "m/s²",
    ),
    "vehicles_near": Column("Vehicles within 30 m and one lane of the ego, the ego included.", I16),
    "planar_ttc": Column(
        "Least time until the rectangles of the ego and of another vehicle touch, if all keep "
        "their velocities and headings; null above 10 s.",
        F32,
        "s",
    ),
}
"""One row per decision of the ego, with the state after it."""

EPISODE: Mapping[str, Column] = {
    "episode": _SEED,
    "ending": Column(
        "How the episode ended: `time`, `rear_end`, `side`, `off_road` or, on one of highway-env's "
        "roads, `goal`.",
        TEXT,
    ),
    "struck": Column(
        "In a rear-end collision, whether the follower struck the ego; false if the ego struck "
        "its leader, and null for every other ending.",
        BOOL,
    ),
    "at_fault": Column(
        "Whether the ego is at fault for its crash (`recording.fault`); null if it did not crash, "
        "and on highway-env's roads.",
        BOOL,
    ),
    "steps": Column("Decisions of the ego."),
    "duration_s": Column("Simulated time.", F64, "s"),
    "distance_m": Column("Distance driven by the ego along the road.", F64, "m"),
    "traffic_vehicles": Column("Vehicles in the traffic."),
    "traffic_crashed": Column("Vehicles of the traffic that collided or left the road."),
    "traffic_distance_m": Column(
        "Distance driven by all vehicles of the traffic together, each along its own way.",
        F64,
        "m",
    ),
    "traffic_time_s": Column(
        "Time that they were there, together; null where nobody comes or goes: the whole episode.",
        F64,
        "s",
    ),
    "has_goal": Column(
        "Whether the ego should get somewhere; null on the straight road, where it should not.",
        BOOL,
    ),
    "at_fault_on_road": Column(
        "The same on one of highway-env's roads, where vehicles merge, cross and meet "
        "(`roads.fault`); null if it is undecided.",
        BOOL,
    ),
    "entry_lead_gap_m": Column(
        "On one of highway-env's roads: the gap to the leader when a vehicle enters "
        "(`roads.entries`); null without a leader within 100 m.",
        F64,
        "m",
    ),
    "entry_lag_gap_m": Column(
        "The gap to the follower then; null without a follower within 100 m.", F64, "m"
    ),
    "entry_braking_mps2": Column(
        "The strongest braking of that follower within 2 s, until it or the entering vehicle "
        "crashes; 0 if it does not brake.",
        F64,
        "m/s²",
    ),
    "entry_pet_s": Column(
        "The post-encroachment time (PET) between the entering vehicle and that follower; null "
        "above 5 s.",
        F64,
        "s",
    ),
}
"""One row per episode. Only files of highway-env's roads have the columns `has_goal`,
`at_fault_on_road` and `entry_*`, and where nobody comes or goes, none has `traffic_time_s`."""
HAS_GOAL, ON_ROAD = "has_goal", "at_fault_on_road"
OF_ROADS = (HAS_GOAL, ON_ROAD, *(name for name in EPISODE if name.startswith("entry_")))
TIME_OF_TRAFFIC = "traffic_time_s"
OPTIONAL = (TIME_OF_TRAFFIC, *OF_ROADS)
"""The columns that not all files have."""

COUNT: Mapping[str, Column] = {
    "episode": _SEED,
    "quantity": Column(
        "`speed` of a vehicle that follows a leader, or `dhw`, the distance headway at the start "
        "of a lane change.",
        TEXT,
    ),
    "bin": Column(
        "Lower edge of the bin; the last bin, 99, has no upper edge.", I16, "0.5 m/s or 0.5 m"
    ),
    "count": Column("Vehicles counted in that bin, at all decisions together."),
}
"""One row per episode, quantity and bin with a count above 0."""

DRIVER: Mapping[str, Column] = {
    "episode": _SEED,
    "agent": Column(
        "Agent that drives the vehicles; for a network given by path, its copy in `networks`.", TEXT
    ),
    "is_ego": Column(
        "Whether this is the ego's row; otherwise the row is one of the traffic.", BOOL
    ),
    "vehicles": Column("Vehicles that the agent drives."),
    "crashed": Column("Vehicles that collided or left the road."),
    "at_fault": Column(
        "Vehicles that crashed and were at fault (`recording.fault`; on highway-env's roads, "
        "`roads.fault` judges the traffic, and the ego in `at_fault_on_road`)."
    ),
    "rear_end_striking": Column("Vehicles that crashed into the rear of another vehicle."),
    "rear_end_struck": Column("Vehicles that were hit from behind."),
    "side": Column("Vehicles that crashed in a side collision."),
    "distance_m": Column("Distance driven before the vehicles crashed.", F64, "m"),
    "time_s": Column("Time driven before the vehicles crashed.", F64, "s"),
    "harsh_s": Column("Time with more than 2.5 m/s², accelerating or braking.", F64, "s"),
    "lane_changes": Column("Changes of the nearest lane."),
    "abandoned": Column("Lane changes given up before the new lane was the nearest lane."),
    "gaps_lost": Column("Lane changes given up because another vehicle took the gap."),
    "gaps_taken": Column("Gaps taken from a vehicle that then gave up its lane change."),
    "hard_braking_by": Column("Lane changes that made the new follower brake by more than 2 m/s²."),
    "hard_braking_to": Column(
        "Times that a vehicle braked by more than 2 m/s² after another's lane change."
    ),
    "conflicts_by": Column("Conflicts (TTC below 1.5 s) that the vehicles caused."),
    "conflicts_to": Column("Conflicts that another vehicle caused."),
    "near_misses_by": Column(
        "Near misses (TTC below 1.5 s or DRAC above 3.35 m/s², and no collision) that the "
        "vehicles caused."
    ),
    "near_misses_to": Column("Near misses that another vehicle caused."),
    "pet_by": Column("Encroachments of at most 5 s in which the vehicles cut in."),
    "pet_by_sum_s": Column("Sum of the post-encroachment times (PET) in `pet_by`.", F64, "s"),
    "pet_below_2s_by": Column("Encroachments in `pet_by` with a PET below 2 s."),
    "pet_to": Column("Encroachments of at most 5 s in which another vehicle cut in."),
    "pet_to_sum_s": Column("Sum of the post-encroachment times in `pet_to`.", F64, "s"),
    "pet_below_2s_to": Column("Encroachments in `pet_to` with a PET below 2 s."),
    "rss_by_s": Column(
        "Time too close to a vehicle ahead by RSS, along and across the road.", F64, "s"
    ),
    "rss_to_s": Column("Time in which a vehicle behind was too close by RSS.", F64, "s"),
}
"""One row per episode and agent, and one more for the ego: sums over the agent's vehicles.

On one of highway-env's roads, the events of the ego's row are those along its way, and those of
the traffic are each along the way of the vehicle that follows or changes lanes. The driver of the
vehicles that a road's environment has itself is called `environment`.

A vehicle counts until it collides, leaves the road, or passes the end of a lane that no lane
follows, where highway-env's vehicles drive on. Its thresholds were applied during the simulation,
so other thresholds need a new simulation.
"""


STEP_SCHEMA, EPISODE_SCHEMA, COUNT_SCHEMA, DRIVER_SCHEMA = (
    pl.Schema({name: column.dtype for name, column in columns.items()})
    for columns in (STEP, EPISODE, COUNT, DRIVER)
)
SCHEMAS = {
    "steps": STEP_SCHEMA,
    "counts": COUNT_SCHEMA,
    "drivers": DRIVER_SCHEMA,
    "episodes": EPISODE_SCHEMA,
}
"""The kinds of rows that a shard has."""
NO_DRIVERS = DRIVER_SCHEMA.to_frame()
"""No driver rows."""
EGO_INDEX = "ego_index"
"""The number of the ego, from 0, which steps, episodes and drivers have on roads with several."""
DRIVER_KEYS = ("episode", "agent", "is_ego")
DRIVER_SUMS = tuple(name for name in DRIVER if name not in DRIVER_KEYS)


def keys_of(rows: pl.DataFrame) -> list[str]:
    """The columns that tell egos and their episodes apart: mostly `episode` alone."""
    return [name for name in ("episode", EGO_INDEX) if name in rows.columns]


def with_ego_index(rows: pl.DataFrame, ego: int) -> pl.DataFrame:
    """The rows of one of several egos."""
    return rows.select("episode", pl.lit(ego, I8).alias(EGO_INDEX), pl.exclude("episode"))


def of_ego(rows: pl.DataFrame, ego: int) -> pl.DataFrame:
    """The rows of one ego, which are all where there are not several, without its number."""
    if EGO_INDEX not in rows.columns:
        return rows
    return rows.filter(pl.col(EGO_INDEX) == ego).drop(EGO_INDEX)


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
