"""The rewards of the paper, eqs. 4 to 8.

Numbers count the paper's numbered equations from its first. Distances are longitudinal and centre
to centre, speeds are those along the road.
"""

import math
from typing import Annotated, Literal, NamedTuple

import numpy as np
from pydantic import Field

from charms_bench.engine.simulation import RUNNING, TIME, Simulation
from charms_bench.world.actions import Actions
from charms_bench.world.compiled import compiled
from charms_bench.world.fields import FrozenModel
from charms_bench.world.scene import Bools, Floats, Ints, Scene

Svo = Literal["competitive", "egoistic", "prosocial", "altruistic"]
SVO_ANGLES_RAD: dict[Svo, float] = {
    "competitive": -math.pi / 4,
    "egoistic": 0.0,
    "prosocial": math.pi / 4,
    "altruistic": math.pi / 2,
}
"""Social value orientation (SVO) as an angle: what one gives oneself and others."""

SAFE_TTC_S = 3.0
"""The horizon of r_s, eq. 4, by default: a collision further off in time is none."""
SPEED_LOW_MPS, SPEED_HIGH_MPS = 23.0, 33.0
FAILURE = -10.0
"""The reward of the decision in which the ego crashes or leaves the road."""
INCREASE_LIMIT_MPS2 = 3.0
"""What one vehicle can count for in r_o, eq. 7."""

IDM_SPEED_MPS, IDM_ACCELERATION, IDM_DECELERATION = 33.0, 3.0, 5.0
IDM_JAM_DISTANCE_M, IDM_HEADWAY_S, IDM_EXPONENT = 10.0, 1.0, 4.0
MINIMAL_GAP_M = 1.0
"""Below this, far inside a collision, IDM's answer no longer depends on the gap."""


class Weights(FrozenModel):
    """How much safety, efficiency and comfort count: a, b and c of eqs. 6 and 8."""

    safety: Annotated[float, Field(ge=0, le=100)]
    efficiency: Annotated[float, Field(ge=0, le=100)]
    comfort: Annotated[float, Field(ge=0, le=100)]

    @property
    def largest(self) -> float:
        """The largest own reward: each of its parts is 1 at most."""
        return self.safety + self.efficiency + self.comfort


class Prepared(NamedTuple):
    """The scenes before a decision."""

    consistent: Bools
    """[B] whether the action is the previous one."""
    lane: Ints
    """[B] the egos' lanes."""
    target_lane: Ints
    """[B] where they are heading."""
    followers: Ints
    """[B, L] who is behind the ego on each lane, -1 for nobody."""
    expected: Floats
    """[B, L] the followers' expected accelerations, m/s2."""


class StyleReward:
    """R_2, eq. 8: E (a r_s + b r_e + c r_c) + O r_o with E = cos phi and O = sin phi.

    The own reward is divided by its largest value, and r_o mapped from [-6, 6] to [0, 1], so that
    both have one range. An egoist's is R_1, eq. 6. A crash, or leaving the road, is worth
    `FAILURE` instead.

    Args:
        weights: a, b and c.
        angle_rad: phi, such as one of `SVO_ANGLES_RAD`.
        safety_horizon_s: See `safety`.
        safe_headway_m: See `safety`.
        lane_change_cost: What a decision for another target lane costs, as `lane_change_reward` of
            highway-env's reward with the opposite sign.
    """

    def __init__(
        self,
        weights: Weights,
        angle_rad: float,
        safety_horizon_s: float = SAFE_TTC_S,
        safe_headway_m: float = 0.0,
        lane_change_cost: float = 0.0,
    ) -> None:
        self._weights = weights
        self._horizon_s, self._headway_m = safety_horizon_s, safe_headway_m
        self._lane_change_cost = lane_change_cost
        self._own, self._others = math.cos(angle_rad), math.sin(angle_rad)

    def prepare(self, simulation: Simulation, actions: Actions) -> Prepared:
        """The scenes before the egos' actions (B,) are carried out."""
        scene = simulation.scene
        rows, ego = simulation.ego_vehicles
        followers = scene.followers[rows, ego]
        expected = np.zeros(followers.shape)
        if self._others:
            expect(scene, followers, expected)
        egos = simulation.ego_vehicles
        consistent = simulation.has_action[egos] & (simulation.action[egos] == actions)
        lane, target_lane = scene.lane[rows, ego], scene.target_lane[rows, ego]
        return Prepared(consistent, lane, target_lane, followers, expected)

    def __call__(self, simulation: Simulation, prepared: Prepared) -> Floats:
        """The rewards (B,) of the decisions."""
        scene, weights = simulation.scene, self._weights
        own = (
            weights.safety * safety(scene, self._horizon_s, self._headway_m)
            + weights.efficiency * efficiency(scene)
            + weights.comfort * prepared.consistent
        )
        rewards = self._own * own / weights.largest
        if self._others:
            rewards += self._others * (others(scene, prepared) + 6) / 12
        if self._lane_change_cost:
            changed = scene.target_lane[simulation.ego_vehicles] != prepared.target_lane
            rewards -= self._lane_change_cost * changed
        failed = (simulation.ending != RUNNING) & (simulation.ending != TIME)
        return np.where(failed, FAILURE, rewards)


def safety(scene: Scene, horizon_s: float = SAFE_TTC_S, headway_m: float = 0.0) -> Floats:
    """r_s (B,), eq. 4: in [0, 1], 1 while no collision is less than `horizon_s` away.

    Time to collision with the leader in the lane; during a lane change, half with the leader and
    half with the follower in the target lane. Nobody, or nobody nearing: infinite. With a
    `headway_m`, which eq. 4 does not have, each counts by its distance as a share of that, at most
    1.
    """
    result = np.empty(scene.ego.size)
    _safety(scene, horizon_s, headway_m, result)
    return result


def efficiency(scene: Scene) -> Floats:
    """r_e (B,), eq. 5: the forward speed within [23, 33] m/s, as a share."""
    egos = np.arange(scene.ego.size), scene.ego
    forward = scene.speed[egos] * np.cos(scene.heading[egos])
    share = (forward - SPEED_LOW_MPS) / (SPEED_HIGH_MPS - SPEED_LOW_MPS)
    return share.clip(0.0, 1.0)


def others(scene: Scene, prepared: Prepared) -> Floats:
    """r_o (B,), eq. 7: the gain of those behind in the lane and in the target lane, in [-6, 6].

    Compares what the two followers expected before the decision with what the same two expect
    after the decision interval. The expected acceleration is that of IDM with the ego where it is
    heading: in its target lane, even while it still moves there. So a lane change counts once,
    when it is decided, and for its whole effect. Without a target lane other than the ego's there
    is one follower only.
    """
    result = np.empty(scene.ego.size)
    _others(scene, prepared.lane, prepared.followers, prepared.expected, result)
    return result


def expect(scene: Scene, followers: Ints, expected: Floats) -> None:
    """Fills the expected accelerations [B, L] of who follows the ego on each lane."""
    _expect(scene, followers, expected)


@compiled
def forward_speed(scene: Scene, b: int, i: int) -> float:
    return float(scene.speed[b, i] * math.cos(scene.heading[b, i]))


@compiled
def _safe(
    scene: Scene, b: int, behind: int, ahead: int, horizon_s: float, headway_m: float
) -> float:
    """Time to collision over `horizon_s`, times distance over `headway_m`; each within [0, 1].

    -1 is no vehicle.
    """
    if behind < 0 or ahead < 0:
        return 1.0
    safe = 1.0
    distance = scene.x[b, ahead] - scene.x[b, behind]
    closing = forward_speed(scene, b, behind) - forward_speed(scene, b, ahead)
    if closing > 0.0:
        safe = distance / closing / horizon_s
    safe = min(max(safe, 0.0), 1.0)
    if headway_m > 0.0:
        safe *= min(distance / headway_m, 1.0)
    return float(safe)


@compiled
def _safety(scene: Scene, horizon_s: float, headway_m: float, result: Floats) -> None:
    for b in range(result.size):
        ego = scene.ego[b]
        lane, target = scene.lane[b, ego], scene.target_lane[b, ego]
        front = _safe(scene, b, ego, scene.leaders[b, ego, target], horizon_s, headway_m)
        if lane == target:
            result[b] = front
        else:
            rear = _safe(scene, b, scene.followers[b, ego, target], ego, horizon_s, headway_m)
            result[b] = 0.5 * front + 0.5 * rear


@compiled
def expected_acceleration(scene: Scene, b: int, i: int, lane: int) -> float:
    """IDM acceleration of vehicle i on a lane, the ego being where it is heading, m/s2."""
    ego = scene.ego[b]
    leader = scene.leaders[b, i, lane]
    if scene.target_lane[b, ego] == lane:
        if scene.x[b, ego] >= scene.x[b, i] and (
            leader < 0 or scene.x[b, ego] <= scene.x[b, leader]
        ):
            leader = ego
    elif leader == ego:
        leader = scene.leaders[b, ego, lane]
    speed = forward_speed(scene, b, i)
    free = 1 - (max(speed, 0.0) / IDM_SPEED_MPS) ** IDM_EXPONENT
    if leader < 0:
        return float(IDM_ACCELERATION * free)
    closing = speed - forward_speed(scene, b, leader)
    braking = 2 * math.sqrt(IDM_ACCELERATION * IDM_DECELERATION)
    wanted = IDM_JAM_DISTANCE_M + max(0.0, speed * IDM_HEADWAY_S + speed * closing / braking)
    gap = max(scene.x[b, leader] - scene.x[b, i], MINIMAL_GAP_M)
    return float(IDM_ACCELERATION * (free - (wanted / gap) ** 2))


@compiled
def _expect(scene: Scene, followers: Ints, expected: Floats) -> None:
    for b in range(followers.shape[0]):
        for lane in range(followers.shape[1]):
            if followers[b, lane] >= 0:
                expected[b, lane] = expected_acceleration(scene, b, followers[b, lane], lane)


@compiled
def _increase(scene: Scene, b: int, lane: int, followers: Ints, expected: Floats) -> float:
    if followers[b, lane] < 0:
        return 0.0
    gain = expected_acceleration(scene, b, followers[b, lane], lane) - expected[b, lane]
    return float(min(max(gain, -INCREASE_LIMIT_MPS2), INCREASE_LIMIT_MPS2))


@compiled
def _others(
    scene: Scene, lane_before: Ints, followers: Ints, expected: Floats, result: Floats
) -> None:
    for b in range(result.size):
        lane, target = lane_before[b], scene.target_lane[b, scene.ego[b]]
        result[b] = _increase(scene, b, lane, followers, expected)
        if target != lane:
            result[b] += _increase(scene, b, target, followers, expected)
