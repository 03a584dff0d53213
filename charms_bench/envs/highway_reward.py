"""highway-env's own reward, which is the default."""

import numpy as np

from charms_bench.engine.simulation import Simulation
from charms_bench.world.actions import Actions
from charms_bench.world.scene import Bools, Floats, Ints

COLLISION, RIGHT_LANE, HIGH_SPEED = -1.0, 0.1, 0.4
SPEED_LOW_MPS, SPEED_HIGH_MPS = 20.0, 30.0


def highway_reward(
    forward: Floats, target_lane: Ints, crashed: Bools, off_road: Bools, lanes: int
) -> Floats:
    """The reward of highway-env 1.12's `highway-v0`, in [0, 1] (Leurent 2018).

    -1 for a crash, 0.1 for the share of lanes to the left of the target lane, 0.4 for the forward
    speed as a share of 20 to 30 m/s; from [-1, 0.5] onto [0, 1], and 0 off the road
    [`HighwayEnv._reward`].

    Args:
        forward: (...) speed along the road, m/s; the others have its shape.
        target_lane: 0 is the leftmost.
        crashed: Whether the vehicle has collided.
        off_road: Whether the vehicle has left the road.
        lanes: The road's number of lanes.
    """
    fast = ((forward - SPEED_LOW_MPS) / (SPEED_HIGH_MPS - SPEED_LOW_MPS)).clip(0.0, 1.0)
    right = target_lane / (lanes - 1)
    raw = COLLISION * crashed + RIGHT_LANE * right + HIGH_SPEED * fast
    normalised = (raw - COLLISION) / (HIGH_SPEED + RIGHT_LANE - COLLISION)
    return np.where(off_road, 0.0, normalised)


class HighwayReward:
    """`highway_reward` for the egos of a simulation."""

    def prepare(self, simulation: Simulation, actions: Actions) -> None:
        """Remembers nothing; the reward depends on the scene after the decision only."""

    def __call__(self, simulation: Simulation, prepared: None) -> Floats:
        """The rewards (B,) of the scene after the decisions."""
        scene, egos = simulation.scene, simulation.ego_vehicles
        return highway_reward(
            forward=scene.speed[egos] * scene.direction_x[egos],
            target_lane=scene.target_lane[egos],
            crashed=scene.crashed[egos],
            off_road=simulation.is_off_road,
            lanes=scene.constants.lanes,
        )
