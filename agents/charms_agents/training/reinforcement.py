"""Stages that learn by reinforcement: Double DQN in the stage's traffic."""

import json
from collections.abc import Callable, Mapping
from dataclasses import asdict
from typing import Any

import numpy as np
import torch
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.logger import Logger
from torch.nn import Sequential

from charms_agents.training.curve import Point, point_of
from charms_agents.training.double_dqn import DoubleDQN
from charms_agents.training.network import Arrays
from charms_agents.training.settings import Stage, TrainingSuite
from charms_agents.training.validation import Keeper
from charms_bench.engine.state_file import check_state
from charms_bench.envs.sb3 import EpisodesVecEnv
from charms_bench.envs.vector_env import EpisodesState, HighwayVectorEnv
from charms_bench.plugins.agent import Agent
from charms_bench.world.scene import Observations


class Reinforcement(BaseCallback):
    """Learns a stage's network by Double DQN, with Stable-Baselines3's loop.

    Args:
        suite: The suite.
        stage: The stage.
        drivers: The agents that drive the traffic, by name.
        first_seed: Seed of the first episode; each further episode adds 1.
    """

    point = Point

    def __init__(
        self, suite: TrainingSuite, stage: Stage, drivers: Mapping[str, Agent], first_seed: int
    ) -> None:
        super().__init__()
        self._steps, self._curve_steps = stage.steps, suite.curve_steps
        self.curve: list[Point] = []
        """The points so far, one every `curve_steps`."""
        self._ended: list[dict[str, Any]] = []
        reward = stage.reward(suite.weights[stage.weights])
        h, traffic = suite.hyperparameters_of(stage), suite.traffic_of(stage)
        self._episodes = HighwayVectorEnv(
            stage.scene, h.scenes, traffic, drivers, reward, first_seed, suite.observed
        )
        self._agent = DoubleDQN(
            EpisodesVecEnv(self._episodes),
            suite.seed,
            h.return_steps,
            h.standardised,
            h.starts_at_mean_reward,
            learning_rate=h.learning_rate_at,
            buffer_size=h.replay_buffer,
            learning_starts=h.learning_starts,
            batch_size=h.batch_size,
            gamma=h.discount,
            train_freq=(1, "step"),  # one step of every scene, so `scenes` steps
            gradient_steps=h.scenes // h.steps_per_gradient_step,
            target_update_interval=h.target_update_steps,
            tau=h.target_update_rate,
            exploration_initial_eps=h.exploration_initial,
            exploration_final_eps=h.exploration_final,
            exploration_fraction=h.exploration_share,
            max_grad_norm=h.max_gradient_norm,
            policy_kwargs={
                "net_arch": list(h.hidden_layers),
                "optimizer_class": torch.optim.Adam,
                "optimizer_kwargs": {"fused": True},
            },
            device="cpu",
        )
        self._agent.set_logger(Logger(None, []))  # by default it would write a folder
        self._keeper = stage.validation and Keeper(
            stage.validation, stage.scene, stage.steps, suite.observed
        )
        self._pause: Callable[[], None] = lambda: None

    @property
    def done(self) -> int:
        """Steps so far."""
        return self._agent.num_timesteps

    @property
    def network(self) -> Sequential:
        """The network that is kept if the training ends now."""
        kept = self._keeper.network if self._keeper else None
        return kept or self._agent.network

    @property
    def observations(self) -> Observations:
        """The observations in the replay buffer."""
        buffer = self._agent.replay_buffer
        observations: Observations = buffer.observations[: buffer.size()]
        return observations.reshape(-1, 7, 5)

    def learn(self, pause: Callable[[], None]) -> None:
        """Learns until the stage's last step; calls `pause` before each rollout."""
        self._pause = pause
        if self.done < self._steps:
            self._agent.learn(
                self._steps - self.done,
                callback=self,
                log_interval=None,  # type: ignore[arg-type]  # which it allows
                reset_num_timesteps=False,
            )
        self._measure()

    def _on_rollout_start(self) -> None:
        # Between two rollouts, the arrays of a checkpoint are complete.
        self._measure()
        self._pause()

    def _on_step(self) -> bool:
        for info in self.locals["infos"]:
            if info:
                self._ended.append(info["final_info"])
        return True

    def _measure(self) -> None:
        """Adds a point to the curve and validates the network, if either is due."""
        last = self.curve[-1].steps if self.curve else 0
        if self.done - last >= self._curve_steps:
            agent = self._agent
            self.curve.append(point_of(self._ended, self.done, agent.loss, agent.exploration_rate))
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
        self._agent._last_obs = self._episodes.set_state(state)
        self._agent._last_episode_starts = np.zeros(self._episodes.num_envs, dtype=np.bool_)

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
            "gradient_steps": self._agent._n_updates,
            "curve": curve,
            **({"kept": kept and asdict(kept)} if self._keeper else {}),
            "steps_per_s": round(self.done / wall_s, 1),
        }
