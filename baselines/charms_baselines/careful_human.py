"""The competent and careful human driver of UN Regulation 157 (2021), Annex 4, Appendix 3.

A collision that this driver avoids in the same scenario is preventable. The driver perceives a risk
in one of these cases:

- cut-in: a vehicle ahead is more than 0.375 m from the centre of its lane towards the driver's
  lane, or in that lane, and the time to collision is below 2 s;
- deceleration: the leader brakes by more than 5 m/s2;
- cut-out: the leader moves more than 0.375 m from the lane's centre, and thereby shows a slower
  vehicle ahead of it.

Evaluating the risk takes 0.4 s and the foot 0.75 s. Then the deceleration rises to 0.774 g within
0.6 s, and stays there until the driver no longer closes in. The driver never changes lanes and,
after a risk, never accelerates, so the model is for single scenarios.
"""

import numpy as np

from charms_bench.plugins.agent import DriverModel
from charms_bench.world.compiled import clip, compiled, index
from charms_bench.world.scene import Floats, Ints, Scene, Vehicles

WANDERING_M = 0.375
CRITICAL_TTC_S = 2.0
LEADER_BRAKING_MPS2 = 5.0
DELAY_S = 0.4 + 0.75
BRAKING_MPS2 = 0.774 * 9.81
RISE_S = 0.6
PERCEIVED_S = 100_000.0
"""`timer_s` when a risk is perceived; longer than any episode, because other timers start near 0."""


class CarefulHuman(DriverModel):
    """Keeps its speed and lane, and brakes for a risk as the regulation's driver does."""

    def drive(self, scene: Scene, vehicles: Vehicles) -> tuple[Floats, Ints]:
        return _drive(scene, vehicles[0], vehicles[1])


@compiled
def _drive(scene: Scene, rows: Ints, places: Ints) -> tuple[Floats, Ints]:
    c, timer_s, speed = scene.constants, scene.timer_s, scene.speed
    acceleration, target_lane = np.zeros(rows.size), np.empty(rows.size, dtype=np.int64)
    for m in range(rows.size):
        b, i = index(rows[m]), index(places[m])
        target_lane[m] = scene.target_lane[b, i]
        perceives, closes_in = _risk(scene, rows[m], places[m])
        if timer_s[b, i] < PERCEIVED_S:
            timer_s[b, i] = PERCEIVED_S if perceives else 0.0
        if timer_s[b, i] < PERCEIVED_S:
            wanted = (scene.target_speed[b, i] - speed[b, i]) / c.tau_acceleration
            acceleration[m] = clip(wanted, -BRAKING_MPS2, BRAKING_MPS2)
        elif closes_in:
            # The mean over the step.
            braked_s = timer_s[b, i] - PERCEIVED_S + c.dt / 2 - DELAY_S
            braking = BRAKING_MPS2 * clip(braked_s / RISE_S, 0.0, 1.0)
            acceleration[m] = -min(braking, max(0.0, speed[b, i] / c.dt))
    return acceleration, target_lane


@compiled
def _risk(scene: Scene, b: int, i: int) -> tuple[bool, bool]:
    """Whether vehicle i of scene b has a risk to perceive, and whether it closes in on a vehicle.

    Vehicles behind one that keeps to the middle of the lane are hidden.
    """
    c, x, y, speed = scene.constants, scene.x, scene.y, scene.speed
    centre = scene.target_lane[b, i] * c.lane_width
    own = speed[b, i] * scene.direction_x[b, i]
    perceives = closes_in = shows = False
    for k in range(scene.rank[b, i] + 1, x.shape[1]):
        j = scene.order[b, k]
        aside = abs(y[b, j] - centre)
        if aside >= c.lane_width - WANDERING_M or x[b, j] <= x[b, i]:
            continue
        is_in_lane = aside <= WANDERING_M
        closing = own - speed[b, j] * scene.direction_x[b, j]
        gap = x[b, j] - x[b, i] - c.length
        if closing > 0:
            closes_in = True
            perceives |= gap < CRITICAL_TTC_S * closing or (shows and is_in_lane)
        perceives |= is_in_lane and scene.acceleration[b, j] < -LEADER_BRAKING_MPS2
        shows |= not is_in_lane
        if is_in_lane:
            break
    return perceives, closes_in
