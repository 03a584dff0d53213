"""Stages that learn from human driving, eq. 11 of the paper.

Fine-tuning starts from a trained network. Imitation starts from an untrained one, without L2
anchoring.

The softmax of eq. 11 is that of Q / T, where T is how far the starting network's values of the
actions differ: a trained network predicts people worse than chance, so a temperature fitted to it
would be infinite and would leave nothing to learn from.
"""

import json
import math
from collections.abc import Callable, Sequence
from copy import deepcopy
from dataclasses import asdict
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from scipy import special
from scipy.optimize import minimize_scalar
from torch import Tensor
from torch.nn import Sequential
from torch.nn.functional import cross_entropy, log_softmax

from charms_agents.human.samples import Samples
from charms_agents.training.curve import Epoch
from charms_agents.training.hyperparameters import Supervised
from charms_agents.training.network import Arrays, load_state, state_arrays
from charms_agents.training.standardisation import folded, standardise, unfolded
from charms_bench.world.scene import Observations

REHEARSED = 1024
"""Observations of the own driving in each step; fewer leave rare situations to chance."""
COLDEST, HOTTEST = 1e-3, 1e3
"""The limits of a fitted temperature; a network that predicts worse than chance is given HOTTEST,
at which all actions are equally probable."""


class Fit:
    """A network while it learns from samples; the same seed and samples give the same network.

    Args:
        network: The network to start from, which takes plain observations; it is not changed.
        samples: The samples; held-out ones are only measured.
        seed: Decides the order of the samples.
        standardised: Whether the weights that learn, and that L2 anchoring keeps near their start,
            are those of the equal network for standardised observations.
        own_driving: Observations (M, 7, 5) to rehearse; None without `Supervised.rehearsal`.
    """

    point = Epoch

    def __init__(
        self,
        network: Sequential,
        samples: Samples,
        settings: Supervised,
        seed: int,
        standardised: bool = False,
        own_driving: Observations | None = None,
    ) -> None:
        self.observations = samples.observations
        self._settings, self._seed, self._standardised = settings, seed, standardised
        self._network = unfolded(network) if standardised else deepcopy(network)
        self._parameters = list(self._network.parameters())
        self._pretrained = [parameter.detach().clone() for parameter in self._parameters]
        self._optimizer = torch.optim.Adam(self._parameters, lr=settings.learning_rate)
        observations = self._seen(samples.observations)
        labels, held_out = torch.from_numpy(samples.labels.copy()), samples.held_out
        self._training = observations[~held_out], labels[~held_out]
        self._held_out = observations[held_out], labels[held_out]
        with torch.no_grad():
            self._temperature = 1.0  # of logits, which a cross-entropy makes of any values
            if settings.loss == "divergence":
                self._temperature = spread(self._network(self._training[0]))
            if own_driving is not None:
                rehearsed = self._seen(own_driving)
                self._rehearsed = rehearsed, self._network(rehearsed)
        self.curve = [self._measured(0)]

    @property
    def network(self) -> Sequential:
        """The network so far, made to take plain observations."""
        return folded(self._network) if self._standardised else self._network

    @property
    def done(self) -> int:
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
        rng = np.random.default_rng([self._seed, epoch])
        order = torch.from_numpy(rng.permutation(len(labels)))
        for group in self._optimizer.param_groups:
            group["lr"] = self._settings.learning_rate_at(epoch)
        for rows in torch.split(order, self._settings.batch_size):
            loss = self._loss(observations[rows], labels[rows])
            if self._settings.rehearsal:
                loss = loss + self._settings.rehearsal * self._forgotten(rng)
            self._optimizer.zero_grad()
            loss.backward()  # type: ignore[no-untyped-call]  # of torch
            self._optimizer.step()
        self.curve.append(self._measured(epoch))

    def _seen(self, observations: Observations) -> Tensor:
        flat = torch.from_numpy(observations.copy()).flatten(1)
        return standardise(flat) if self._standardised else flat

    def _loss(self, observations: Tensor, labels: Tensor) -> Tensor:
        """L_total, eq. 11, or with the cross-entropy in place of its first term."""
        logits = self._network(observations) / self._temperature
        if self._settings.loss == "divergence":
            kl = divergence(logits, labels, self._settings.label_floor)
        else:
            kl = cross_entropy(logits, labels)
        if not self._settings.pull:
            return kl
        return kl + self._settings.pull * squared_distance(self._parameters, self._pretrained)

    def _forgotten(self, rng: np.random.Generator) -> Tensor:
        """How much the differences between actions changed in a batch of the own driving.

        The mean variance over the actions of the change of Q: a change of all actions alike does
        not change the driving.
        """
        observations, values = self._rehearsed
        drawn = torch.from_numpy(rng.integers(len(values), size=REHEARSED))
        change: Tensor = self._network(observations[drawn]) - values[drawn]
        return change.var(dim=1, correction=0).mean()

    def _measured(self, epoch: int) -> Epoch:
        with torch.no_grad():
            loss = float(self._loss(*self._training))
            told = self._network(self._training[0]).numpy()
            values = self._network(self._held_out[0]).numpy()
        temperature = fitted_temperature(told, self._training[1].numpy())
        labels = self._held_out[1].numpy()
        if not len(labels):
            return Epoch(epoch, loss, temperature, None, None)
        likely = log_likelihood(values, labels, temperature)
        return Epoch(epoch, loss, temperature, likely, agreement(values, labels))

    def arrays(self) -> Arrays:
        """Everything that further learning depends on, as plain arrays."""
        curve = np.array(json.dumps([asdict(point) for point in self.curve]))
        return {**state_arrays({"network": self._network}, self._optimizer), "curve": curve}

    def load_arrays(self, arrays: Arrays) -> None:
        """Takes over what `arrays` returned for the same job."""
        load_state({"network": self._network}, self._optimizer, arrays)
        self.curve = [Epoch(**point) for point in json.loads(str(arrays["curve"]))]

    def results(self, wall_s: float) -> dict[str, Any]:
        """What the manifest says of the learning: samples, and the first and last point."""
        used = {"training": len(self._training[1]), "held_out": len(self._held_out[1])}
        return {"used": used, "before": asdict(self.curve[0]), "after": asdict(self.curve[-1])}


def divergence(logits: Tensor, labels: Tensor, floor: float) -> Tensor:
    """KL(softmax(logits) || y), the first term of eq. 11, mean over rows.

    The divergence is infinite where a label is 0. So every label is mixed with the uniform
    distribution until no probability is below `floor`: y (1 - A floor) + floor for A actions.
    """
    log_p = log_softmax(logits, dim=1)
    floored = labels * (1 - labels.shape[1] * floor) + floor
    return (log_p.exp() * (log_p - floored.log())).sum(dim=1).mean()


def squared_distance(parameters: Sequence[Tensor], pretrained: Sequence[Tensor]) -> Tensor:
    """||theta - theta_pre||_2^2, the second term of eq. 11 without its weight."""
    pairs = zip(parameters, pretrained, strict=True)
    return torch.stack([(parameter - before).square().sum() for parameter, before in pairs]).sum()


def spread(values: Tensor) -> float:
    """Mean over rows of the standard deviation over the actions of values (M, A), at least 1.

    At most 1 is the spread of an untrained network, whose values have no scale yet.
    """
    return max(1.0, float(values.std(dim=1).mean()))


def agreement(values: NDArray[np.float32], labels: NDArray[np.float32]) -> float:
    """Proportion of rows in which the network's action is a most probable action of the label.

    The network takes the first action with the highest value, like `OnnxPolicy`.
    """
    taken = labels[np.arange(len(labels)), values.argmax(axis=1)]
    return float((taken == labels.max(axis=1)).mean())


def log_likelihood(
    values: NDArray[np.float32], labels: NDArray[np.float32], temperature: float
) -> float:
    """Mean over rows of the sum of y log softmax(Q / T), for values and labels (M, A)."""
    log_p = special.log_softmax(values.astype(np.float64) / temperature, axis=1)
    return float((labels * log_p).sum(axis=1).mean())


def fitted_temperature(values: NDArray[np.float32], labels: NDArray[np.float32]) -> float:
    """The temperature at which the labels (M, A) are the most likely, given the values (M, A).

    The log-likelihood is concave in 1 / T, so its only maximum over log T is found.
    """
    found = minimize_scalar(
        lambda log_t: -log_likelihood(values, labels, math.exp(log_t)),
        bounds=(math.log(COLDEST), math.log(HOTTEST)),
        method="bounded",
        options={"xatol": 1e-6},
    )
    return math.exp(found.x)
