"""Progress along the road, which is the default reward of continuous actions and on other roads.

highway-env's reward pays for not crashing, and for the speed at the moment of a decision. A vehicle
with continuous actions earns it by driving in circles or by standing still (highway-env's issues
#268, #312, #364, #647 and #653).
"""

import numpy as np

from charms_bench.engine.endings import GOAL
from charms_bench.engine.simulation import Simulation
from charms_bench.world.actions import Actions
from charms_bench.world.scene import Bools, Floats

COLLISION = -1.0
SPEED_MPS = 30.0
"""The mean speed along the road that earns 1 per decision; more speed earns no more."""


def progress_reward(
    progress_m: Floats, interval_s: float, failed: Bools, off_road: Bools
) -> Floats:
    """The reward of a decision, at most 1.

    It is the distance driven along the road, divided by that at 30 m/s, less 1 if the episode has
    ended in a collision or off the road. Distance driven backwards counts as negative, everywhere;
    distance driven forwards counts on the road only, and up to 30 m/s. So the rewards of a path
    that ends where it began sum to at most 0.

    Args:
        progress_m: (...) distance along the road in the decision interval, m.
        interval_s: Duration of the interval, s.
        failed: Whether the ego has collided, or has ended the episode by leaving the road.
        off_road: Whether the ego is beside the road after the interval.
    """
    progress = np.minimum(progress_m / (SPEED_MPS * interval_s), np.where(off_road, 0.0, 1.0))
    return np.asarray(progress + COLLISION * failed)


class ProgressReward:
    """`progress_reward` for the egos of a simulation.

    An ego that reaches the goal of its road also earns 1 for each decision that is left. So nothing
    earns more than to reach it, however long the way is.
    """

    def prepare(self, simulation: Simulation, actions: Actions) -> Floats:
        """The egos' positions along the road (B,)."""
        return np.asarray(simulation.scene.x[simulation.ego_vehicles])

    def __call__(self, simulation: Simulation, prepared: Floats) -> Floats:
        """The rewards (B,) of the decisions."""
        left = simulation.settings.decisions - simulation.steps
        rewards = progress_reward(
            progress_m=simulation.scene.x[simulation.ego_vehicles] - prepared,
            interval_s=1 / simulation.settings.decision_hz,
            failed=simulation.failed,
            off_road=simulation.is_off_road,
        )
        return np.where(simulation.ending == GOAL, rewards + left, rewards)
