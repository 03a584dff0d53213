"""The rewards of the paper, eqs. 4 to 8.

Equations are numbered as in the paper. Distances are longitudinal and centre to centre. Speeds are
along the road.
"""

import math
from dataclasses import dataclass
from typing import Annotated, Literal, NamedTuple

import numpy as np
from pydantic import Field

from charms_bench.engine.simulation import Simulation
from charms_bench.foundation.compiled import compiled
from charms_bench.foundation.fields import FrozenModel
from charms_bench.world.actions import Actions
from charms_bench.world.candidate_lanes import TARGET, follower_on, leader_on
from charms_bench.world.road import distance_along
from charms_bench.world.scene import Bools, Floats, Ints, Scene

Svo = Literal["competitive", "egoistic", "prosocial", "altruistic"]
SVO_ANGLES_RAD: dict[Svo, float] = {
    "competitive": -math.pi / 4,
    "egoistic": 0.0,
    "prosocial": math.pi / 4,
    "altruistic": math.pi / 2,
}
"""Social value orientations (SVO) as angles; they weigh the own reward against that of others."""

SAFE_TTC_S = 3.0
"""Horizon of r_s, eq. 4: a later collision does not count."""
SPEED_LOW_MPS, SPEED_HIGH_MPS = 23.0, 33.0
FAILURE = -10.0
"""The paper's reward of the decision in which the ego crashes or leaves the road."""
INCREASE_LIMIT_MPS2 = 3.0
"""The most that one vehicle can add to r_o, eq. 7."""

IDM_SPEED_MPS, IDM_ACCELERATION, IDM_DECELERATION = 33.0, 3.0, 5.0
IDM_JAM_DISTANCE_M, IDM_HEADWAY_S, IDM_EXPONENT = 10.0, 1.0, 4.0
MINIMAL_GAP_M = 1.0
"""IDM uses at least this gap; smaller ones are deep inside a collision."""


class Weights(FrozenModel):
    """Weights of safety, efficiency and comfort: a, b and c of eqs. 6 and 8."""

    safety: Annotated[float, Field(ge=0, le=100)]
    efficiency: Annotated[float, Field(ge=0, le=100)]
    comfort: Annotated[float, Field(ge=0, le=100)]

    @property
    def largest(self) -> float:
        """The largest own reward; each of its parts is at most 1."""
        return self.safety + self.efficiency + self.comfort


class Affected(NamedTuple):
    """What r_o, eq. 7, needs to know of the scenes before a decision."""

    lane: Ints
    """(B,) the egos' lanes."""
    followers: Ints
    """(B, L) the follower of the ego on each lane; -1 without one."""
    expected: Floats
    """(B, L) the followers' expected accelerations, m/s2."""


class Prepared(NamedTuple):
    """What the reward needs to know of the scenes before a decision."""

    consistent: Bools
    """(B,) whether the action equals the previous one."""
    affected: Affected


@dataclass(frozen=True)
class StyleReward:
    """R_2, eq. 8: E (a r_s + b r_e + c r_c) + O r_o with E = cos phi and O = sin phi.

    The own reward is divided by its largest value, and r_o is mapped from [-6, 6] to [0, 1], so
    both have the same range. For an egoist R_2 is R_1, eq. 6. If the ego crashes or leaves the
    road, the reward is `FAILURE`.

    Args:
        weights: a, b and c.
        angle_rad: phi, for example from `SVO_ANGLES_RAD`.
    """

    weights: Weights
    angle_rad: float

    def prepare(self, simulation: Simulation, actions: Actions) -> Prepared:
        """Observes the scenes before the egos' actions (B,) are executed."""
        egos = simulation.ego_vehicles
        consistent = simulation.has_action[egos] & (simulation.action[egos] == actions)
        others_count = bool(math.sin(self.angle_rad))
        return Prepared(consistent, affected(simulation.scene, others_count))

    def __call__(self, simulation: Simulation, prepared: Prepared) -> Floats:
        """The rewards (B,) of the decisions."""
        scene, weights = simulation.scene, self.weights
        own_weight, others_weight = math.cos(self.angle_rad), math.sin(self.angle_rad)
        own = (
            weights.safety * safety(scene)
            + weights.efficiency * efficiency(scene)
            + weights.comfort * prepared.consistent
        )
        rewards = own_weight * own / weights.largest
        if others_weight:
            gain = others(scene, prepared.affected, INCREASE_LIMIT_MPS2)
            rewards += others_weight * (gain + 6) / 12
        return np.where(simulation.failed, FAILURE, rewards)


@compiled
def safety(scene: Scene) -> Floats:
    """r_s (B,), eq. 4, from 0 to 1; 1 if no collision is less than `SAFE_TTC_S` away.

    It is the time to collision with the leader in the ego's lane, divided by `SAFE_TTC_S`.
    During a lane change it is the mean for the leader and the follower in the target lane. A
    missing or departing vehicle counts as safe.
    """
    result = np.empty(scene.ego.size)
    for b in range(result.size):
        ego = scene.ego[b]
        lane, target = scene.lane[b, ego], scene.target_lane[b, ego]
        front = _safe(scene, b, ego, scene.leaders[b, ego, TARGET])
        if lane == target:
            result[b] = front
        else:
            rear = _safe(scene, b, scene.followers[b, ego, TARGET], ego)
            result[b] = 0.5 * front + 0.5 * rear
    return result


def efficiency(scene: Scene) -> Floats:
    """r_e (B,), eq. 5: the forward speed, mapped from [23, 33] m/s to [0, 1]."""
    egos = np.arange(scene.ego.size), scene.ego
    forward = scene.speed[egos] * np.cos(scene.heading[egos])
    scaled = (forward - SPEED_LOW_MPS) / (SPEED_HIGH_MPS - SPEED_LOW_MPS)
    return scaled.clip(0.0, 1.0)


@compiled
def affected(scene: Scene, others_count: bool) -> Affected:
    """What r_o needs of the scenes before a decision; without followers if it has no weight."""
    shape = (scene.ego.size, scene.road.lanes)
    lanes, followers, expected = np.zeros(shape[0], np.int64), np.full(shape, -1), np.zeros(shape)
    for b in range(shape[0] if others_count else 0):
        lanes[b] = scene.lane[b, scene.ego[b]]
        for lane in range(shape[1]):
            follower = followers[b, lane] = follower_on(b, scene.ego[b], lane, scene)
            if follower >= 0:
                expected[b, lane] = expected_acceleration(scene, b, follower, lane)
    return Affected(lanes, followers, expected)


@compiled
def others(scene: Scene, before: Affected, most_mps2: float) -> Floats:
    """r_o (B,), eq. 7: gain in acceleration of the followers in both lanes, from -6 m/s2.

    Each gains at most `most_mps2`, which is 3 m/s2 in the paper.

    The followers are the vehicles behind the ego in its lane and in its target lane; without a
    lane change there is only one. Their expected accelerations before the decision are compared
    with those after the decision interval. The expected acceleration is IDM's, with the ego in its
    target lane even while it still moves there. So a lane change counts once, when it is decided.
    """
    result = np.empty(scene.ego.size)
    for b in range(result.size):
        lane, target = before.lane[b], scene.target_lane[b, scene.ego[b]]
        result[b] = _increase(scene, b, lane, before, most_mps2)
        if target != lane:
            result[b] += _increase(scene, b, target, before, most_mps2)
    return result


@compiled
def forward_speed(scene: Scene, b: int, i: int) -> float:
    return float(scene.speed[b, i] * math.cos(scene.heading[b, i]))


@compiled
def distance(scene: Scene, b: int, i: int, j: int) -> float:
    """How far vehicle j is ahead of vehicle i along its lane, centre to centre, m."""
    x, y, lane = scene.x, scene.y, scene.lane[b, i]
    return float(distance_along(scene.road, lane, x[b, i], y[b, i], x[b, j], y[b, j]))


@compiled
def _safe(scene: Scene, b: int, behind: int, ahead: int) -> float:
    """Time to collision over `SAFE_TTC_S`, from 0 to 1; -1 means that there is no vehicle."""
    if behind < 0 or ahead < 0:
        return 1.0
    safe = 1.0
    closing = forward_speed(scene, b, behind) - forward_speed(scene, b, ahead)
    if closing > 0.0:
        safe = distance(scene, b, behind, ahead) / closing / SAFE_TTC_S
    return float(min(max(safe, 0.0), 1.0))


@compiled
def expected_acceleration(scene: Scene, b: int, i: int, lane: int) -> float:
    """IDM acceleration of vehicle i on a lane, with the ego in its target lane, m/s2."""
    ego = scene.ego[b]
    leader = leader_on(b, i, lane, scene)
    if scene.target_lane[b, ego] == lane:
        is_ahead = distance(scene, b, i, ego) >= 0
        if is_ahead and (leader < 0 or distance(scene, b, ego, leader) >= 0):
            leader = ego
    elif leader == ego:
        leader = leader_on(b, ego, lane, scene)
    speed = forward_speed(scene, b, i)
    free = 1 - (max(speed, 0.0) / IDM_SPEED_MPS) ** IDM_EXPONENT
    if leader < 0:
        return float(IDM_ACCELERATION * free)
    closing = speed - forward_speed(scene, b, leader)
    braking = 2 * math.sqrt(IDM_ACCELERATION * IDM_DECELERATION)
    wanted = IDM_JAM_DISTANCE_M + max(0.0, speed * IDM_HEADWAY_S + speed * closing / braking)
    gap = max(distance(scene, b, i, leader), MINIMAL_GAP_M)
    return float(IDM_ACCELERATION * (free - (wanted / gap) ** 2))


@compiled
def _increase(scene: Scene, b: int, lane: int, before: Affected, most_mps2: float) -> float:
    follower = before.followers[b, lane]
    if follower < 0:
        return 0.0
    gain = expected_acceleration(scene, b, follower, lane) - before.expected[b, lane]
    return float(min(max(gain, -INCREASE_LIMIT_MPS2), most_mps2))
