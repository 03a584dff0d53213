"""Stages that learn by reinforcement: Double DQN in the stage's scenes and traffic."""

import json
from collections.abc import Callable, Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
from torch.nn import Sequential

from charms_agents.training.curve import Point, point_of
from charms_agents.training.double_dqn import DoubleDQN
from charms_agents.training.episodes import Episodes
from charms_agents.training.network import Arrays
from charms_agents.training.network_file import read_network
from charms_agents.training.own_traffic import OwnTraffic
from charms_agents.training.settings import EPISODES_OF_A_SEED, Stage, TrainingSuite
from charms_agents.training.standardisation import unfolded
from charms_bench.envs.vector_env import HighwayVectorEnv
from charms_bench.plugins.agent import Agent
from charms_bench.world.scene import Observations


def environments_of(
    suite: TrainingSuite, stage: Stage, drivers: Mapping[str, Agent]
) -> list[HighwayVectorEnv[Any]]:
    """The environments of a stage, one for each of its places, with `scenes` episodes in all."""
    places, seed = suite.places_of(stage), suite.first_episode_seed
    count = suite.hyperparameters.scenes // len(places)
    apart = EPISODES_OF_A_SEED // len(places)
    how = stage.reward_of(suite.weights), suite.observed, suite.actions
    return [
        HighwayVectorEnv(scene, count, traffic, drivers, how[0], seed + k * apart, *how[1:])
        for k, (scene, traffic) in enumerate(places)
    ]


class Reinforcement:
    """Learns a stage's network by Double DQN among `drivers`; episodes have successive seeds."""

    point = Point

    def __init__(
        self,
        suite: TrainingSuite,
        stage: Stage,
        drivers: Mapping[str, Agent],
        prior: Path | None,
    ) -> None:
        self._steps, self._curve_steps = stage.steps, suite.curve_steps
        self.curve: list[Point] = []
        """The points so far, one every `curve_steps`."""
        self._ended: list[dict[str, Any]] = []
        h, styles = suite.hyperparameters, [*suite.styles_of(stage).values()] or [()]
        given = np.array(styles, np.float32)
        self.own_traffic = OwnTraffic(suite.observed, suite.actions_in(stage.scene), given)
        drivers = {**drivers, suite.name_of(stage): self.own_traffic}
        self._episodes = Episodes(environments_of(suite, stage, drivers))
        logits = None if prior is None else unfolded(read_network(prior))
        given = np.tile(given, (h.scenes // len(given), 1))
        how = suite.seed, stage.steps, logits, len(suite.actions), given
        self.own_traffic.learner = self._agent = DoubleDQN(self._episodes, h, *how)

    @property
    def done(self) -> int:
        return self._agent.steps

    @property
    def network(self) -> Sequential:
        """The network that is kept if the training ends now."""
        return self._agent.network

    @property
    def observations(self) -> Observations:
        """The observations in the replay buffer."""
        observed = self._agent.remembered["observations"]
        return observed.reshape(-1, *observed.shape[2:])

    def learn(self, pause: Callable[[], None]) -> None:
        """Learns until the stage's last step; calls `pause` before each step."""
        while self.done < self._steps:
            self._measure()
            pause()
            self._ended += self._agent.step()
        self._measure()

    def _measure(self) -> None:
        """Adds a point to the curve, if one is due."""
        last = self.curve[-1].steps if self.curve else 0
        if self.done - last >= self._curve_steps:
            agent = self._agent
            self.curve.append(point_of(self._ended, self.done, agent.loss, agent.exploration))
            self._ended = []

    def arrays(self) -> Arrays:
        """Everything that further learning depends on, as plain arrays."""
        arrays = self._agent.arrays() | self._episodes.arrays()
        curve = {"points": [asdict(point) for point in self.curve], "ended": self._ended}
        arrays["curve"] = np.array(json.dumps(curve))
        return arrays

    def load_arrays(self, arrays: Arrays) -> None:
        """Takes over what `arrays` returned for the same job."""
        curve = json.loads(str(arrays["curve"]))
        self.curve, self._ended = [Point(**point) for point in curve["points"]], curve["ended"]
        self._agent.load_arrays(arrays)
        self._agent.observed = self._episodes.load_arrays(arrays)

    def results(self, wall_s: float) -> dict[str, Any]:
        """What the manifest says of the learning: gradient steps, points and speed."""
        points = [point for point in self.curve if point.return_mean is not None]
        curve = {}
        if points:
            best = max(points, key=lambda point: point.return_mean or 0.0)
            chosen = {"first": points[0], "best": best, "last": points[-1]}
            curve = {name: asdict(point) for name, point in chosen.items()}
        return {
            "gradient_steps": self._agent.gradient_steps,
            "curve": curve,
            "steps_per_s": round(self.done / wall_s, 1),
        }
