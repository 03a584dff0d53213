"""Which vehicle is at fault for a crash on a straight road; `roads.fault` says it on other roads.

- Leaving the road: the vehicle that leaves it.
- Side collision: the vehicle that began last to move out of its lane, or both if they began in the
  same decision interval. A rear-end collision counts as a side collision if the vehicle behind is
  not faster than the one ahead: they came together across the road.
- Rear-end collision: the striking vehicle. But if the struck vehicle entered the lane right ahead
  of it within the last 2 s, and that required a DRAC above 3.35 m/s2 (Archer 2005) of the striking
  vehicle, it is the struck vehicle. Braking does not shift the fault to the struck vehicle.

Only the first collision of a vehicle counts, so being hit as a wreck changes nothing.

A vehicle moves out of its lane while its centre is more than 0.25 m beside the centre of its
nearest lane and moves away from it faster than 0.1 m/s. It enters a lane when its side crosses the
marking. Entries are noted in the simulation step of the crossing, and movements at decisions and in
the simulation step of a collision. 0.25 m and 0.1 m/s are this project's choice; they ignore the
swaying of vehicles that keep their lane.
"""

from typing import Any

import numpy as np

from charms_bench.engine.collision_kinds import NO_COLLISION, SIDE_COLLISION, STRIKING, vehicle_hit
from charms_bench.engine.simulation import Simulation
from charms_bench.foundation.compiled import compiled, compiled_of_scenes, index, inlined
from charms_bench.recording.primitives import Frames, record
from charms_bench.world.candidate_lanes import LEFT, RIGHT
from charms_bench.world.gaps import gap_to, requires_braking
from charms_bench.world.road import (
    Straight,
    distance_along,
    local_coordinates,
    side_lanes,
    width_at,
)
from charms_bench.world.scene import Bools, Ints, Scene
from charms_bench.world.thresholds import (
    DRAC_LIMIT_MPS2,
    DRIFT_MPS,
    ENTERED_S,
    LANE_KEEPING_M,
)

NEVER = -1_000_000
_STATE = record(i4="moved_out moving_out entered left entrant", b1="on_both is_judged at_fault")
"""What is remembered of a vehicle.

moved_out: The decision at which it last began to move out of its lane; moving_out: the decision at
    which it last did so.
on_both: Whether it is on two lanes at once, of which `left` is the left one.
entrant, entered: The vehicle that last entered the lane ahead of it and required hard braking, and
    in which simulation step.
is_judged: Whether it has collided; at_fault: whether it was at fault then.
"""
_NOTHING = np.zeros((), dtype=_STATE)
_NOTHING["moved_out"] = _NOTHING["moving_out"] = _NOTHING["entered"] = NEVER


class Fault:
    """Judges the collisions of a simulation's vehicles that are not yet wrecks."""

    def __init__(self, simulation: Simulation) -> None:
        self._simulation = simulation
        self._window = round(ENTERED_S * simulation.settings.simulation_hz)
        self._state = np.full(simulation.scene.x.shape, _NOTHING)
        self._state["is_judged"] = simulation.scene.crashed

    @property
    def at_fault(self) -> Bools:
        """[B, N] whether the vehicle has collided and was at fault."""
        return np.asarray(self._state["at_fault"])

    def forget(self, left: Bools) -> None:
        """Forgets the vehicles that have left [B, N]."""
        self._state[left] = _NOTHING
        b, i = np.nonzero(self._state["entered"] > NEVER)
        is_gone = left[b, self._state["entrant"][b, i]]
        self._state["entered"][b[is_gone], i[is_gone]] = NEVER

    def note_entries(self) -> None:
        """Notes which vehicles enter a lane in the simulation step that has just ended."""
        note_entries(self._simulation.scene, self._steps(), self._state)

    def add(self, frames: Frames, judges: bool) -> None:
        """Notes how vehicles move in some frames, and judges those that have just collided."""
        since = self._steps() - self._window
        note_faults(self._simulation.scene.road, *frames, judges, since, self._state)

    def _steps(self) -> Ints:
        """[B] the simulation steps so far."""
        made = self._simulation
        return made.steps * made.settings.steps_per_decision + made.phase


@compiled
def note_faults(
    road: Straight, moments: Any, vehicles: Any, judges: bool, since: Ints, state: Any
) -> None:
    """Notes how vehicles move, and judges those that have just collided."""
    for moment in moments:
        b, now = index(moment.scene), vehicles[moment.now]
        note_movements(road, now, moment.decision, state[b])
        if judges:
            judge(now, since[b], state[b])


@inlined
def note_movements(road: Straight, now: Any, decision: int, state: Any) -> None:
    """Notes which vehicles begin to move out of their lanes."""
    for i in range(now.size):
        own = now[i]
        _, beside = local_coordinates(road, own.lane, own.x, own.y)
        mine, aside = state[i], own.speed * own.direction_y
        away = aside if beside > 0 else -aside
        if abs(beside) > LANE_KEEPING_M and away > DRIFT_MPS:
            if mine.moving_out < decision - 1:
                mine.moved_out = decision
            mine.moving_out = decision


@compiled_of_scenes
def note_entries(scene: Scene, steps: Ints, state: Any) -> None:
    """Notes which vehicles [B, N] enter a lane in the steps (B,) of their scenes."""
    road, x, y, lane, speed = scene.road, scene.x, scene.y, scene.lane, scene.speed
    for b in range(steps.size):
        for i in range(x.shape[1]):
            along, beside = local_coordinates(road, lane[b, i], x[b, i], y[b, i])
            mine = state[b, i]
            if abs(beside) <= (width_at(road, lane[b, i], along) - scene.width[b, i]) / 2:
                mine.on_both = False
                continue
            on_left, on_right = side_lanes(road, lane[b, i])
            left, entered = (lane[b, i], on_right) if beside > 0 else (on_left, on_left)
            j = scene.followers[b, i, RIGHT if beside > 0 else LEFT]
            has_entered = not mine.on_both or mine.left != left
            mine.left, mine.on_both = left, True
            if has_entered and j >= 0 and lane[b, j] == entered:
                closing = speed[b, j] - speed[b, i]
                ahead = distance_along(road, entered, x[b, j], y[b, j], x[b, i], y[b, i])
                gap = max(gap_to(ahead, scene.length[b, j], scene.length[b, i]), 0.0)
                if requires_braking(gap, closing, DRAC_LIMIT_MPS2):
                    state[b, j].entrant, state[b, j].entered = i, steps[b]


@compiled
def judge(now: Any, since: int, state: Any) -> None:
    """Judges the vehicles that have just collided; entries count from the step `since` on."""
    for i in range(now.size):
        how, mine = now[i].collision, state[i]
        if how == NO_COLLISION or mine.is_judged:
            continue
        mine.is_judged = True
        j, _ = vehicle_hit(now.x, now.y, now.length, now.width, i)
        its, faster = state[j], now[i].speed - now[j].speed
        is_behind = how == STRIKING
        if how == SIDE_COLLISION or (faster if is_behind else -faster) <= 0:
            mine.at_fault = mine.moved_out >= its.moved_out
        elif is_behind:
            mine.at_fault = mine.entrant != j or mine.entered < since
        else:
            mine.at_fault = its.entrant == i and its.entered >= since
