"""A Stackelberg game for the lane: the changing vehicle leads, the one behind answers.

The leader offers to enter a side lane; the follower there answers with its best response, its own
IDM acceleration. The leader enters where that answer costs the follower little and the lane
promises more room and speed.
"""

import math

import numpy as np

from charms_baselines.idm import Motion, following, motion, motion_ahead, motion_behind
from charms_bench.errors import InputError
from charms_bench.plugins.agent import DriverModel
from charms_bench.world.compiled import clip, compiled
from charms_bench.world.profile import IdmMobilParameters
from charms_bench.world.scene import Floats, Ints, Scene, Vehicles


class Stackelberg(DriverModel):
    """IDM along the lane, a leader-follower game across at every simulation step.

    Args:
        deceleration_mps2: IDM's comfortable deceleration b.
        exponent: IDM's acceleration exponent.
        acceleration_low_mps2: Lower bound of the commanded acceleration.
        acceleration_high_mps2: Its upper bound, and IDM's maximum acceleration a.
        open_distance_m: A side lane is open when its follower is further away than this,
        follower_loss_mps2: or loses at most this much acceleration in its best response.
        gain: A lane change needs its lane's utility to be higher by this.

    Raises:
        InputError: A value is not positive, or not negative for `acceleration_low_mps2`.
    """

    def __init__(
        self,
        deceleration_mps2: float = 4.0,
        exponent: float = 4.0,
        acceleration_low_mps2: float = -4.0,
        acceleration_high_mps2: float = 3.0,
        open_distance_m: float = 50.0,
        follower_loss_mps2: float = 1.0,
        gain: float = 0.1,
    ) -> None:
        self._options = (
            float(deceleration_mps2),
            float(exponent),
            -float(acceleration_low_mps2),
            float(acceleration_high_mps2),
            float(open_distance_m),
            float(follower_loss_mps2),
            float(gain),
        )
        if not min(self._options) > 0:
            raise InputError(f"stackelberg: every option has a sign to keep, got {self._options}")

    def drive(self, scene: Scene, vehicles: Vehicles) -> tuple[Floats, Ints]:
        acceleration = np.empty(vehicles[0].size)
        target_lane = np.empty(vehicles[0].size, dtype=np.int64)
        deceleration, exponent, braking, accelerating, distance, loss, gain = self._options
        parameters = scene.constants.idm_mobil._replace(
            acceleration_mps2=accelerating, deceleration_mps2=deceleration
        )
        _drive(
            scene,
            vehicles[0],
            vehicles[1],
            acceleration,
            target_lane,
            parameters,
            exponent,
            braking,
            distance,
            loss,
            gain,
        )
        return acceleration, target_lane


@compiled
def _drive(
    scene: Scene,
    rows: Ints,
    places: Ints,
    acceleration: Floats,
    target_lane: Ints,
    p: IdmMobilParameters,
    exponent: float,
    braking: float,
    open_distance: float,
    follower_loss: float,
    gain: float,
) -> None:
    lane_of, target_of, crashed = scene.lane, scene.target_lane, scene.crashed
    leaders, followers = scene.leaders, scene.followers
    for m in range(rows.size):
        b, i = rows[m], places[m]
        lane, target = lane_of[b, i], target_of[b, i]
        acceleration[m], target_lane[m] = 0.0, target
        if crashed[b, i]:
            continue
        own = motion(b, i, scene)
        leader = motion_ahead(b, leaders[b, i, lane], scene)
        if lane == target:
            best = _utility(own, leader) + gain
            for side in (lane - 1, lane + 1):
                if not 0 <= side < scene.constants.lanes:
                    continue
                side_leader = motion_ahead(b, leaders[b, i, side], scene)
                side_follower = motion_behind(b, followers[b, i, side], scene)
                utility = _utility(own, side_leader)
                if utility > best and (
                    own.x - side_follower.x > open_distance
                    or _loss(side_follower, side_leader, own, exponent, p) <= follower_loss
                ):
                    best, target = utility, side
        wanted = following(own, leader, exponent, p)
        if lane != target:
            leader = motion_ahead(b, leaders[b, i, target], scene)
            wanted = min(wanted, following(own, leader, exponent, p))
        acceleration[m] = clip(wanted, -braking, p.acceleration_mps2)
        target_lane[m] = target


@compiled
def _utility(own: Motion, leader: Motion) -> float:
    """Room and speed ahead on a lane: gap / 200 + leader's speed / 66, and 1 when it is empty."""
    if leader.x == math.inf:
        return 1.0
    return (leader.x - own.x) / 200 + leader.speed / 66


@compiled
def _loss(
    follower: Motion, leader: Motion, entering: Motion, exponent: float, p: IdmMobilParameters
) -> float:
    """Acceleration that a follower's best response to an entering vehicle costs it, m/s2."""
    return following(follower, leader, exponent, p) - following(follower, entering, exponent, p)
