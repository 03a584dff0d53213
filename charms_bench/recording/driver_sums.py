"""Sums of what each driver does to others and what others do to it, over an episode.

They are taken at every decision interval, of every vehicle until it collides or leaves the road.
`rss`, `conflict_onsets`, `encroachment` and `lane_changes` define the events.
"""

from typing import Any

import numpy as np
import polars as pl

from charms_bench.engine.collision_kinds import SIDE_COLLISION, STRIKING, STRUCK
from charms_bench.engine.simulation import Simulation
from charms_bench.foundation.compiled import compiled, index, inlined
from charms_bench.recording.columns import (
    DRIVER_KEYS,
    DRIVER_RECORD,
    DRIVER_SCHEMA,
    DRIVER_SUMS,
    table,
)
from charms_bench.recording.conflict_onsets import note_conflicts
from charms_bench.recording.encroachment import note_encroachments
from charms_bench.recording.lane_changes import imposed_decisions, note_lane_changes
from charms_bench.recording.primitives import NOBODY, SEEN, Frames, Some, distance_to, record
from charms_bench.recording.rss import note_rss
from charms_bench.world.road import Straight
from charms_bench.world.scene import Bools, Ints, Scene
from charms_bench.world.thresholds import HARSH_MPS2

STATE = record(f8="place", i4="cut_in pressed", i2="cutter near", b1="leader_began in_conflict")
"""Whom a vehicle has met at earlier decisions; -1 stands for no vehicle.

near: The leader with which it has a near miss; `leader_began` and `in_conflict` describe that.
cutter: The vehicle that cut in at the decision `cut_in`; the follower reaches its rear at `place`.
pressed: The decision at which another vehicle was last too close behind it.
"""


_NOBODY_MET = np.zeros((), dtype=STATE)
_NOBODY_MET["near"] = _NOBODY_MET["cutter"] = NOBODY


class DriverSums:
    """The sums of all drivers of a simulation's scenes.

    `scene` has the vehicles that count, if these are not all.
    """

    def __init__(self, simulation: Simulation, scene: Scene | None = None) -> None:
        shape = simulation.scene.x.shape
        self._simulation, self._scene = simulation, scene or simulation.engine.state
        self._interval_s = 1.0 / simulation.settings.decision_hz
        self._sums = np.zeros((shape[0], len(simulation.agents) + 1), dtype=DRIVER_RECORD)
        self._counted = np.full((*shape, self._sums.shape[1]), NOBODY)
        self.find_drivers()
        self._state = np.full(shape, _NOBODY_MET)
        window = imposed_decisions(self._interval_s)
        self._new_followers = np.full((*shape, window), NOBODY, dtype=np.int16)

    def forget(self, left: Bools) -> None:
        """Forgets the vehicles that have left [B, N]."""
        self._state[left], self._new_followers[left] = _NOBODY_MET, NOBODY
        for scene, place in zip(*np.nonzero(left), strict=True):
            state = self._state[scene]
            for met in (state["near"], state["cutter"], self._new_followers[scene]):
                met[met == place] = NOBODY

    def add(self, frames: Frames, at_fault: Bools, changes: bool = False, seen: Any = None) -> None:
        """Adds the decision intervals that end in some frames.

        `at_fault` [B, N] is whether the vehicles that have collided were at fault, and `changes`
        whether vehicles or their drivers can have changed. `seen` are the rows of `SEEN` of the
        moments.
        """
        if changes:
            self.find_drivers()
        seen = np.empty(0, dtype=SEEN) if seen is None else seen
        sums = self._state, self._new_followers, self._sums
        road, interval_s = self._simulation.scene.road, self._interval_s
        note_drivers(road, *frames, seen, at_fault, interval_s, self._drivers, *sums)

    def find_drivers(self) -> None:
        """Notes who drives which vehicle, and counts each vehicle once for each of its drivers."""
        made, scene = self._simulation, self._scene
        # The ego's driver has column 0, and an agent the one after its index.
        self._drivers = made.engine.drivers + 1
        self._drivers[made.ego_vehicles] = 0
        for driver in range(self._sums.shape[1]):
            counted = self._counted[..., driver]
            own = (self._drivers == driver) & scene.present & (scene.entry != counted)
            counted[own] = scene.entry[own]
            self._sums["vehicles"][:, driver] += own.sum(axis=1, dtype=np.int32)

    def table(self) -> pl.DataFrame:
        """Returns the sums by driver (`columns.DRIVER`), sorted by its keys."""
        scene, driver = np.nonzero(self._sums["vehicles"])
        names = np.array((self._simulation.ego_agent, *self._simulation.agents))
        sums = self._sums[scene, driver]
        columns = {
            "episode": self._simulation.seeds[scene],
            "agent": names[driver],
            "is_ego": driver == 0,
            **{name: sums[name] for name in DRIVER_SUMS},
        }
        return table(columns, DRIVER_SCHEMA).sort(DRIVER_KEYS)


@compiled
def note_drivers(
    road: Straight,
    moments: Any,
    vehicles: Any,
    seen: Any,
    at_fault: Bools,
    interval_s: float,
    drivers: Ints,
    state: Any,
    new_followers: Ints,
    sums: Any,
) -> None:
    """Adds the decision intervals that end in some frames to `sums` [B, D]."""
    view, shown = np.empty_like(vehicles[0]), -1
    for moment in moments:
        b, decision, some = index(moment.scene), moment.decision, (moment.first, moment.after)
        itself, before = vehicles[moment.now], vehicles[moment.before]
        now, rows = itself, seen[moment.seen : moment.seen_after]
        if rows.size:
            if shown != moment.now:
                shown = moment.now
                view[:] = itself
            now = view
            show(view, moment.first, rows)
        driver, met, summed = drivers[b], state[b], sums[b]
        note_driving(road, some, now, before, at_fault[b], interval_s, driver, summed)
        note_encroachments(some, now, before, itself, decision, interval_s, driver, met, summed)
        note_lane_changes(road, some, now, before, decision, driver, new_followers[b], summed)
        note_conflicts(road, some, now, decision, interval_s, moment.ends, driver, met, summed)
        note_rss(road, some, now, decision, interval_s, driver, met, summed)
        for row in rows:
            if row.place >= 0:
                view[row.place] = itself[row.place]
        if rows.size:
            view[moment.first] = itself[moment.first]


@compiled
def show(view: Any, i: int, rows: Any) -> None:
    """Shows vehicles [N] as vehicle i sees them."""
    for k in range(rows.size - 1, -1, -1):  # the nearest ones last, because they have directions
        row = rows[k]
        if row.place >= 0:
            other = view[row.place]
            other.x, other.y = row.x, row.y
            other.lane, other.target_lane = row.lane, row.target_lane
            other.direction_x, other.direction_y = row.direction_x, row.direction_y
    own = view[i]
    own.left_leader, own.leader, own.right_leader = rows[0].place, rows[1].place, rows[2].place
    own.follower = rows[3].place


@inlined
def note_driving(
    road: Straight,
    some: Some,
    now: Any,
    before: Any,
    at_fault: Bools,
    interval_s: float,
    driver: Ints,
    sums: Any,
) -> None:
    """Adds distance and time, and the crashes of a decision interval."""
    for i in range(some[0], some[1]):
        own, was, mine = now[i], before[i], sums[driver[i]]
        if was.lost:
            continue
        if own.lost:
            mine.crashed += 1
            mine.at_fault += at_fault[i] or not own.crashed
            mine.rear_end_striking += own.crashed and own.collision == STRIKING
            mine.rear_end_struck += own.crashed and own.collision == STRUCK
            mine.side += own.crashed and own.collision == SIDE_COLLISION
            continue
        mine.distance_m += distance_to(road, was, own)
        mine.time_s += interval_s
        mine.harsh_s += interval_s * (abs(own.acceleration) > HARSH_MPS2)
