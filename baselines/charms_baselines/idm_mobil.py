"""IDM+MOBIL, highway-env's `IDMVehicle`, compiled."""

import math
from typing import ClassVar

import numpy as np

from charms_baselines.idm import closing_speed, desired_gap, following, idm_acceleration
from charms_bench.agent import DriverModel
from charms_bench.compiled import compiled
from charms_bench.scene import Floats, IdmMobilParameters, Ints, Scene, Vehicles


class IdmMobil(DriverModel):
    """IDM along the lane, MOBIL across; constants from the profile's `idm_mobil`.

    A driver's IDM exponent is `exponent_low + temperament * (exponent_high - exponent_low)`
    [`IDMVehicle.randomize_behavior`].
    """

    highway_env_class: ClassVar[str] = "highway_env.vehicle.behavior:IDMVehicle"

    def drive(self, scene: Scene, vehicles: Vehicles) -> tuple[Floats, Ints]:
        acceleration = np.empty(vehicles[0].size)
        target_lane = scene.target_lane.copy()
        _drive(scene, vehicles[0], vehicles[1], acceleration, target_lane)
        return acceleration, target_lane[vehicles]


@compiled
def _drive(
    scene: Scene, rows: Ints, places: Ints, acceleration: Floats, target_lane: Ints
) -> None:
    """[`IDMVehicle.act`]; a vehicle sees the target lanes of those that acted before it."""
    p, limit = scene.constants.idm_mobil, scene.constants.speed_limit
    # Taken out of the scene once: doing so for every vehicle costs more than IDM itself.
    x, speed, heading, target_speed = scene.x, scene.speed, scene.heading, scene.target_speed
    lane_of, leaders, crashed = scene.lane, scene.leaders, scene.crashed
    timer_s, temperament = scene.timer_s, scene.temperament
    for m in range(rows.size):
        b, i = rows[m], places[m]
        acceleration[m] = 0.0
        if crashed[b, i]:
            continue
        exponent = p.exponent_low + temperament[b, i] * (p.exponent_high - p.exponent_low)
        lane = lane_of[b, i]
        if lane != target_lane[b, i]:
            if _someone_takes_the_gap(b, i, scene, target_lane, p):
                target_lane[b, i] = lane
        elif timer_s[b, i] > p.lane_change_period:
            timer_s[b, i] = 0.0
            for side in (lane - 1, lane + 1):
                if _changes_to(b, i, side, exponent, scene, p):
                    target_lane[b, i] = side

        v, psi = speed[b, i], heading[b, i]
        gap, closing = math.inf, 0.0
        leader = leaders[b, i, lane]
        if leader >= 0:
            gap = x[b, leader] - x[b, i]
            closing = closing_speed(v, psi, speed[b, leader], heading[b, leader])
        wanted_speed = min(max(target_speed[b, i], 0.0), limit)
        wanted = idm_acceleration(v, wanted_speed, gap, closing, exponent, p)
        if lane != target_lane[b, i]:
            leader = leaders[b, i, target_lane[b, i]]
            wanted = min(wanted, following(b, i, leader, exponent, scene, p))
        acceleration[m] = min(max(wanted, -p.acceleration_limit), p.acceleration_limit)


@compiled
def _someone_takes_the_gap(
    b: int, i: int, scene: Scene, target_lane: Ints, p: IdmMobilParameters
) -> bool:
    """Whether another changes into the same lane close ahead [`change_lane_policy`'s abort]."""
    x, speed, heading, lane, order = scene.x, scene.speed, scene.heading, scene.lane, scene.order
    v, psi, fastest = speed[b, i], heading[b, i], 0.0
    for j in range(order.shape[1]):
        fastest = max(fastest, abs(speed[b, j]))
    furthest = desired_gap(abs(v), abs(v) + fastest, p)
    for k in range(scene.rank[b, i] + 1, order.shape[1]):
        j = order[b, k]
        distance = x[b, j] - x[b, i]
        if distance > furthest:
            return False
        if (
            distance > 0
            and target_lane[b, j] == target_lane[b, i]
            and lane[b, j] != target_lane[b, i]
            and distance < desired_gap(v, closing_speed(v, psi, speed[b, j], heading[b, j]), p)
        ):
            return True
    return False


@compiled
def _changes_to(
    b: int, i: int, lane: int, exponent: float, scene: Scene, p: IdmMobilParameters
) -> bool:
    """MOBIL (Kesting et al. 2007, eqs. 2 and 3) [`IDMVehicle.mobil`, and when it is asked]."""
    c = scene.constants
    if not 0 <= lane < c.lanes or abs(scene.speed[b, i]) < 1:
        return False
    aside = abs(scene.y[b, i] - lane * c.lane_width)
    if aside > 2 * c.lane_width or not 0 <= scene.x[b, i] < c.road_length + c.length:
        return False  # [`AbstractLane.is_reachable_from`]
    leader, follower = scene.leaders[b, i, lane], scene.followers[b, i, lane]
    follower_after = following(b, follower, i, exponent, scene, p)
    if follower_after < -p.imposed_braking:
        return False
    old_leader = scene.leaders[b, i, scene.lane[b, i]]
    own_after = following(b, i, leader, exponent, scene, p)
    own_before = following(b, i, old_leader, exponent, scene, p)
    gain = own_after - own_before
    if p.politeness > 0:
        old_follower = scene.followers[b, i, scene.lane[b, i]]
        gain += p.politeness * (
            follower_after
            - following(b, follower, leader, exponent, scene, p)
            + following(b, old_follower, old_leader, exponent, scene, p)
            - following(b, old_follower, i, exponent, scene, p)
        )
    return bool(gain >= p.lane_change_gain)
