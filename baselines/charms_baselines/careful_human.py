"""The competent and careful human driver of UN Regulation 157 (2021), Annex 4, Appendix 3.

A collision that this driver avoids in the same scenario is preventable. The driver

1. perceives a vehicle ahead that is slower or brakes hard, and is in the driver's lane, or more
   than 0.375 m from the centre of the next lane towards it; a vehicle that keeps within 0.375 m of
   the lane's centre hides what is ahead of it;
2. evaluates the risk for 0.4 s;
3. reacts as soon as the time to collision is below 2 s, the leader brakes by more than 5 m/s2, or a
   vehicle that leaves the lane has shown a slower one;
4. brakes 0.75 s later: the deceleration rises to 0.774 g within 0.6 s and stays there until the
   driver is clear of the vehicles ahead, or until it stands.

The numbers are the regulation's. The TTC of 2 s and the leader's 5 m/s2 are those of two public
implementations, esmini and JRC-FSM. The regulation's parameters do not say when the braking
ends, and the implementations differ:

- `clear`: the driver brakes while it closes in on a vehicle ahead. If it has slipped past a vehicle
  that cuts in, it releases the brake and keeps its speed. JRC-FSM does so once the driver's centre
  is ahead (`utility/models.py`, `CC_check_safety_cut_in`; `utility/movement.py`, `control`), and so
  does esmini's `ControllerALKS_R157SM.cpp` by default, which considers only vehicles ahead
  (`Model::Process`).
- `standstill`: once the driver brakes, it brakes to a standstill, whatever happens. esmini's
  `ControllerECE_ALKS_RefDriver.cpp` does so, and `ControllerALKS_R157SM.cpp` with its option
  `fullStop`.

The driver never changes lanes and, after it has braked, never accelerates, so the model is for
single scenarios.
"""

from typing import Literal, get_args

import numpy as np

from charms_bench import DriverModel
from charms_bench.errors import InputError
from charms_bench.foundation.compiled import clip, compiled, compiled_of_scenes, index
from charms_bench.world.gaps import gap_to, is_within
from charms_bench.world.road import local_coordinates, width_at
from charms_bench.world.scene import Floats, Ints, Scene, Vehicles

WANDERING_M = 0.375
EVALUATION_S = 0.4
CRITICAL_TTC_S = 2.0
LEADER_BRAKING_MPS2 = 5.0
DELAY_S = 0.75
BRAKING_MPS2 = 0.774 * 9.81
RISE_S = 0.6
WATCHING, EVALUATING, BRAKING = 0.0, 1.0, 2.0
"""What the driver remembers: its phase. `timer_s` is the time since the phase began."""

BrakesUntil = Literal["clear", "standstill"]


class CarefulHuman(DriverModel):
    """Keeps its speed and lane, and brakes for a risk as the regulation's driver does.

    Args:
        brakes_until: What ends its braking; see the module.
    """

    memory_width = 1

    def __init__(self, brakes_until: BrakesUntil = "clear") -> None:
        if brakes_until not in get_args(BrakesUntil):
            raise InputError(
                f"brakes_until: found {brakes_until!r}, expected 'clear' or 'standstill'"
            )
        self._stops = brakes_until == "standstill"

    def drive(self, scene: Scene, vehicles: Vehicles) -> tuple[Floats, Ints]:
        return _drive(scene, vehicles[0], vehicles[1], self._stops)


@compiled_of_scenes
def _drive(scene: Scene, rows: Ints, places: Ints, stops: bool) -> tuple[Floats, Ints]:
    c, timer_s, phase, speed = scene.constants, scene.timer_s, scene.memory[:, :, 0], scene.speed
    acceleration, target_lane = np.zeros(rows.size), np.empty(rows.size, dtype=np.int64)
    for m in range(rows.size):
        b, i = index(rows[m]), index(places[m])
        target_lane[m] = scene.target_lane[b, i]
        closing, is_risk, is_critical = _risk(scene, rows[m], places[m])
        if phase[b, i] != BRAKING:
            if not is_risk:
                phase[b, i] = WATCHING
            elif phase[b, i] == WATCHING:
                phase[b, i], timer_s[b, i] = EVALUATING, 0.0
            # Half a step, because sums of steps differ from their product in the last bits.
            elif is_critical and timer_s[b, i] > EVALUATION_S - c.dt / 2:
                phase[b, i], timer_s[b, i] = BRAKING, 0.0
            wanted = (scene.target_speed[b, i] - speed[b, i]) / c.tau_acceleration
            acceleration[m] = clip(wanted, -BRAKING_MPS2, BRAKING_MPS2)
            continue
        excess = speed[b, i] if stops else closing
        if excess > 0:
            # The mean over the step, and half a step more, because the engine moves a vehicle by
            # the speed that it has before the step.
            braked_s = timer_s[b, i] + c.dt - DELAY_S
            braking = BRAKING_MPS2 * clip(braked_s / RISE_S, 0.0, 1.0)
            acceleration[m] = -min(braking, excess / c.dt)
    return acceleration, target_lane


@compiled
def _risk(scene: Scene, b: int, i: int) -> tuple[float, bool, bool]:
    """How fast vehicle i of scene b closes in, whether that is a risk, and whether to react."""
    road, x, y, speed = scene.road, scene.x, scene.y, scene.speed
    target = scene.target_lane[b, i]
    own_along, _ = local_coordinates(road, target, x[b, i], y[b, i])
    fastest = 0.0
    is_risk = is_critical = is_shown = False
    for k in range(scene.rank[b, i] + 1, x.shape[1]):
        j = scene.order[b, k]
        along, beside = local_coordinates(road, target, x[b, j], y[b, j])
        aside = abs(beside)
        if aside >= width_at(road, target, along) - WANDERING_M or along <= own_along:
            continue
        is_in_lane = aside <= WANDERING_M
        closing = speed[b, i] - speed[b, j]
        gap = gap_to(along - own_along, scene.length[b, i], scene.length[b, j])
        brakes_hard = is_in_lane and scene.acceleration[b, j] < -LEADER_BRAKING_MPS2
        fastest = max(fastest, closing)
        is_risk |= closing > 0 or brakes_hard
        is_critical |= brakes_hard or is_within(gap, closing, CRITICAL_TTC_S)
        is_critical |= is_shown and is_in_lane and closing > 0
        is_shown |= not is_in_lane
        if is_in_lane:
            break
    return fastest, is_risk, is_critical
