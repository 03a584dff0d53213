"""The paper's reward with what it leaves open filled in: scales, costs and a sound comfort.

Equations are numbered as in the paper; `rewards` has them as they are printed. The differences:

- r_s (eq. 4) is the time to collision if the vehicle ahead lost `leader_loses_mps` of its speed. So
  it depends on the gap at equal speeds too, and the weight of safety decides which gap is worth
  keeping. Gaps are bumper to bumper, and during a lane change the leader on the old lane counts.
- r_e (eq. 5) is relative to the speed that the ego desires, and falls beyond it.
- r_c (eq. 6) is about what passengers feel: the acceleration, its change, and lane changes begun.
- A failure is a cost of the ego's own, so it is weighed by cos phi like everything that the ego
  wants for itself: for all orientations, a crash costs equally many units of the own reward. A
  conflict can be one, too. To reach the goal of a road is a gain of the same kind.
- r_o (eq. 7) is divided by a scale, by default its largest value, and is 0 when nobody is affected.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from charms_agents.training.rewards import (
    INCREASE_LIMIT_MPS2,
    Affected,
    Weights,
    affected,
    distance,
    forward_speed,
    others,
)
from charms_bench.engine.endings import GOAL
from charms_bench.engine.simulation import Simulation
from charms_bench.foundation.compiled import compiled
from charms_bench.foundation.fields import FrozenModel, NonNegative, Positive
from charms_bench.world.actions import Actions
from charms_bench.world.candidate_lanes import OWN, TARGET
from charms_bench.world.gaps import gap_to
from charms_bench.world.scene import Floats, Ints, Scene

CONFLICT_S = 2.0
"""From this time to collision down, a conflict costs; metrics count one below 1.5 s."""
DISCOMFORT_LIMIT = 30.0
"""The most that acceleration and jerk take off r_c, so that an emergency is not worse than that."""


class RewardScales(FrozenModel):
    """What the paper's equations leave open."""

    safety_horizon_s: Positive = 4.0
    """A time to collision of this and more is safe."""
    leader_loses_mps: NonNegative = 5.0
    """The speed that a vehicle ahead may lose."""
    desired_speed_mps: Positive = 30.0
    """r_e is 1 at this speed."""
    slow_speed_mps: NonNegative | None = None
    """r_e is 0 at this speed and below; by default, it is the profile's lowest target speed."""
    acceleration_mps2: Positive = 0.6
    """A mean acceleration of this over a decision takes 1 off r_c, twice this takes 4."""
    jerk_mps3: Positive = 3.0
    """A change of the acceleration of this between two decisions takes 1 off r_c."""
    others_acceleration_mps2: Positive = 2 * INCREASE_LIMIT_MPS2
    """r_o is 1 if followers gain this, and -1 if they lose it."""
    others_gain_mps2: NonNegative = INCREASE_LIMIT_MPS2
    """What each follower gains at most; with 0, only what followers lose counts."""
    lane_change_cost: NonNegative = 60.0
    """What a lane change that begins takes off r_c."""
    failure_cost: NonNegative = 60.0
    """The own reward of a crash, or of leaving the road, is minus this."""
    conflict_cost: Positive | None = None
    """What a time to collision of 0 takes off the own reward, and of `CONFLICT_S` nothing; by
    default, conflicts cost nothing more than r_s says."""
    goal_reward: Positive | None = None
    """The own reward of reaching the goal of a road, in addition to that of the decision. An
    episode ends there, so it has to be worth more than driving on: 1 / (1 - discount)."""


class Before(NamedTuple):
    """What the reward needs to know of the scenes before a decision; all (B,) but `affected`."""

    affected: Affected
    speed: Floats
    acceleration: Floats
    target_lane: Ints


def style_numbers(weights: Weights, angle_rad: float) -> tuple[float, ...]:
    """cos phi, sin phi, a, b and c: a style, as networks are given it."""
    parts = weights.safety, weights.efficiency, weights.comfort
    return math.cos(angle_rad), math.sin(angle_rad), *parts


@dataclass(frozen=True)
class CompletedReward:
    """R_2 = E (a r_s + b r_e + c r_c) / (a + b + c) + O r_o, eq. 8, with E = cos phi, O = sin phi.

    Args:
        weights: a, b and c; of several styles, those of each.
        angle_rad: phi, of each. Of S styles, scene b has the style b modulo S.
        scales: What the equations leave open.
    """

    weights: Weights | Sequence[Weights]
    angle_rad: float | Sequence[float]
    scales: RewardScales

    @cached_property
    def _styles(self) -> Floats:
        """(S, 5) the styles, as `style_numbers`."""
        weights = [self.weights] if isinstance(self.weights, Weights) else self.weights
        angles = [self.angle_rad] if isinstance(self.angle_rad, float | int) else self.angle_rad
        return np.array([style_numbers(*style) for style in zip(weights, angles, strict=True)])

    def prepare(self, simulation: Simulation, actions: Actions) -> Before:
        """Observes the scenes before the egos' actions (B,) are carried out."""
        scene, egos = simulation.scene, simulation.ego_vehicles
        return Before(
            affected(scene, bool(self._styles[:, 1].any())),
            scene.speed[egos],
            scene.acceleration[egos],
            scene.target_lane[egos],
        )

    def __call__(self, simulation: Simulation, prepared: Before) -> Floats:
        """The rewards (B,) of the decisions."""
        scene = simulation.scene
        of_scenes = self._styles[np.arange(scene.ego.size) % len(self._styles)]
        own_weight, others_weight, a, b, c = of_scenes.T
        own = (
            a * safety(scene, self.scales)
            + b * self._efficiency(simulation)
            + c * self._comfort(simulation, prepared)
        ) / (a + b + c)
        if self.scales.conflict_cost:
            own -= self.scales.conflict_cost * (1 - _safety(scene, CONFLICT_S, 0.0))
        own = np.where(simulation.failed, -self.scales.failure_cost, own)
        if self.scales.goal_reward:
            own = own + self.scales.goal_reward * (simulation.ending == GOAL)
        rewards = own_weight * own
        if others_weight.any():
            gain = others(scene, prepared.affected, self.scales.others_gain_mps2)
            gain /= self.scales.others_acceleration_mps2
            rewards += others_weight * np.where(simulation.failed, 0.0, gain)
        return np.asarray(rewards)

    def _efficiency(self, simulation: Simulation) -> Floats:
        """r_e (B,), at most 1."""
        scene, egos = simulation.scene, simulation.ego_vehicles
        slowest, desired = self.scales.slow_speed_mps, self.scales.desired_speed_mps
        if slowest is None:
            slowest = simulation.settings.profile.target_speed_min_mps
        forward = scene.speed[egos] * scene.direction_x[egos]
        return 1 - np.abs(desired - forward.clip(slowest)) / (desired - slowest)

    def _comfort(self, simulation: Simulation, before: Before) -> Floats:
        """r_c (B,), at most 1."""
        scene, scales, egos = simulation.scene, self.scales, simulation.ego_vehicles
        hz = simulation.settings.decision_hz
        acceleration = (scene.speed[egos] - before.speed) * hz
        jerk = (scene.acceleration[egos] - before.acceleration) * hz
        felt = (acceleration / scales.acceleration_mps2) ** 2 + (jerk / scales.jerk_mps3) ** 2
        begun = scene.target_lane[egos] != before.target_lane
        return np.asarray(1 - np.minimum(felt, DISCOMFORT_LIMIT) - scales.lane_change_cost * begun)


def safety(scene: Scene, scales: RewardScales) -> Floats:
    """r_s (B,), eq. 4, from 0 to 1, if vehicles ahead may lose speed; see `RewardScales`.

    It is the time to collision with the leader, divided by the horizon. During a lane change, it is
    the mean for the leader and the follower on the target lane, but at most that for the leader on
    the lane that the ego leaves.
    """
    return _safety(scene, scales.safety_horizon_s, scales.leader_loses_mps)


@compiled
def _safety(scene: Scene, horizon_s: float, loses_mps: float) -> Floats:
    result = np.empty(scene.ego.size)
    for b in range(result.size):
        ego = scene.ego[b]
        lane, target = scene.lane[b, ego], scene.target_lane[b, ego]
        result[b] = _safe(scene, b, ego, scene.leaders[b, ego, TARGET], horizon_s, loses_mps)
        if lane != target:
            rear = _safe(scene, b, scene.followers[b, ego, TARGET], ego, horizon_s, loses_mps)
            left = _safe(scene, b, ego, scene.leaders[b, ego, OWN], horizon_s, loses_mps)
            result[b] = min(0.5 * result[b] + 0.5 * rear, left)
    return result


@compiled
def _safe(
    scene: Scene, b: int, behind: int, ahead: int, horizon_s: float, loses_mps: float
) -> float:
    """The time to collision divided by the horizon, from 0 to 1; -1 stands for no vehicle."""
    if behind < 0 or ahead < 0:
        return 1.0
    apart, length = distance(scene, b, behind, ahead), scene.length
    gap = gap_to(apart, length[b, behind], length[b, ahead])
    closing = forward_speed(scene, b, behind) - forward_speed(scene, b, ahead) + loses_mps
    if closing <= 0.0:
        return 1.0 if gap > 0.0 else 0.0
    return float(min(max(gap / closing / horizon_s, 0.0), 1.0))
