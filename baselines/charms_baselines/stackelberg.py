"""A Stackelberg game for the lane: the vehicle that changes lanes leads, the one behind answers.

The leader offers to enter a side lane. The follower there answers with its best response, its own
IDM acceleration. The leader enters if the answer costs the follower little and the lane offers more
room and speed.
"""

from typing import NamedTuple

import numpy as np

from charms_baselines.idm import Motion, distance, interaction, motion, on_own_lane
from charms_bench import DriverModel
from charms_bench.errors import InputError
from charms_bench.foundation.compiled import clip, compiled
from charms_bench.world.candidate_lanes import LEFT, OWN, RIGHT, TARGET
from charms_bench.world.profile import IdmMobilParameters
from charms_bench.world.road import Straight, side_lanes
from charms_bench.world.scene import Floats, Ints, Scene, Vehicles


class _Options(NamedTuple):
    """The options of `Stackelberg`, all positive."""

    deceleration: float
    exponent: float
    braking: float
    accelerating: float
    open_distance: float
    follower_loss: float
    gain: float


class Stackelberg(DriverModel):
    """IDM along the lane, and a leader-follower game across it at every simulation step.

    Args:
        deceleration_mps2: IDM's comfortable deceleration b.
        exponent: IDM's acceleration exponent.
        acceleration_low_mps2: Lower bound of the commanded acceleration.
        acceleration_high_mps2: Upper bound of the commanded acceleration, and IDM's a.
        open_distance_m: A side lane is open if its follower is further away than this,
        follower_loss_mps2: or if the follower's best response costs at most this acceleration.
        gain: A lane change needs a lane whose utility is higher by this.

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
        limits = (-acceleration_low_mps2, acceleration_high_mps2)
        costs = (open_distance_m, follower_loss_mps2, gain)
        self._options = _Options(*map(float, (deceleration_mps2, exponent, *limits, *costs)))
        if not min(self._options) > 0:
            raise InputError(
                "stackelberg: acceleration_low_mps2 must be negative and every other option "
                f"positive, got {self._options}"
            )

    def drive(self, scene: Scene, vehicles: Vehicles) -> tuple[Floats, Ints]:
        options = self._options
        parameters = scene.constants.idm_mobil._replace(
            acceleration_mps2=options.accelerating, deceleration_mps2=options.deceleration
        )
        return _drive(scene, vehicles[0], vehicles[1], parameters, options)


@compiled
def _drive(
    scene: Scene, rows: Ints, places: Ints, p: IdmMobilParameters, options: _Options
) -> tuple[Floats, Ints]:
    lane_of, target_of, crashed = scene.lane, scene.target_lane, scene.crashed
    leaders, followers = scene.leaders, scene.followers
    acceleration, target_lane = np.zeros(rows.size), np.empty(rows.size, dtype=np.int64)
    exponents = np.full(rows.size, options.exponent)
    free, wanted = on_own_lane(scene, rows, places, exponents, p)
    for m in range(rows.size):
        b, i = rows[m], places[m]
        lane, target = lane_of[b, i], target_of[b, i]
        target_lane[m] = target
        if crashed[b, i]:
            continue
        own, towards = motion(b, i, scene), TARGET
        if lane == target:
            leader = motion(b, leaders[b, i, OWN], scene)
            best = _utility(scene.road, own, leader) + options.gain
            left, right = side_lanes(scene.road, lane)
            for side, candidate in ((left, LEFT), (right, RIGHT)):
                if side < 0:
                    continue
                side_leader = motion(b, leaders[b, i, candidate], scene)
                side_follower = motion(b, followers[b, i, candidate], scene)
                utility = _utility(scene.road, own, side_leader)
                if utility > best and (
                    distance(scene.road, side_follower, own) > options.open_distance
                    or _loss(scene.road, side_follower, side_leader, own, p)
                    <= options.follower_loss
                ):
                    best, target, towards = utility, side, candidate
        if lane != target:
            leader = motion(b, leaders[b, i, towards], scene)
            wanted[m] = min(wanted[m], free[m] - interaction(scene.road, own, leader, p))
        acceleration[m] = clip(wanted[m], -options.braking, options.accelerating)
        target_lane[m] = target
    return acceleration, target_lane


@compiled
def _utility(road: Straight, own: Motion, leader: Motion) -> float:
    """Room and speed ahead on a lane: gap / 200 + leader's speed / 66; 1 if the lane is empty."""
    if not leader.exists:
        return 1.0
    return distance(road, own, leader) / 200 + leader.speed / 66


@compiled
def _loss(
    road: Straight, follower: Motion, leader: Motion, entering: Motion, p: IdmMobilParameters
) -> float:
    """Acceleration that a follower loses by its best response to an entering vehicle, m/s².

    Its acceleration on a free road is part of both accelerations and cancels out.
    """
    before, after = interaction(road, follower, leader, p), interaction(road, follower, entering, p)
    return after - before
