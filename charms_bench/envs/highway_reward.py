"""highway-env's own reward, which is the default."""

import numpy as np

from charms_bench.engine.endings import is_on_own_lane
from charms_bench.engine.simulation import Simulation
from charms_bench.foundation.compiled import clip, compiled, compiled_of_scenes
from charms_bench.world.actions import Actions
from charms_bench.world.scene import Floats, Ints, Scene, Vehicles

COLLISION, RIGHT_LANE, HIGH_SPEED = -1.0, 0.1, 0.4
SPEED_LOW_MPS, SPEED_HIGH_MPS = 20.0, 30.0


@compiled
def highway_reward(
    forward: float, target_lane: int, crashed: bool, off_road: bool, lanes: int
) -> float:
    """The reward of highway-env 1.12's `highway-v0`, in [0, 1] (Leurent 2018).

    -1 for a crash, 0.1 for the proportion of lanes to the left of the target lane, 0.4 for the
    forward speed, scaled from [20, 30] m/s to [0, 1]; mapped from [-1, 0.5] onto [0, 1]; 0 off the
    road [`HighwayEnv._reward`].

    Args:
        forward: Speed along the road, m/s.
        target_lane: 0 is the leftmost.
        crashed: Whether the vehicle has collided.
        off_road: Whether the vehicle has left the road.
        lanes: The road's number of lanes.
    """
    fast = clip((forward - SPEED_LOW_MPS) / (SPEED_HIGH_MPS - SPEED_LOW_MPS), 0.0, 1.0)
    right = target_lane / max(lanes - 1, 1)
    raw = COLLISION * crashed + RIGHT_LANE * right + HIGH_SPEED * fast
    return 0.0 if off_road else (raw - COLLISION) / (HIGH_SPEED + RIGHT_LANE - COLLISION)


@compiled_of_scenes
def _rewards(scene: Scene, rows: Ints, places: Ints, rewards: Floats) -> None:
    for m in range(rows.size):
        b, i = rows[m], places[m]
        forward = scene.speed[b, i] * scene.direction_x[b, i]
        is_on_road = is_on_own_lane(b, i, scene)
        target_lane, crashed = scene.target_lane[b, i], scene.crashed[b, i]
        rewards[m] = highway_reward(forward, target_lane, crashed, not is_on_road, scene.road.lanes)


def highway_rewards(scene: Scene, vehicles: Vehicles) -> Floats:
    """`highway_reward` of M vehicles, (M,)."""
    rows, places = vehicles
    rewards = np.empty(rows.size)
    _rewards(scene, rows, places, rewards)
    return rewards


class HighwayReward:
    """`highway_reward` for the egos of a simulation."""

    def prepare(self, simulation: Simulation, actions: Actions) -> None:
        """Remembers nothing; the reward depends on the scene after the decision only."""

    def __call__(self, simulation: Simulation, prepared: None) -> Floats:
        """The rewards (B,) of the scene after the decisions."""
        return highway_rewards(simulation.scene, simulation.ego_vehicles)
