"""IDM+MOBIL, highway-env's `IDMVehicle`, compiled."""

from typing import ClassVar

import numpy as np

from charms_baselines.idm import desired_gap, idm_acceleration
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
    p = scene.constants.idm_mobil
    for m in range(rows.size):
        b, i = rows[m], places[m]
        acceleration[m] = 0.0
        if scene.crashed[b, i]:
            continue
        exponent = p.exponent_low + scene.temperament[b, i] * (p.exponent_high - p.exponent_low)
        lane = scene.lane[b, i]
        if lane != target_lane[b, i]:
            if _someone_takes_the_gap(b, i, scene, target_lane, p):
                target_lane[b, i] = lane
        elif scene.timer_s[b, i] > p.lane_change_period:
            scene.timer_s[b, i] = 0.0
            for side in (lane - 1, lane + 1):
                if _changes_to(b, i, side, exponent, scene, p):
                    target_lane[b, i] = side
        following = idm_acceleration(b, i, scene.leaders[b, i, lane], exponent, scene, p)
        if lane != target_lane[b, i]:
            leader = scene.leaders[b, i, target_lane[b, i]]
            following = min(following, idm_acceleration(b, i, leader, exponent, scene, p))
        limit = p.acceleration_limit
        acceleration[m] = min(max(following, -limit), limit)


@compiled
def _someone_takes_the_gap(
    b: int, i: int, scene: Scene, target_lane: Ints, p: IdmMobilParameters
) -> bool:
    """Whether another changes into the same lane close ahead [`change_lane_policy`'s abort]."""
    speed = scene.speed[b, i]
    fastest_closing = abs(speed) + np.abs(scene.speed[b]).max()
    braking = 2 * np.sqrt(p.acceleration * p.deceleration)
    furthest = p.jam_distance + abs(speed) * (p.time_headway + fastest_closing / braking)
    for k in range(scene.rank[b, i] + 1, scene.order.shape[1]):
        j = scene.order[b, k]
        distance = scene.x[b, j] - scene.x[b, i]
        if distance > furthest:
            return False
        if (
            distance > 0
            and target_lane[b, j] == target_lane[b, i]
            and scene.lane[b, j] != target_lane[b, i]
            and distance < desired_gap(b, i, j, scene, p)
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
    follower_after = idm_acceleration(b, follower, i, exponent, scene, p)
    if follower_after < -p.imposed_braking:
        return False
    old_leader = scene.leaders[b, i, scene.lane[b, i]]
    own_after = idm_acceleration(b, i, leader, exponent, scene, p)
    own_before = idm_acceleration(b, i, old_leader, exponent, scene, p)
    gain = own_after - own_before
    if p.politeness > 0:
        old_follower = scene.followers[b, i, scene.lane[b, i]]
        gain += p.politeness * (
            follower_after
            - idm_acceleration(b, follower, leader, exponent, scene, p)
            + idm_acceleration(b, old_follower, old_leader, exponent, scene, p)
            - idm_acceleration(b, old_follower, i, exponent, scene, p)
        )
    return bool(gain >= p.lane_change_gain)
