"""IDM+MOBIL, highway-env's `IDMVehicle`, compiled."""

from typing import ClassVar

import numpy as np

from charms_baselines.idm import Motion, distance, following, interaction, motion, on_own_lane
from charms_bench import DriverModel
from charms_bench.foundation.compiled import clip, compiled, compiled_of_scenes, index, inlined
from charms_bench.world.candidate_lanes import LEFT, OWN, RIGHT, TARGET
from charms_bench.world.idm_mobil import closing_speed, desired_gap, mobil
from charms_bench.world.profile import IdmMobilParameters
from charms_bench.world.road import Straight, is_reachable, side_lanes
from charms_bench.world.scene import Floats, Ints, Scene, Vehicles

BLOCK_VEHICLES = 1024
"""Vehicles whose intermediate results stay in the processor's cache."""


class IdmMobil(DriverModel):
    """IDM along the lane, MOBIL across; constants from the profile's `idm_mobil`.

    A driver's IDM exponent is `exponent_low + temperament * (exponent_high - exponent_low)`
    [`IDMVehicle.randomize_behavior`].
    """

    highway_env_class: ClassVar[str] = "highway_env.vehicle.behavior:IDMVehicle"

    def drive(self, scene: Scene, vehicles: Vehicles) -> tuple[Floats, Ints]:
        return _drive(scene, vehicles[0], vehicles[1])


@compiled_of_scenes
def _drive(scene: Scene, rows: Ints, places: Ints) -> tuple[Floats, Ints]:
    """[`IDMVehicle.act`] A vehicle sees the target lanes of the vehicles that acted before it."""
    targets, p = scene.target_lane.copy(), scene.constants.idm_mobil
    acceleration, target_lane = np.empty(rows.size), np.empty(rows.size, dtype=np.int64)
    for first in range(0, rows.size, BLOCK_VEHICLES):
        block = slice(first, min(first + BLOCK_VEHICLES, rows.size))
        answers = acceleration[block], target_lane[block]
        drive_block(scene, rows[block], places[block], targets, answers, p)
    return acceleration, target_lane


@inlined
def drive_block(
    scene: Scene,
    rows: Ints,
    places: Ints,
    targets: Ints,
    answers: tuple[Floats, Ints],
    p: IdmMobilParameters,
) -> None:
    """Writes the answers, accelerations (M,) and target lanes (M,), of M drivers with the same p.

    `targets` [B, N] are the target lanes of all vehicles, in which each answer is noted.
    """
    acceleration, target_lane = answers
    vehicles = scene.x.shape[1]
    x, y, crashed, lanes = scene.x, scene.y, scene.crashed.ravel(), scene.lane.ravel()
    leaders, followers = scene.leaders, scene.followers
    timer_s, temperament = scene.timer_s.ravel(), scene.temperament.ravel()
    all_targets = targets.ravel()
    exponents = np.empty(rows.size)
    for m in range(rows.size):
        fraction = temperament[index(rows[m] * vehicles + places[m])]
        exponents[m] = p.exponent_low + fraction * (p.exponent_high - p.exponent_low)
    free, wanted = on_own_lane(scene, rows, places, exponents, p)
    scene_of_fastest, fastest, uneven = -1, 0.0, 0.0
    for m in range(rows.size):
        at = index(rows[m] * vehicles + places[m])
        lane, target = lanes[at], all_targets[at]
        is_due = timer_s[at] > p.lane_change_period_s
        if (lane != target or is_due) and not crashed[at]:
            b, i = rows[m], places[m]
            own, towards = motion(b, i, scene), TARGET
            if lane != target:
                if b != scene_of_fastest:
                    scene_of_fastest, fastest = b, np.abs(scene.speed[b]).max()
                    if scene.constants.mixed_sizes:
                        uneven = np.abs(scene.length[b] - scene.constants.length).max()
                if _someone_takes_the_gap(b, i, own, target, fastest, uneven, scene, targets, p):
                    target = lane
            else:
                timer_s[at] = 0.0
                left, right = side_lanes(scene.road, lane)
                for side, candidate in ((left, LEFT), (right, RIGHT)):
                    if is_reachable(scene.road, side, x[b, i], y[b, i]) and _changes(
                        scene.road,
                        own,
                        free[m],
                        motion(b, leaders[b, i, OWN], scene),
                        motion(b, followers[b, i, OWN], scene),
                        motion(b, leaders[b, i, candidate], scene),
                        motion(b, followers[b, i, candidate], scene),
                        exponents[m],
                        p,
                    ):
                        target, towards = side, candidate
            if lane != target:
                leader = motion(b, leaders[b, i, towards], scene)
                wanted[m] = min(wanted[m], free[m] - interaction(scene.road, own, leader, p))
            all_targets[at] = target
        target_lane[m] = target
        limit = p.acceleration_limit_mps2
        acceleration[m] = 0.0 if crashed[at] else clip(wanted[m], -limit, limit)


@inlined
def _someone_takes_the_gap(
    b: int,
    i: int,
    own: Motion,
    target: int,
    fastest: float,
    uneven: float,
    scene: Scene,
    targets: Ints,
    p: IdmMobilParameters,
) -> bool:
    """Whether another vehicle changes to the same lane close ahead [`change_lane_policy`].

    They bound how far away that can matter: `fastest` is the highest speed in the scene, and no
    length differs from the profile's by more than `uneven`.
    """
    x, lane, order = scene.x, scene.lane, scene.order
    furthest = desired_gap(abs(own.speed), abs(own.speed) + fastest, p)
    first = scene.rank[b, i] + 1
    while first > 0 and x[b, order[b, first - 1]] > own.x - uneven:
        first -= 1
    for k in range(first, order.shape[1]):
        j = order[b, k]
        if x[b, j] - own.x > furthest + uneven:
            return False
        if j != i and targets[b, j] == target and lane[b, j] != target:
            other = motion(b, j, scene)
            if (
                0
                < distance(scene.road, own, other)
                < desired_gap(own.speed, closing_speed(own, other), p)
            ):
                return True
    return False


@compiled
def _changes(
    road: Straight,
    own: Motion,
    free: float,
    leader: Motion,
    follower: Motion,
    new_leader: Motion,
    new_follower: Motion,
    exponent: float,
    p: IdmMobilParameters,
) -> bool:
    """Whether MOBIL changes lanes."""
    if abs(own.speed) < 1:
        return False
    gain = (free - interaction(road, own, new_leader, p)) - (
        free - interaction(road, own, leader, p)
    )
    driver, behind, ahead = (road, exponent, p), (follower, new_follower), (leader, new_leader)
    return mobil(following, driver, gain, own, behind, ahead, p)
