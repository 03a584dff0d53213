"""Running scenes whose states are kept: for tests, and for `tools/check_states.py`."""

from collections.abc import Iterator

import numpy as np

from charms_bench.engine.simulation import Simulation
from charms_bench.engine.state import SceneState
from charms_bench.plugins.agent import Policy
from charms_bench.world.actions import Actions
from charms_bench.world.scene import Observations


class Whims(Policy):
    """Acts as if at random, so that vehicles collide, but depends on the observation alone."""

    def __init__(self, decision_hz: float = 15.0) -> None:
        self.decision_hz = decision_hz

    def decide(self, observations: Observations) -> Actions:
        sums = np.abs(observations.astype(np.float64)).sum(axis=(1, 2))
        return (sums * 1e4).astype(np.int64) % 5


def moments(running: Simulation) -> Iterator[SceneState]:
    """Simulates until all episodes have ended; yields each state after the first."""
    while running.scene.active.any():
        if running.phase == running.settings.steps_per_decision:
            running.finish_step()
        else:
            running.advance()
        yield running.state()
