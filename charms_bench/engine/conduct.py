"""Sums of what each driver does to others and what others do to it, over an episode.

They are taken at every decision interval, of every vehicle until it collides or leaves the road.
Events need what a vehicle did before, such as when it last changed lanes, so each vehicle has a
small state. `rss`, `conflicts`, `encroachment` and `lane_changes` define the events.
"""

from typing import Any

import numpy as np
import polars as pl

from charms_bench.engine.collisions import SIDE_COLLISION, STRIKING, STRUCK
from charms_bench.engine.columns import (
    DRIVER_KEYS,
    DRIVER_RECORD,
    DRIVER_SCHEMA,
    DRIVER_SUMS,
    table,
)
from charms_bench.engine.conflict_onsets import note_conflicts
from charms_bench.engine.encroachment import note_encroachments
from charms_bench.engine.fault import Fault
from charms_bench.engine.lane_changes import NOBODY, imposed_decisions, note_lane_changes
from charms_bench.engine.rss import note_rss
from charms_bench.engine.simulation import Simulation
from charms_bench.foundation.compiled import compiled, compiled_of_scenes, index
from charms_bench.world.road import is_on_lane
from charms_bench.world.scene import Bools, Ints, Scene
from charms_bench.world.thresholds import HARSH_MPS2

LONG_AGO = -1_000_000
STATE = np.dtype(
    [
        ("x", np.float64),
        ("place", np.float64),
        ("driver", np.int32),
        ("lane", np.int32),
        ("target_lane", np.int32),
        ("changed", np.int32),
        ("began", np.int32),
        ("imposes_until", np.int32),
        ("near", np.int32),
        ("cutter", np.int32),
        ("cut_in", np.int32),
        ("lost", np.bool_),
        ("leader_began", np.bool_),
        ("in_conflict", np.bool_),
        ("is_pressed", np.bool_),
    ],
    align=True,
)
"""What is remembered of a vehicle. Times are numbers of decisions; -1 stands for no vehicle.

driver: Its column in the sums: 0 for the ego, otherwise 1 more than the agent's index.
x, lane, target_lane: At the last decision.
lost: Whether the vehicle has collided or left the road.
changed, began: When the nearest lane and the target lane last changed.
imposes_until: Until when braking of the new follower is attributed to the last lane change.
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
        self._sums = np.zeros((scene.ego.size, len(simulation.agents) + 1), dtype=DRIVER_RECORD)
        self._state = np.zeros(scene.x.shape, dtype=STATE)
        self._state["driver"] = simulation.engine.drivers + 1
        self._state["driver"][simulation.ego_vehicles] = 0
        for driver in range(self._sums.shape[1]):
            vehicles = (self._state["driver"] == driver).sum(axis=1)
            self._sums["vehicles"][:, driver] = vehicles
        for name in ("x", "lane", "target_lane"):
            self._state[name] = getattr(scene, name)
        self._state["changed"] = LONG_AGO
        self._state["near"] = self._state["cutter"] = -1
        shape = (*scene.x.shape, imposed_decisions(self._interval_s))
        self._new_followers = np.full(shape, NOBODY, dtype=np.int16)
        self._fault = Fault(simulation)

    @property
    def lost(self) -> Bools:
        """[B, N] whether the vehicle has collided or left the road."""
        return np.asarray(self._state["lost"])

    @property
    def at_fault(self) -> Bools:
        """[B, N] whether the vehicle has collided and was at fault."""
        return self._fault.at_fault

    def note(self, scenes: Ints) -> None:
        """Adds the decision interval of the scenes (S,) that has just ended."""
        made = self._simulation
        self._fault.note(scenes)
        note_conduct(
            made.scene,
            scenes,
            made.steps,
            made.collision,
            self.at_fault,
            self._interval_s,
            self._state,
            self._new_followers,
            self._sums,
        )

    def table(self) -> pl.DataFrame:
        """Returns the sums by driver (`columns.DRIVER`), sorted by its keys."""
        scene, driver = np.nonzero(self._sums["vehicles"])
        names = np.array((self._simulation.agents[0], *self._simulation.agents))
        sums = self._sums[scene, driver]
        columns = {
            "episode": self._simulation.seeds[scene],
            "agent": names[driver],
            "is_ego": driver == 0,
            **{name: sums[name] for name in DRIVER_SUMS},
        }
        return table(columns, DRIVER_SCHEMA).sort(DRIVER_KEYS)


@compiled_of_scenes
def note_conduct(
    scene: Scene,
    scenes: Ints,
    steps: Ints,
    collision: Ints,
    at_fault: Bools,
    interval_s: float,
    state: Any,
    new_followers: Ints,
    sums: Any,
) -> None:
    """Adds a decision interval to `sums`; the order matters, because each part uses `state`."""
    note_driving(scene, scenes, collision, at_fault, interval_s, state, sums)
    note_encroachments(scene, scenes, steps, interval_s, state, sums)
    note_lane_changes(scene, scenes, steps, state, new_followers, sums)
    note_conflicts(scene, scenes, steps, interval_s, state, sums)
    note_rss(scene, scenes, interval_s, state, sums)
    remember(scene, scenes, state)


@compiled
def note_driving(
    scene: Scene,
    scenes: Ints,
    collision: Ints,
    at_fault: Bools,
    interval_s: float,
    state: Any,
    sums: Any,
) -> None:
    """Adds distance and time, and the crashes of a decision interval."""
    c, x, y, lanes = scene.constants, scene.x, scene.y, scene.lane
    crashed, acceleration = scene.crashed, scene.acceleration
    for row in scenes:
        b = index(row)
        for i in range(x.shape[1]):
            own = state[b, i]
            if own.lost:
                continue
            mine = sums[b, own.driver]
            if crashed[b, i]:
                mine.rear_end_striking += collision[b, i] == STRIKING
                mine.rear_end_struck += collision[b, i] == STRUCK
                mine.side += collision[b, i] == SIDE_COLLISION
            if crashed[b, i] or not is_on_lane(c, lanes[b, i], x[b, i], y[b, i], 0.0):
                own.lost = True
                mine.crashed += 1
                mine.at_fault += at_fault[b, i] or not crashed[b, i]
                continue
            mine.distance_m += x[b, i] - own.x
            mine.time_s += interval_s
            mine.harsh_s += interval_s * (abs(acceleration[b, i]) > HARSH_MPS2)


@compiled
def remember(scene: Scene, scenes: Ints, state: Any) -> None:
    """Keeps what the next decision interval is compared with."""
    x, lane, target_lane = scene.x, scene.lane, scene.target_lane
    for row in scenes:
        b = index(row)
        for i in range(x.shape[1]):
            own = state[b, i]
            own.x, own.lane, own.target_lane = x[b, i], lane[b, i], target_lane[b, i]
