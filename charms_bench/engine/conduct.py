"""Sums of what each driver does to others and what others do to it, over an episode.

They are taken at every decision interval, of every vehicle until it collides or leaves the road.
Events need what a vehicle did before, such as when it last changed lanes, so each vehicle has a
small state. `rss`, `conflicts`, `encroachment` and `lane_changes` define the events.
"""

from typing import Any

import numpy as np
import polars as pl

from charms_bench.engine.columns import (
    DRIVER_KEYS,
    DRIVER_RECORD,
    DRIVER_SCHEMA,
    DRIVER_SUMS,
    table,
)
from charms_bench.engine.conflicts import note_conflicts
from charms_bench.engine.encroachment import note_encroachments
from charms_bench.engine.lane_changes import note_lane_changes
from charms_bench.engine.rss import note_rss
from charms_bench.engine.simulation import Simulation, vehicle_hit
from charms_bench.world.compiled import compiled
from charms_bench.world.lanes import is_on_lane
from charms_bench.world.scene import Bools, Ints, Scene

HARSH_MPS2 = 2.5
"""The paper's threshold for a harsh acceleration."""
LONG_AGO = -1_000_000
STATE = np.dtype(
    [
        ("x", np.float64),
        ("lane", np.int64),
        ("target_lane", np.int64),
        ("lost", np.bool_),
        ("changed", np.int64),
        ("began", np.int64),
        ("imposes_until", np.int64),
        ("near", np.int64),
        ("leader_began", np.bool_),
        ("in_conflict", np.bool_),
        ("cutter", np.int64),
        ("place", np.float64),
        ("cut_in", np.int64),
        ("is_pressed", np.bool_),
    ],
    align=True,
)
"""What is remembered of a vehicle. Times are numbers of decisions; -1 stands for no vehicle.

x, lane, target_lane: At the last decision.
lost: Whether the vehicle has collided or left the road.
changed, began: When the nearest lane and the target lane last changed.
imposes_until: Until when the braking of the follower is attributed to the last lane change.
near: The leader with which it has a near miss; `leader_began` and `in_conflict` describe that.
cutter: The vehicle that cut in at the time `cut_in`; the follower reaches its rear at x = `place`.
is_pressed: Whether a vehicle behind is too close by RSS.
"""


class Conduct:
    """The sums of all vehicles of B scenes; call `note` after every decision interval."""

    def __init__(self, simulation: Simulation) -> None:
        scene = simulation.scene
        self._simulation = simulation
        self._interval_s = 1.0 / simulation.settings.decision_hz
        self._sums = np.zeros(scene.x.shape, dtype=DRIVER_RECORD)
        self._sums["vehicles"] = 1
        self._state = np.zeros(scene.x.shape, dtype=STATE)
        for name in ("x", "lane", "target_lane"):
            self._state[name] = getattr(scene, name)
        self._state["changed"] = LONG_AGO
        self._state["near"] = self._state["cutter"] = -1

    @property
    def lost(self) -> Bools:
        """[B, N] whether the vehicle has collided or left the road."""
        return np.asarray(self._state["lost"])

    def note(self, scenes: Ints) -> None:
        """Adds the decision interval of the scenes (S,) that has just ended."""
        scene, steps = self._simulation.scene, self._simulation.steps
        interval, state, sums = self._interval_s, self._state, self._sums
        note_driving(scene, scenes, interval, state, sums)
        note_encroachments(scene, scenes, steps, interval, state, sums)
        note_lane_changes(scene, scenes, steps, interval, state, sums)
        note_conflicts(scene, scenes, steps, interval, state, sums)
        note_rss(scene, scenes, interval, state, sums)
        remember(scene, scenes, state)

    def table(self) -> pl.DataFrame:
        """Returns the sums by driver (`columns.DRIVER`), sorted by episode, ego last."""
        simulation = self._simulation
        is_ego = np.zeros(self._sums.shape, dtype=np.bool_)
        is_ego[simulation.ego_vehicles] = True
        columns = {
            "episode": np.repeat(simulation.seeds, is_ego.shape[1]),
            "agent": simulation.drivers.ravel(),
            "is_ego": is_ego.ravel(),
            **{name: self._sums[name].ravel() for name in DRIVER_SUMS},
        }
        keys = list(DRIVER_KEYS)
        sums = pl.DataFrame(columns).group_by(keys).agg(pl.col(DRIVER_SUMS).sum()).sort(keys)
        return table(sums.to_dict(), DRIVER_SCHEMA)


@compiled
def note_driving(scene: Scene, scenes: Ints, interval_s: float, state: Any, sums: Any) -> None:
    """Adds distance and time, and the crashes of a decision interval."""
    c, x, y, lanes = scene.constants, scene.x, scene.y, scene.lane
    crashed, acceleration = scene.crashed, scene.acceleration
    for b in scenes:
        for i in range(x.shape[1]):
            if state[b, i].lost:
                continue
            if crashed[b, i]:
                j, is_rear_end = vehicle_hit(x[b], y[b], i, c)
                sums[b, i].rear_end_striking += is_rear_end and x[b, i] < x[b, j]
                sums[b, i].rear_end_struck += is_rear_end and x[b, i] >= x[b, j]
                sums[b, i].side += not is_rear_end
            if crashed[b, i] or not is_on_lane(x[b, i], y[b, i], lanes[b, i], c, 0.0):
                state[b, i].lost = True
                sums[b, i].crashed += 1
                continue
            sums[b, i].distance_m += x[b, i] - state[b, i].x
            sums[b, i].time_s += interval_s
            sums[b, i].harsh_s += interval_s if abs(acceleration[b, i]) > HARSH_MPS2 else 0.0


@compiled
def remember(scene: Scene, scenes: Ints, state: Any) -> None:
    """Keeps what the next decision interval is compared with."""
    x, lane, target_lane = scene.x, scene.lane, scene.target_lane
    for b in scenes:
        for i in range(x.shape[1]):
            own = state[b, i]
            own.x, own.lane, own.target_lane = x[b, i], lane[b, i], target_lane[b, i]
