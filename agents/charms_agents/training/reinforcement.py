"""Stages that learn by reinforcement: Double DQN in the stage's traffic."""

import json
from collections.abc import Callable, Mapping
from dataclasses import asdict
from typing import Any

import numpy as np
from torch.nn import Sequential

from charms_agents.training.curve import Point, point_of
from charms_agents.training.double_dqn import DoubleDQN
from charms_agents.training.network import Arrays
from charms_agents.training.settings import Stage, TrainingSuite
from charms_agents.training.validation import Keeper
from charms_bench.engine.state_file import check_state
from charms_bench.envs.vector_env import EpisodesState, HighwayVectorEnv
from charms_bench.plugins.agent import Agent
from charms_bench.world.scene import Observations


class Reinforcement:
    """Learns a stage's network by Double DQN among `drivers`; episodes have successive seeds."""

    point = Point

    def __init__(
        self, suite: TrainingSuite, stage: Stage, drivers: Mapping[str, Agent], first_seed: int
    ) -> None:
        self._steps, self._curve_steps = stage.steps, suite.curve_steps
        self.curve: list[Point] = []
        """The points so far, one every `curve_steps`."""
        self._ended: list[dict[str, Any]] = []
        reward = stage.reward(suite.weights[stage.weights])
        h, traffic = suite.hyperparameters_of(stage), suite.traffic_of(stage)
        self._episodes = HighwayVectorEnv(
            stage.scene, h.scenes, traffic, drivers, reward, first_seed, suite.observed
        )
        self._agent = DoubleDQN(self._episodes, h, suite.seed, stage.steps)
        self._keeper = stage.validation and Keeper(
            stage.validation, stage.scene, stage.steps, suite.observed
        )

    @property
    def done(self) -> int:
        return self._agent.steps

    @property
    def network(self) -> Sequential:
        """The network that is kept if the training ends now."""
        return (self._keeper and self._keeper.network) or self._agent.network

    @property
    def observations(self) -> Observations:
        """The observations in the replay buffer."""
        return self._agent.remembered["observations"].reshape(-1, 7, 5)

    def learn(self, pause: Callable[[], None]) -> None:
        """Learns until the stage's last step; calls `pause` before each step."""
        while self.done < self._steps:
            self._measure()
            pause()
            self._ended += self._agent.step()
        self._measure()

    def _measure(self) -> None:
        """Adds a point to the curve and validates the network, if either is due."""
        last = self.curve[-1].steps if self.curve else 0
        if self.done - last >= self._curve_steps:
            agent = self._agent
            self.curve.append(point_of(self._ended, self.done, agent.loss, agent.exploration))
            self._ended = []
        if self._keeper and self._keeper.due(self.done):
            self._keeper.show(self._agent.network, self.done)

    def arrays(self) -> Arrays:
        """Everything that further learning depends on, as plain arrays."""
        arrays = self._agent.arrays() | (self._keeper.arrays() if self._keeper else {})
        episodes = self._episodes.get_state()
        arrays["episodes/next_seed"] = np.array(episodes.next_seed)
        arrays["episodes/returns"] = episodes.returns
        for name, array in episodes.scenes.arrays().items():
            arrays[f"scenes/{name}"] = array
        curve = {"points": [asdict(point) for point in self.curve], "ended": self._ended}
        arrays["curve"] = np.array(json.dumps(curve))
        return arrays

    def load_arrays(self, arrays: Arrays) -> None:
        """Takes over what `arrays` returned for the same job."""
        curve = json.loads(str(arrays["curve"]))
        self.curve, self._ended = [Point(**point) for point in curve["points"]], curve["ended"]
        self._agent.load_arrays(arrays)
        if self._keeper:
            self._keeper.load_arrays(arrays)
        own = self._episodes.get_state().scenes
        scenes = own.with_arrays({name: arrays[f"scenes/{name}"] for name in own.arrays()})
        check_state(scenes)
        state = EpisodesState(scenes, arrays["episodes/returns"], int(arrays["episodes/next_seed"]))
        self._agent.observed = self._episodes.set_state(state)

    def results(self, wall_s: float) -> dict[str, Any]:
        """What the manifest says of the learning: gradient steps, points and speed."""
        points = [point for point in self.curve if point.return_mean is not None]
        curve = {}
        if points:
            best = max(points, key=lambda point: point.return_mean or 0.0)
            chosen = {"first": points[0], "best": best, "last": points[-1]}
            curve = {name: asdict(point) for name, point in chosen.items()}
        kept = self._keeper and self._keeper.kept
        return {
            "gradient_steps": self._agent.gradient_steps,
            "curve": curve,
            **({"kept": kept and asdict(kept)} if self._keeper else {}),
            "steps_per_s": round(self.done / wall_s, 1),
        }
