"""A Stackelberg game for the lane: the changing vehicle leads, the one behind answers.

The leader offers to enter a side lane; the follower there answers with its best response, its own
IDM acceleration. The leader enters where that answer costs the follower little and the lane
promises more room and speed.
"""

import numpy as np

from charms_baselines.idm import following
from charms_bench.agent import DriverModel
from charms_bench.compiled import compiled
from charms_bench.errors import InputError
from charms_bench.scene import Floats, IdmMobilParameters, Ints, Scene, Vehicles


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
            acceleration=accelerating, deceleration=deceleration
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
    for m in range(rows.size):
        b, i = rows[m], places[m]
        lane, target = scene.lane[b, i], scene.target_lane[b, i]
        target_lane[m] = target
        acceleration[m] = 0.0
        if scene.crashed[b, i]:
            continue
        if lane == target:
            best = _utility(b, i, lane, scene) + gain
            for side in (lane - 1, lane + 1):
                if (
                    0 <= side < scene.constants.lanes
                    and _utility(b, i, side, scene) > best
                    and _is_open(b, i, side, exponent, open_distance, follower_loss, scene, p)
                ):
                    best = _utility(b, i, side, scene)
                    target_lane[m] = side
        leader = scene.leaders[b, i, lane]
        wanted = following(b, i, leader, exponent, scene, p)
        if lane != target_lane[m]:
            leader = scene.leaders[b, i, target_lane[m]]
            wanted = min(wanted, following(b, i, leader, exponent, scene, p))
        acceleration[m] = min(max(wanted, -braking), p.acceleration)


@compiled
def _utility(b: int, i: int, lane: int, scene: Scene) -> float:
    """Room and speed ahead on a lane: gap / 200 + leader's speed / 66, and 1 when it is empty."""
    leader = scene.leaders[b, i, lane]
    if leader < 0:
        return 1.0
    return float((scene.x[b, leader] - scene.x[b, i]) / 200 + scene.speed[b, leader] / 66)


@compiled
def _is_open(
    b: int,
    i: int,
    lane: int,
    exponent: float,
    open_distance: float,
    follower_loss: float,
    scene: Scene,
    p: IdmMobilParameters,
) -> bool:
    """Whether the follower on the lane is far off or hardly loses by its best response."""
    follower = scene.followers[b, i, lane]
    if follower < 0 or scene.x[b, i] - scene.x[b, follower] > open_distance:
        return True
    leader = scene.leaders[b, i, lane]
    before = following(b, follower, leader, exponent, scene, p)
    after = following(b, follower, i, exponent, scene, p)
    return bool(before - after <= follower_loss)
