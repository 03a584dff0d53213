"""Model predictive control: simulates a few plans, and carries out the first action of the best."""

from typing import Any

import numpy as np

from charms_bench import FASTER, IDLE, LANE_LEFT, LANE_RIGHT, SLOWER, Policy
from charms_bench.world.actions import Actions
from charms_bench.world.gaps import time_headway
from charms_bench.world.scene import Observations

CLOSE_S = 1.5
"""A shorter time headway to the leader costs something."""


class ModelPredictive(Policy):
    """Looks ahead from a copy of the scene, in which IDM+MOBIL drives all other vehicles.

    It compares one plan for each first action, and continues each of them with IDLE. A plan's value
    is the distance driven, minus 10 m per decision and second of time headway below 1.5 s, minus
    2 m for a lane change, minus 1,000 m for a crash.

    Args:
        horizon: Decisions of a plan.
        others: The agent that drives all other vehicles.
    """

    def __init__(self, horizon: int = 9, others: str = "idm_mobil") -> None:
        self.rollouts_with = others
        self._first = np.array([IDLE, FASTER, SLOWER, LANE_LEFT, LANE_RIGHT])
        self._plans = np.full((self._first.size, horizon), IDLE)
        self._plans[:, 0] = self._first

    def decide(self, observations: Observations, memory: Any, noise: Any, rollouts: Any) -> Actions:
        found = rollouts(self._plans)
        headway_s = time_headway(found.gap, found.speed)
        close_s = np.maximum(CLOSE_S - headway_s, 0.0).sum(axis=2)
        changes = np.isin(self._first, (LANE_LEFT, LANE_RIGHT))
        value = found.x[:, :, -1] - 10.0 * close_s - 2.0 * changes - 1e3 * found.failed[:, :, -1]
        return np.asarray(self._first[np.argmax(value, axis=1)])
