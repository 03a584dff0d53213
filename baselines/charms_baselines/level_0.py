"""The level-0 driver, which does not reason about other drivers."""

import numpy as np

from charms_bench import Policy
from charms_bench.world.actions import IDLE, SLOWER, Actions
from charms_bench.world.observations import FRONT, X_SCALE_M
from charms_bench.world.scene import Observations


class Level0(Policy):
    """Keeps its speed and lane, and brakes for slower vehicles within 30 m ahead in its lane."""

    def decide(self, observations: Observations) -> Actions:
        presence, x, _, vx, _ = observations[:, FRONT].T
        return np.where((presence > 0) & (x * X_SCALE_M < 30) & (vx < 0), SLOWER, IDLE)
