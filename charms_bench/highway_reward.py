"""highway-env's own reward, for whoever brings no other."""

import numpy as np

from charms_bench.agent import Actions
from charms_bench.scene import Floats
from charms_bench.simulation import Simulation

COLLISION, RIGHT_LANE, HIGH_SPEED = -1.0, 0.1, 0.4
SPEED_LOW_MPS, SPEED_HIGH_MPS = 20.0, 30.0


class HighwayReward:
    """The reward of highway-env 1.12's `highway-v0`, in [0, 1] (Leurent 2018).

    -1 for a crash, 0.1 for the share of lanes to the left of the target lane, 0.4 for the forward
    speed as a share of 20 to 30 m/s; from [-1, 0.5] onto [0, 1], and 0 off the road
    [`HighwayEnv._reward`].
    """

    def prepare(self, simulation: Simulation, actions: Actions) -> None:
        """Nothing has to be remembered of the scene before."""

    def __call__(self, simulation: Simulation, prepared: None) -> Floats:
        """The rewards (B,) of the scene as the decisions have left it."""
        scene, egos = simulation.scene, simulation.ego_vehicles
        forward = scene.speed[egos] * np.cos(scene.heading[egos])
        fast = ((forward - SPEED_LOW_MPS) / (SPEED_HIGH_MPS - SPEED_LOW_MPS)).clip(0.0, 1.0)
        right = scene.target_lane[egos] / (scene.constants.lanes - 1)
        raw = COLLISION * scene.crashed[egos] + RIGHT_LANE * right + HIGH_SPEED * fast
        normalised = (raw - COLLISION) / (HIGH_SPEED + RIGHT_LANE - COLLISION)
        rewards: Floats = np.where(scene.off_road[egos], 0.0, normalised)
        return rewards
