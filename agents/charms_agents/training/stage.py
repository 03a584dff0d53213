"""Training one network: from settings to a finished folder, through checkpoints."""

import json
import time
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
import torch
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.logger import configure

from charms_agents.training.curve import LearningCurve, Point
from charms_agents.training.double_dqn import DoubleDQN
from charms_agents.training.export import export
from charms_agents.training.job import Arrays, Job, StageFolder
from charms_agents.training.manifest import write_manifest
from charms_agents.training.rewards import StyleReward
from charms_agents.training.vec_env import EpisodesVecEnv
from charms_bench.envs.vector_env import EpisodesState, HighwayVectorEnv
from charms_bench.errors import RunFolderError
from charms_bench.plugins.agent import Policy


class Interrupted(Exception):
    """The training was asked to stop, and has written a checkpoint."""


class Training(BaseCallback):
    """What surrounds the learning of a stage: curve, logs and checkpoints.

    Between two rollouts nothing is under way, so that is when checkpoints are written. When they
    are written changes nothing about what is learnt.

    Args:
        job: The stage.
        folder: Where it is kept.
        report: Called with the steps so far and, at every point of the curve, that point.
        stop: Whether to write a checkpoint and stop.
    """

    def __init__(
        self,
        job: Job,
        folder: StageFolder,
        report: Callable[[int, Point | None], None],
        stop: Callable[[], bool],
    ) -> None:
        super().__init__()
        self.curve = LearningCurve()
        self.wall_s = 0.0
        self._job, self._folder, self._report, self._stop = job, folder, report, stop
        self._tick = self._last_checkpoint = time.monotonic()
        self._agent = make_model(job)
        stored = folder.read_checkpoint()
        if stored is not None:
            self._restore(stored)
        self._agent.set_logger(configure(str(folder.tensorboard), ["tensorboard"]))

    def train(self) -> DoubleDQN:
        """Goes on to the stage's last step.

        Raises:
            Interrupted: `stop` said so.
        """
        self._tick = self._last_checkpoint = time.monotonic()
        agent, steps = self._agent, self._job.stage.steps
        if agent.num_timesteps < steps:
            agent.learn(
                steps - agent.num_timesteps,
                callback=self,
                log_interval=None,  # type: ignore[arg-type]  # which it allows
                reset_num_timesteps=False,
            )
            self._close_point_when_due()
            self._write_checkpoint()
        agent.logger.close()
        return agent

    def _on_rollout_start(self) -> None:
        self._close_point_when_due()
        if self._stop():
            self._write_checkpoint()
            self._agent.logger.close()
            raise Interrupted
        if time.monotonic() - self._last_checkpoint >= self._job.suite.checkpoint_s:
            self._write_checkpoint()

    def _on_step(self) -> bool:
        for info in self.locals["infos"]:
            if info:
                self.curve.add(info["final_info"])
        return True

    def _close_point_when_due(self) -> None:
        agent, last = self._agent, self.curve.points[-1].steps if self.curve.points else 0
        if agent.num_timesteps - last < self._job.suite.curve_steps:
            self._report(agent.num_timesteps, None)
            return
        point = self.curve.close(agent.num_timesteps, agent.loss, agent.exploration_rate)
        for name, value in asdict(point).items():
            if name != "steps" and value is not None:
                agent.logger.record(f"charms/{name}", value)
        agent.logger.dump(agent.num_timesteps)
        self._report(agent.num_timesteps, point)

    def _write_checkpoint(self) -> None:
        now = time.monotonic()
        self.wall_s += now - self._tick
        self._tick = self._last_checkpoint = now
        arrays = self._agent.arrays()
        episodes = _episodes(self._agent).state()
        for name, value in episodes._asdict().items():
            arrays[f"episodes/{name}"] = np.asarray(value)
        progress = {"key": self._job.key, "wall_s": self.wall_s, "curve": self.curve.state()}
        arrays["progress"] = np.array(json.dumps(progress))
        self._folder.write_checkpoint(arrays)
        self.curve.write_csv(self._folder.curve_csv)

    def _restore(self, arrays: Arrays) -> None:
        try:
            progress = json.loads(str(arrays["progress"]))
            if progress["key"] != self._job.key:
                raise ValueError("it is that of other settings")
            self.wall_s = progress["wall_s"]
            self.curve.restore(progress["curve"])
            self._agent.load_arrays(arrays)
            fields = {name: arrays[f"episodes/{name}"] for name in EpisodesState._fields}
            next_seed = int(fields.pop("next_seed"))
            state = EpisodesState(next_seed=next_seed, **fields)
            self._agent._last_obs = _episodes(self._agent).restore(state)
        except (KeyError, ValueError, TypeError, RuntimeError) as error:
            raise RunFolderError(
                f"{self._folder.checkpoint}: cannot be continued: {error}; "
                "delete it to begin this stage anew"
            ) from error
        scenes = self._job.hyperparameters.scenes
        self._agent._last_episode_starts = np.zeros(scenes, dtype=np.bool_)


def make_model(job: Job) -> DoubleDQN:
    """The untrained network of a stage, in its environment."""
    h, suite, stage = job.hyperparameters, job.suite, job.stage
    episodes = HighwayVectorEnv(
        stage.scene,
        h.scenes,
        suite.traffic_of(stage),
        job.drivers,
        StyleReward(
            suite.weights[stage.weights],
            stage.angle_rad,
            stage.safety_horizon_s,
            stage.safe_headway_m,
            stage.lane_change_cost,
        ),
        job.first_episode_seed,
    )
    return DoubleDQN(
        EpisodesVecEnv(episodes),
        suite.seed,
        h.return_steps,
        h.standardised,
        learning_rate=h.learning_rate_at,
        buffer_size=h.replay_buffer,
        learning_starts=h.learning_starts,
        batch_size=h.batch_size,
        gamma=h.discount,
        train_freq=(1, "step"),  # of all scenes together: `scenes` steps
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


def _episodes(agent: DoubleDQN) -> HighwayVectorEnv[Any]:
    environment = agent.get_env()
    assert isinstance(environment, EpisodesVecEnv)
    return environment.episodes


def train_stage(
    job: Job,
    output: Path,
    suite_sha256: str,
    report: Callable[[int, Point | None], None],
    stop: Callable[[], bool],
) -> StageFolder:
    """Trains a stage, or goes on with it, and writes its network; a finished one is left alone.

    Raises:
        Interrupted: `stop` said so; the folder holds a checkpoint.
        RunFolderError: The folder cannot be read, written or continued.
    """
    folder = StageFolder(output, job)
    if folder.finished:
        return folder
    for partial in folder.path.glob(".*.partial"):
        partial.unlink(missing_ok=True)  # of a training that was killed while it wrote
    torch.set_num_threads(1)
    training = Training(job, folder, report, stop)
    agent = training.train()
    facts = {"stage": job.name, "style": job.style, "decision_hz": f"{Policy.decision_hz:g}"}
    checked = export(agent.network, folder.network, facts, agent.recorded_observations())
    training.curve.write_csv(folder.curve_csv)
    training.curve.write_png(folder.curve_png, f"{job.name} ({job.style})")
    results = {
        "export_check": checked,
        "gradient_steps": agent._n_updates,
        "curve": _summary(training.curve),
        "wall_s": round(training.wall_s, 1),
        "steps_per_s": round(job.stage.steps / training.wall_s, 1),
    }
    write_manifest(folder, job, suite_sha256, results)
    return folder


def _summary(curve: LearningCurve) -> dict[str, Any]:
    """First, best and last point with episodes."""
    points = [point for point in curve.points if point.return_mean is not None]
    if not points:
        return {}
    best = max(points, key=lambda point: point.return_mean or 0.0)
    return {"first": asdict(points[0]), "best": asdict(best), "last": asdict(points[-1])}
