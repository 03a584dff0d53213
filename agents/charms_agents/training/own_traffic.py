"""Self-play: traffic that is driven by the network that a stage is training."""

import numpy as np
import torch
from numpy.typing import NDArray

from charms_agents.training.double_dqn import DoubleDQN
from charms_bench.plugins.agent import Policy
from charms_bench.world.actions import MetaAction
from charms_bench.world.observations import NamedObservation
from charms_bench.world.scene import Floats, Observations

LEAST = 2.0**-54
"""In place of a random number of 0."""


class OwnTraffic(Policy):
    """The network as it is now.

    With a prior, it draws its actions, as after the training, and else it takes the best ones. Each
    vehicle also draws one of the styles that the network is given, and keeps it.

    Args:
        observation: What the network observes.
        actions: Its meta-actions.
        styles: (S, G) what it is given of each style; (1, 0) if it has one.
    """

    memory_width = 1
    learner: DoubleDQN | None = None
    """What trains the network; it is made after its environments."""

    def __init__(
        self,
        observation: NamedObservation,
        actions: tuple[MetaAction, ...],
        styles: NDArray[np.float32],
    ) -> None:
        self.observation, self.actions, self._styles = observation, actions, styles
        self.noise_draws = 1 + len(actions)

    def decide(
        self, observations: Observations, memory: Floats, noise: Floats
    ) -> tuple[NDArray[np.int64], Floats]:
        """The actions (M,), and one more than the index of each vehicle's style (M, 1)."""
        assert self.learner is not None
        drawn = np.floor(noise[:, :1] * len(self._styles)) + 1
        style = np.where(memory > 0, memory, drawn)
        given = torch.from_numpy(self._styles[style[:, 0].astype(np.int64) - 1])
        preferences = self.learner.preferences(observations.copy(), given)
        if self.learner.prior is not None:
            preferences = preferences - np.log(-np.log(np.maximum(noise[:, 1:], LEAST)))
        return preferences.argmax(axis=1), style
