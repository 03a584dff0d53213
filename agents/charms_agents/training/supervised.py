"""Stages that learn from human driving, eq. 11 of the paper.

Fine-tuning starts from a trained network. Imitation starts from an untrained one, with no pull.
"""

import json
from collections.abc import Callable, Sequence
from dataclasses import asdict
from typing import Any

import numpy as np
import torch
from torch import Tensor
from torch.nn import Sequential
from torch.nn.functional import log_softmax

from charms_agents.human.samples import Samples
from charms_agents.training.curve import Epoch
from charms_agents.training.network import OBSERVED, Arrays, load_state, state_arrays
from charms_agents.training.settings import Supervised
from charms_bench.world.actions import ACTIONS


class Fit:
    """A network while it learns from samples; the same seed and samples give the same network.

    Args:
        network: The network to train in place; `Supervised.pull` pulls it back to this start.
        samples: The samples; held-out ones are only measured.
        settings: How the network learns.
        seed: Decides the order of the samples.
    """

    point = Epoch

    def __init__(
        self, network: Sequential, samples: Samples, settings: Supervised, seed: int
    ) -> None:
        self.network, self.observations = network, samples.observations
        self._settings, self._seed = settings, seed
        self._parameters = list(network.parameters())
        self._pretrained = [parameter.detach().clone() for parameter in self._parameters]
        self._optimizer = torch.optim.Adam(self._parameters, lr=settings.learning_rate)
        observations = torch.from_numpy(samples.observations.reshape(-1, OBSERVED).copy())
        labels, held_out = torch.from_numpy(samples.labels.copy()), samples.held_out
        self._training = observations[~held_out], labels[~held_out]
        self._held_out = observations[held_out], labels[held_out]
        self.curve = [self._measured(0)]

    @property
    def done(self) -> int:
        """Epochs so far."""
        return self.curve[-1].epoch

    def learn(self, pause: Callable[[], None] = lambda: None) -> None:
        """Learns until the last epoch; calls `pause` before each epoch."""
        while self.done < self._settings.epochs:
            pause()
            self.step()

    def step(self) -> None:
        """Learns from every training sample once."""
        observations, labels = self._training
        epoch = self.done + 1
        order = np.random.default_rng([self._seed, epoch]).permutation(len(labels))
        for rows in torch.split(torch.from_numpy(order), self._settings.batch_size):
            loss = self._loss(observations[rows], labels[rows])
            self._optimizer.zero_grad()
            loss.backward()  # type: ignore[no-untyped-call]  # of torch
            self._optimizer.step()
        self.curve.append(self._measured(epoch))

    def _loss(self, observations: Tensor, labels: Tensor) -> Tensor:
        """L_total, eq. 11."""
        kl = divergence(self.network(observations), labels, self._settings.label_floor)
        if not self._settings.pull:
            return kl
        return kl + self._settings.pull * squared_distance(self._parameters, self._pretrained)

    def _measured(self, epoch: int) -> Epoch:
        with torch.no_grad():
            loss = float(self._loss(*self._training))
            observations, labels = self._held_out
            if not len(labels):
                return Epoch(epoch, loss, None, None)
            logits: Tensor = self.network(observations)
            return Epoch(epoch, loss, log_likelihood(logits, labels), agreement(logits, labels))

    def arrays(self) -> Arrays:
        """Everything that further learning depends on, as plain arrays."""
        curve = np.array(json.dumps([asdict(point) for point in self.curve]))
        return {**state_arrays({"network": self.network}, self._optimizer), "curve": curve}

    def load_arrays(self, arrays: Arrays) -> None:
        """Takes over what `arrays` returned for the same job."""
        load_state({"network": self.network}, self._optimizer, arrays)
        self.curve = [Epoch(**point) for point in json.loads(str(arrays["curve"]))]

    def results(self, wall_s: float) -> dict[str, Any]:
        """What the manifest says of the learning: samples, and the first and last point."""
        used = {"training": len(self._training[1]), "held_out": len(self._held_out[1])}
        return {"used": used, "before": asdict(self.curve[0]), "after": asdict(self.curve[-1])}


def divergence(logits: Tensor, labels: Tensor, floor: float) -> Tensor:
    """KL(softmax(logits) || y), the first term of eq. 11, mean over rows.

    The divergence is infinite where a label is 0. So every label is mixed with the uniform
    distribution until no probability is below `floor`: y (1 - 5 floor) + floor.
    """
    log_p = log_softmax(logits, dim=1)
    floored = labels * (1 - len(ACTIONS) * floor) + floor
    return (log_p.exp() * (log_p - floored.log())).sum(dim=1).mean()


def squared_distance(parameters: Sequence[Tensor], pretrained: Sequence[Tensor]) -> Tensor:
    """||theta - theta_pre||_2^2, the second term of eq. 11 without its weight."""
    pairs = zip(parameters, pretrained, strict=True)
    return torch.stack([(parameter - before).square().sum() for parameter, before in pairs]).sum()


def log_likelihood(logits: Tensor, labels: Tensor) -> float:
    """Mean over rows of the sum of y log softmax(logits)."""
    return float((labels * log_softmax(logits, dim=1)).sum(dim=1).mean())


def agreement(values: Tensor, labels: Tensor) -> float:
    """Share of rows in which the network's action is a most probable action of the label.

    The network takes the first action with the highest value, like `OnnxPolicy`.
    """
    taken = torch.from_numpy(values.numpy().argmax(axis=1))[:, None]
    return float((labels.gather(1, taken)[:, 0] == labels.amax(dim=1)).double().mean())
