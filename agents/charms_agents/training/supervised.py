"""Learning from human driving: fine-tuning, eq. 11 of the paper, and imitation.

Imitation is fine-tuning that starts from an untrained network and is pulled nowhere.
"""

import csv
import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
import torch
from torch import Tensor
from torch.nn import Sequential
from torch.nn.functional import log_softmax

from charms_agents.training.job import Arrays
from charms_agents.training.network import OBSERVED
from charms_agents.training.settings import Supervised
from charms_bench.people.samples import Samples
from charms_bench.world.actions import ACTIONS
from charms_bench.world.files import write_atomically


@dataclass(frozen=True)
class Epoch:
    """The network after so many epochs; 0 is before the first.

    What it says of held-out samples is empty where none are held out.
    """

    epoch: int
    loss: float
    """L_total, eq. 11, over all training samples."""
    log_likelihood: float | None
    """Of the labels of held-out samples, mean: sum of y log softmax(Q), natural."""
    agreement: float | None
    """Share of held-out samples in which the action of the highest value is the label's most
    probable one, or one of them where several are."""


class Fit:
    """A network while it learns from samples; the same seed and samples give the same network.

    Args:
        network: Where it starts, and where `Supervised.pull` pulls it. It is trained in place.
        samples: What it learns from; those held out are only measured.
        settings: How it learns.
        seed: Of the order of samples.
    """

    def __init__(
        self, network: Sequential, samples: Samples, settings: Supervised, seed: int
    ) -> None:
        self.network = network
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
    def finished(self) -> bool:
        """Whether all epochs are over."""
        return self.curve[-1].epoch >= self._settings.epochs

    def step(self) -> Epoch:
        """Learns from every training sample once."""
        observations, labels = self._training
        epoch = self.curve[-1].epoch + 1
        order = np.random.default_rng([self._seed, epoch]).permutation(len(labels))
        for rows in torch.split(torch.from_numpy(order), self._settings.batch_size):
            loss = self._loss(observations[rows], labels[rows])
            self._optimizer.zero_grad()
            loss.backward()  # type: ignore[no-untyped-call]  # of torch
            self._optimizer.step()
        self.curve.append(self._measured(epoch))
        return self.curve[-1]

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
        """Everything that further training depends on, as plain arrays."""
        arrays: Arrays = {}
        for name, tensor in self.network.state_dict().items():
            arrays[f"network/{name}"] = tensor.numpy()
        for index, moments in self._optimizer.state_dict()["state"].items():
            for name, tensor in moments.items():
                arrays[f"optimizer/{index}/{name}"] = tensor.numpy()
        arrays["curve"] = np.array(json.dumps([asdict(point) for point in self.curve]))
        return arrays

    def load_arrays(self, arrays: Arrays) -> None:
        """Takes over what `arrays` of an equally made one returned."""
        names = self.network.state_dict()
        self.network.load_state_dict(
            {name: torch.from_numpy(arrays[f"network/{name}"]) for name in names}
        )
        state: dict[int, dict[str, Tensor]] = {}
        for key in (key for key in arrays if key.startswith("optimizer/")):
            _, index, name = key.split("/")
            state.setdefault(int(index), {})[name] = torch.from_numpy(arrays[key])
        groups = self._optimizer.state_dict()["param_groups"]
        self._optimizer.load_state_dict({"state": state, "param_groups": groups})
        self.curve = [Epoch(**point) for point in json.loads(str(arrays["curve"]))]


def divergence(logits: Tensor, labels: Tensor, floor: float) -> Tensor:
    """KL(softmax(logits) || y), the first term of eq. 11, mean over rows.

    It is infinite where a label is 0, so every label is mixed with the uniform distribution until
    none of its probabilities is below `floor`: y (1 - 5 floor) + floor.
    """
    log_p = log_softmax(logits, dim=1)
    floored = labels * (1 - len(ACTIONS) * floor) + floor
    return (log_p.exp() * (log_p - floored.log())).sum(dim=1).mean()


def squared_distance(parameters: Sequence[Tensor], pretrained: Sequence[Tensor]) -> Tensor:
    """||theta - theta_pre||_2^2, the second term of eq. 11 without its weight."""
    return torch.stack(
        [
            (parameter - before).square().sum()
            for parameter, before in zip(parameters, pretrained, strict=True)
        ]
    ).sum()


def log_likelihood(logits: Tensor, labels: Tensor) -> float:
    """Mean of sum y log softmax: of the drivers' actions, where a label is what was done."""
    return float((labels * log_softmax(logits, dim=1)).sum(dim=1).mean())


def agreement(values: Tensor, labels: Tensor) -> float:
    """Share of rows in which the network takes an action that is most probable by the label.

    The network takes the first action of the highest value, as `OnnxPolicy` does.
    """
    taken = torch.from_numpy(values.numpy().argmax(axis=1))[:, None]
    return float((labels.gather(1, taken)[:, 0] == labels.amax(dim=1)).double().mean())


def write_csv(path: Path, curve: list[Epoch]) -> None:
    """One row an epoch."""

    def write(partial: Path) -> None:
        with partial.open("w", newline="", encoding="utf-8") as file:
            rows = csv.DictWriter(file, fieldnames=list(Epoch.__annotations__))
            rows.writeheader()
            rows.writerows(asdict(point) for point in curve)

    write_atomically(path, write)


def write_png(path: Path, curve: list[Epoch], title: str) -> None:
    """Loss and held-out agreement over epochs."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    epochs = [point.epoch for point in curve]
    figure = Figure(figsize=(6.4, 4.8), layout="constrained")
    FigureCanvasAgg(figure)
    above, below = figure.subplots(2, sharex=True)
    above.plot(epochs, [point.loss for point in curve], color="C0")
    above.set(title=title, ylabel="loss")
    agreed = [float("nan") if p.agreement is None else p.agreement for p in curve]
    below.plot(epochs, agreed, color="C2")
    below.set(xlabel="epochs", ylabel="held-out agreement", ylim=(0, 1))
    write_atomically(path, lambda partial: figure.savefig(partial, format="png", dpi=120))
