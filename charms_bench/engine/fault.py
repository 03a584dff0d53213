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

from typing import TYPE_CHECKING, Any

import numpy as np

from charms_bench.engine.collisions import NO_COLLISION, SIDE_COLLISION, STRIKING, vehicle_hit
from charms_bench.foundation.compiled import compiled, compiled_of_scenes, index
from charms_bench.world.gaps import gap_to
from charms_bench.world.scene import Bools, Ints, Scene
from charms_bench.world.thresholds import DRAC_LIMIT_MPS2

if TYPE_CHECKING:
    from charms_bench.engine.simulation import Simulation

ENTERED_S = 2.0
LANE_KEEPING_M = 0.25
DRIFT_MPS = 0.1
NEVER = -1_000_000
_STATE = np.dtype(
    [
        ("moved_out", np.int32),
        ("moving_out", np.int32),
        ("left", np.int32),
        ("on_both", np.int32),
        ("entrant", np.int32),
        ("entered", np.int32),
        ("is_judged", np.bool_),
        ("at_fault", np.bool_),
    ],
    align=True,
)
"""What is remembered of a vehicle. Times are numbers of decisions.

moved_out: When it last began to move out of its lane; moving_out: when it last did so.
on_both: When it was last on two lanes at once, of which `left` is the left one.
entrant, entered: The vehicle that last entered the lane ahead of it and required hard braking, and
    when.
is_judged: Whether it has collided; at_fault: whether it was at fault then.
"""


class Fault:
    """Judges every collision in its simulation step; call `note` after every decision interval."""

    def __init__(self, simulation: "Simulation") -> None:
        self._simulation = simulation
        self._window = round(ENTERED_S * simulation.settings.decision_hz)
        self._state = np.zeros(simulation.scene.x.shape, dtype=_STATE)
        for name in ("moved_out", "moving_out", "on_both", "entered"):
            self._state[name] = NEVER
        self._state["is_judged"] = simulation.scene.crashed
        simulation.collision_watchers.append(self._judge)

    @property
    def at_fault(self) -> Bools:
        """[B, N] whether the vehicle has collided and was at fault."""
        return np.asarray(self._state["at_fault"])

    def note(self, scenes: Ints) -> None:
        """Adds the decision interval of the scenes (S,) that has just ended."""
        _note_movements(self._simulation.scene, scenes, self._simulation.steps, self._state)

    def _judge(self) -> None:
        """Judges the vehicles that have just collided."""
        made = self._simulation
        collided = (made.collision != NO_COLLISION) & ~self._state["is_judged"]
        scenes, now = np.nonzero(collided.any(axis=1))[0], made.steps + 1
        _note_movements(made.scene, scenes, now, self._state)
        _judge(made.scene, scenes, made.collision, now - self._window, self._state)


@compiled_of_scenes
def _note_movements(scene: Scene, scenes: Ints, now: Ints, state: Any) -> None:
    """Notes which vehicles begin to move out of their lanes, and which enter a lane.

    `now` [B] are the decisions made at the end of the present intervals.
    """
    c, x, y, speed, lanes = scene.constants, scene.x, scene.y, scene.speed, scene.lane
    direction_y, followers = scene.direction_y, scene.followers
    length, width = scene.length, scene.width
    for row in scenes:
        b = index(row)
        for place in range(y.shape[1]):
            i = index(place)
            lane = lanes[b, i]
            beside = y[b, i] - lane * c.lane_width
            inside = (c.lane_width - width[b, i]) / 2
            if abs(beside) <= min(LANE_KEEPING_M, inside):
                continue
            own, aside = state[b, i], speed[b, i] * direction_y[b, i]
            away = aside if beside > 0 else -aside
            if abs(beside) > LANE_KEEPING_M and away > DRIFT_MPS:
                if own.moving_out < now[b] - 1:
                    own.moved_out = now[b]
                own.moving_out = now[b]
            if abs(beside) <= inside:
                continue
            left, entered = (lane, lane + 1) if beside > 0 else (lane - 1, lane - 1)
            has_entered = own.on_both < now[b] - 1 or own.left != left
            own.left, own.on_both = left, now[b]
            if not has_entered or not 0 <= entered < c.lanes:
                continue
            j = followers[b, i, index(entered)]
            if j >= 0 and lanes[b, index(j)] == entered:
                closing = speed[b, index(j)] - speed[b, i]
                lengths = length[b, index(j)], length[b, i]
                gap = max(gap_to(x[b, index(j)], x[b, i], *lengths), 0.0)
                if closing > 0 and closing**2 > 2 * DRAC_LIMIT_MPS2 * gap:
                    other = state[b, index(j)]
                    other.entrant, other.entered = place, now[b]


@compiled
def _judge(scene: Scene, scenes: Ints, collision: Ints, since: Ints, state: Any) -> None:
    """Judges the vehicles that have just collided; entries count from the decision `since` on."""
    x, y = scene.x, scene.y
    for row in scenes:
        b = index(row)
        for i in range(collision.shape[1]):
            own = state[b, i]
            if collision[b, i] == NO_COLLISION or own.is_judged:
                continue
            own.is_judged = True
            j, _ = vehicle_hit(x[b], y[b], scene.length[b], scene.width[b], i)
            other, faster = state[b, j], scene.speed[b, i] - scene.speed[b, j]
            is_behind = collision[b, i] == STRIKING
            if collision[b, i] == SIDE_COLLISION or (faster if is_behind else -faster) <= 0:
                own.at_fault = own.moved_out >= other.moved_out
            elif is_behind:
                own.at_fault = own.entrant != j or own.entered < since[b]
            else:
                own.at_fault = other.entrant == i and other.entered >= since[b]
