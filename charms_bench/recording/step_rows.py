"""The rows of the ego's steps. A value that does not exist, such as a missing leader's, is null."""

from typing import Any

import numpy as np
import polars as pl
from numpy.typing import NDArray

from charms_bench.engine.simulation import Simulation
from charms_bench.foundation.compiled import compiled, index
from charms_bench.recording.columns import STEP_RECORD, STEP_SCHEMA, table
from charms_bench.recording.lane_changes import imposed_decisions
from charms_bench.recording.planar_ttc import planar_ttc
from charms_bench.recording.primitives import Frames, distance_to
from charms_bench.world.road import Straight, side_lanes
from charms_bench.world.scene import Ints

INTERACTION_RANGE_M = 30.0
INDICES = ("action", "leader", "follower")
"""The columns in which -1 stands for none in memory; a number that does not exist is NaN."""

_WHOLE = np.dtype((np.void, STEP_RECORD.itemsize))
"""A row as one piece of memory, which NumPy copies ten times as fast as field by field."""
_NO_ROW = np.array(
    tuple(np.nan if kind.is_float() else 0 for kind in STEP_SCHEMA.values()), dtype=STEP_RECORD
).view(_WHOLE)


class StepRows:
    """The rows of the egos of a simulation."""

    def __init__(self, simulation: Simulation) -> None:
        shape = (simulation.seeds.size, simulation.settings.decisions)
        self._simulation = simulation
        self._rows = np.empty(shape, dtype=STEP_RECORD)
        self._rows.view(_WHOLE)[:] = _NO_ROW
        self._window = imposed_decisions(1 / simulation.settings.decision_hz)

    def add(self, frames: Frames) -> None:
        """Adds the steps that end in some frames."""
        made = self._simulation
        note_steps(made.scene.road, *frames, made.scene.ego, made.seeds, self._window, self._rows)

    def table(self) -> pl.DataFrame:
        """Returns the rows (`columns.STEP`), sorted by episode and step."""
        rows = self._rows.view(_WHOLE)[self._rows["step"] > 0].view(STEP_RECORD)
        columns = {name: rows[name] for name in STEP_SCHEMA}
        indices = [pl.when(pl.col(name) >= 0).then(name) for name in INDICES]
        exists = pl.selectors.float().fill_nan(None), *indices
        return table(columns, STEP_SCHEMA).with_columns(*exists).sort("episode", "step")


@compiled
def note_steps(
    road: Straight,
    moments: Any,
    vehicles: Any,
    egos: Ints,
    seeds: NDArray[np.uint64],
    window: int,
    rows: Any,
) -> None:
    """Fills `rows` [B, T] with the steps that end in some frames.

    The braking of a new follower belongs to the row of the lane change, and is noted in `window`
    decisions.
    """
    for moment in moments:
        b, step = index(moment.scene), moment.decision
        now, ego = vehicles[moment.now], egos[b]
        own, row = now[ego], rows[b, step - 1]
        row.episode = seeds[b]
        row.step = step
        row.x, row.y, row.heading = own.x, own.y, own.heading
        row.speed, row.acceleration, row.steering = own.speed, own.acceleration, own.steering
        row.length, row.lane, row.target_lane = own.length, own.lane, own.target_lane
        row.action, row.leader, row.follower = own.action, own.leader, own.follower
        if own.leader >= 0:
            leader = now[own.leader]
            row.leader_distance = distance_to(road, own, leader)
            row.leader_length, row.leader_speed = leader.length, leader.speed
        if own.follower >= 0:
            follower = now[own.follower]
            row.follower_distance = -distance_to(road, own, follower)
            row.follower_length, row.follower_speed = follower.length, follower.speed
            row.follower_acceleration = np.nan if follower.crashed else follower.acceleration
        for t in range(max(step - window, 1), 0 if own.crashed else step):
            changed, follower = rows[b, t], now[rows[b, t].follower]
            has_changed = changed.lane != rows[b, t - 1].lane
            if has_changed and changed.follower >= 0 and not follower.crashed:
                least = np.fmin(changed.new_follower_acceleration, follower.acceleration)
                changed.new_follower_acceleration = least
        time_s = planar_ttc(now, ego)
        row.planar_ttc = time_s if np.isfinite(time_s) else np.nan
        near, (left, right) = 0, side_lanes(road, own.lane)
        for i in range(now.size):
            other = now[i].lane
            is_beside = (other == left) | (other == own.lane) | (other == right)
            near += is_beside & (abs(distance_to(road, own, now[i])) <= INTERACTION_RANGE_M)
        row.vehicles_near = near
