"""Which vehicle is at fault for a crash. This is the project's only rule for that.

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
marking. Both are noted at decisions and in the simulation step of a collision. 0.25 m and 0.1 m/s
are this project's choice; they ignore the swaying of vehicles that keep their lane.
"""

from typing import Any

import numpy as np

from charms_bench.engine.collision_kinds import NO_COLLISION, SIDE_COLLISION, STRIKING, vehicle_hit
from charms_bench.engine.simulation import Simulation
from charms_bench.foundation.compiled import compiled, index, inlined
from charms_bench.recording.primitives import Frames, distance_to
from charms_bench.world.gaps import gap_to
from charms_bench.world.road import Straight, local_coordinates, side_lanes, width_at
from charms_bench.world.scene import Bools
from charms_bench.world.thresholds import DRAC_LIMIT_MPS2

ENTERED_S = 2.0
LANE_KEEPING_M = 0.25
DRIFT_MPS = 0.1
NEVER = -1_000_000
_TIMES = ("moved_out", "moving_out", "on_both", "entered")
_STATE = np.dtype(
    [
        *((name, np.int32) for name in (*_TIMES, "left", "entrant")),
        *((name, np.bool_) for name in ("is_judged", "at_fault")),
    ]
)
"""What is remembered of a vehicle. Times are numbers of decisions.

moved_out: When it last began to move out of its lane; moving_out: when it last did so.
on_both: When it was last on two lanes at once, of which `left` is the left one.
entrant, entered: The vehicle that last entered the lane ahead of it and required hard braking, and
    when.
is_judged: Whether it has collided; at_fault: whether it was at fault then.
"""
_NOTHING = np.zeros((), dtype=_STATE)
for _name in _TIMES:
    _NOTHING[_name] = NEVER


class Fault:
    """Judges the collisions of a simulation's vehicles that are not yet wrecks."""

    def __init__(self, simulation: Simulation) -> None:
        self._road = simulation.scene.road
        self._window = round(ENTERED_S * simulation.settings.decision_hz)
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

    def add(self, frames: Frames, judges: bool) -> None:
        """Notes how vehicles move in some frames, and judges those that have just collided."""
        note_faults(self._road, *frames, judges, self._window, self._state)


@compiled
def note_faults(
    road: Straight, moments: Any, vehicles: Any, judges: bool, window: int, state: Any
) -> None:
    """Notes how vehicles move, and judges those that have just collided."""
    for moment in moments:
        b, now = index(moment.scene), vehicles[moment.now]
        note_movements(road, now, moment.decision, state[b])
        if judges:
            judge(now, moment.decision - window, state[b])


@inlined
def note_movements(road: Straight, now: Any, decision: int, state: Any) -> None:
    """Notes which vehicles begin to move out of their lanes, and which enter a lane."""
    for i in range(now.size):
        own = now[i]
        along, beside = local_coordinates(road, own.lane, own.x, own.y)
        inside = (width_at(road, own.lane, along) - own.width) / 2
        if abs(beside) <= min(LANE_KEEPING_M, inside):
            continue
        mine, aside = state[i], own.speed * own.direction_y
        away = aside if beside > 0 else -aside
        if abs(beside) > LANE_KEEPING_M and away > DRIFT_MPS:
            if mine.moving_out < decision - 1:
                mine.moved_out = decision
            mine.moving_out = decision
        if abs(beside) <= inside:
            continue
        on_left, on_right = side_lanes(road, own.lane)
        left, entered = (own.lane, on_right) if beside > 0 else (on_left, on_left)
        j = own.right_follower if beside > 0 else own.left_follower
        has_entered = mine.on_both < decision - 1 or mine.left != left
        mine.left, mine.on_both = left, decision
        if has_entered and j >= 0 and now[j].lane == entered:
            other = now[j]
            closing = other.speed - own.speed
            gap = max(gap_to(distance_to(road, other, own), other.length, own.length), 0.0)
            if closing > 0 and closing**2 > 2 * DRAC_LIMIT_MPS2 * gap:
                state[j].entrant, state[j].entered = i, decision


@compiled
def judge(now: Any, since: int, state: Any) -> None:
    """Judges the vehicles that have just collided; entries count from the decision `since` on."""
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
