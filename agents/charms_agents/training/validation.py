"""Validation: which of the networks at the end of a training is kept."""

import json
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from torch.nn import Sequential

from charms_agents.training.network import Arrays, Layers, layers_of, network_of
from charms_agents.training.own_driving import drive
from charms_agents.training.settings import FIRST_VALIDATION_SEED, Validation
from charms_bench.engine.simulation import Simulation
from charms_bench.metrics import PAPER, STANDARD, sums_by_episode
from charms_bench.plugins.registry import make_agent
from charms_bench.recording.recording import Recording
from charms_bench.world.observations import Neighbours, neighbours
from charms_bench.world.scene import SceneSettings

MEASURED = ("speed_mean", "ttc_below_3s", "crashed_episodes")
METRICS = {each.name: each for each in (*STANDARD.metrics, *PAPER.metrics) if each.name in MEASURED}


@dataclass(frozen=True)
class Validated:
    """How a network drove the ego of the validation episodes; the metrics have the same names."""

    steps: int
    """Steps that the network had learnt from."""
    speed_mean: float
    ttc_below_3s: float
    crashed_episodes: float


class Keeper:
    """Keeps the best of the networks that it is shown in a training of `total` steps."""

    def __init__(
        self,
        rule: Validation,
        scene: SceneSettings,
        total: int,
        observation: Neighbours = neighbours,
    ) -> None:
        self._rule, self._scene, self._observation = rule, scene, observation
        self._from = total - rule.last_steps
        self._traffic = rule.traffic.make()
        self._drivers = {name: make_agent(name) for name in self._traffic.agents}
        self._layers: Layers = []
        self.kept: Validated | None = None
        """The best network so far; None if there was none yet."""

    @property
    def network(self) -> Sequential | None:
        """The best network so far, which takes plain observations."""
        return network_of(self._layers) if self.kept else None

    def due(self, steps: int) -> bool:
        """Whether the network after this number of steps is to be shown."""
        return steps > self._from and (steps - self._from) % self._rule.every_steps == 0

    def show(self, network: Sequential, steps: int) -> None:
        """Validates a network that takes plain observations, and keeps it if it is the best."""
        found = self._validated(network, steps)
        if self.kept is None or self._rank(found) > self._rank(self.kept):
            self.kept = found
            self._layers = [(weight.copy(), bias.copy()) for weight, bias in layers_of(network)]

    def _rank(self, found: Validated) -> tuple[float, float, float]:
        """The better of two networks has the larger rank; see `Validation`."""
        crashed = max(found.crashed_episodes, self._rule.crashed_episodes)
        short = max(found.ttc_below_3s, self._rule.ttc_below_3s)
        return (-crashed, -short, found.speed_mean)

    def _validated(self, network: Sequential, steps: int) -> Validated:
        count, first = self._rule.episodes, FIRST_VALIDATION_SEED
        simulation = Simulation(self._scene, count, None, self._traffic, self._drivers)
        simulation.reset(np.arange(first, first + count, dtype=np.uint64))
        recording = Recording(simulation)
        for _ in drive(network, simulation, observation=self._observation):
            recording.note()
        metrics = [METRICS[name] for name in MEASURED]
        sums = sums_by_episode(metrics, recording.episodes(), recording.steps(), self._scene)
        totals = [each.sum(axis=0) for each in sums]
        values = (float(m.value(each)) for m, each in zip(metrics, totals, strict=True))
        return Validated(steps, *values)

    def arrays(self) -> Arrays:
        """The best network so far, as plain arrays."""
        arrays: Arrays = {"kept": np.array(json.dumps(self.kept and asdict(self.kept)))}
        for index, (weight, bias) in enumerate(self._layers):
            arrays |= {f"kept/{index}/weight": weight, f"kept/{index}/bias": bias}
        return arrays

    def load_arrays(self, arrays: Arrays) -> None:
        """Takes over what `arrays` returned for the same training."""
        kept: dict[str, Any] | None = json.loads(str(arrays["kept"]))
        self.kept = Validated(**kept) if kept else None
        pairs = range(sum(name.startswith("kept/") for name in arrays) // 2)
        self._layers = [(arrays[f"kept/{i}/weight"], arrays[f"kept/{i}/bias"]) for i in pairs]
