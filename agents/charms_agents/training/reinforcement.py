"""Reinforcement learning as a learner of a stage: Double DQN in the stage's traffic."""

import json
from collections.abc import Callable
from dataclasses import asdict
from typing import Any

import numpy as np
import torch
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.logger import Logger
from torch.nn import Sequential

from charms_agents.training.curve import LearningCurve, Point
from charms_agents.training.double_dqn import DoubleDQN
from charms_agents.training.job import Arrays, ReinforcementJob
from charms_agents.training.rewards import StyleReward
from charms_agents.training.vec_env import EpisodesVecEnv
from charms_bench.envs.vector_env import EpisodesState, HighwayVectorEnv
from charms_bench.world.scene import Observations


class Reinforcement(BaseCallback):
    """Learns a stage's network by Double DQN, with Stable-Baselines3's loop."""

    point = Point

    def __init__(self, job: ReinforcementJob) -> None:
        super().__init__()
        self._job, self._curve = job, LearningCurve()
        self._episodes = _episodes(job)
        self._agent = _agent(job, self._episodes)
        self._agent.set_logger(Logger(None, []))  # by default it would write a folder
        self._pause: Callable[[], None] = lambda: None

    @property
    def curve(self) -> list[Point]:
        """The points so far, one every `curve_steps`."""
        return self._curve.points

    @property
    def done(self) -> int:
        """Steps so far."""
        return self._agent.num_timesteps

    @property
    def network(self) -> Sequential:
        """The network so far."""
        return self._agent.network

    @property
    def observations(self) -> Observations:
        """The observations in the replay buffer."""
        return self._agent.recorded_observations()

    def learn(self, pause: Callable[[], None]) -> None:
        """Learns until the stage's last step; calls `pause` before each rollout."""
        self._pause, steps = pause, self._job.total
        if self.done < steps:
            self._agent.learn(
                steps - self.done,
                callback=self,
                log_interval=None,  # type: ignore[arg-type]  # which it allows
                reset_num_timesteps=False,
            )
        self._close_point_when_due()

    def _on_rollout_start(self) -> None:
        # Between two rollouts, the arrays of a checkpoint are complete.
        self._close_point_when_due()
        self._pause()

    def _on_step(self) -> bool:
        for info in self.locals["infos"]:
            if info:
                self._curve.add(info["final_info"])
        return True

    def _close_point_when_due(self) -> None:
        last = self.curve[-1].steps if self.curve else 0
        if self.done - last >= self._job.suite.curve_steps:
            self._curve.close(self.done, self._agent.loss, self._agent.exploration_rate)

    def arrays(self) -> Arrays:
        """Everything that further learning depends on, as plain arrays."""
        arrays = self._agent.arrays()
        for name, value in self._episodes.state()._asdict().items():
            arrays[f"episodes/{name}"] = np.asarray(value)
        arrays["curve"] = np.array(json.dumps(self._curve.state()))
        return arrays

    def load_arrays(self, arrays: Arrays) -> None:
        """Takes over what `arrays` returned for the same job."""
        self._curve.restore(json.loads(str(arrays["curve"])))
        self._agent.load_arrays(arrays)
        fields = {name: arrays[f"episodes/{name}"] for name in EpisodesState._fields}
        next_seed = int(fields.pop("next_seed"))
        state = EpisodesState(next_seed=next_seed, **fields)
        self._agent._last_obs = self._episodes.restore(state)
        self._agent._last_episode_starts = np.zeros(self._episodes.num_envs, dtype=np.bool_)

    def results(self) -> dict[str, Any]:
        """What the manifest says of the learning: gradient steps, and points with episodes."""
        points = [point for point in self.curve if point.return_mean is not None]
        curve = {}
        if points:
            best = max(points, key=lambda point: point.return_mean or 0.0)
            chosen = {"first": points[0], "best": best, "last": points[-1]}
            curve = {name: asdict(point) for name, point in chosen.items()}
        return {"gradient_steps": self._agent._n_updates, "curve": curve}


def _episodes(job: ReinforcementJob) -> HighwayVectorEnv[Any]:
    """The environment of a stage."""
    suite, stage = job.suite, job.stage
    reward = StyleReward(
        suite.weights[stage.weights],
        stage.angle_rad,
        stage.safety_horizon_s,
        stage.safe_headway_m,
        stage.lane_change_cost,
    )
    return HighwayVectorEnv(
        stage.scene,
        job.hyperparameters.scenes,
        suite.traffic_of(stage),
        job.drivers,
        reward,
        job.first_episode_seed,
    )


def _agent(job: ReinforcementJob, episodes: HighwayVectorEnv[Any]) -> DoubleDQN:
    """The untrained Double DQN of a stage."""
    h = job.hyperparameters
    return DoubleDQN(
        EpisodesVecEnv(episodes),
        job.suite.seed,
        h.return_steps,
        h.standardised,
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
