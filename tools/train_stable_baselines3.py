"""Trains DQN or PPO of Stable-Baselines3 on a stage of a training suite, once per seed.

The networks learn in the scenes, traffics and conditions of the stage, with its reward and its
observation, from episodes with the seeds of its own training. They observe what the stage's network
observes, standardised in the same way, and have its hidden layers. If the stage has a prior, lambda
times the logarithm of the probability that the prior gives the action is added to each reward. The
networks of the traffic and the prior are those in the seed's folder, where the network, its
manifest and its learning curve are written. Finished seeds are not trained again.

    python tools/train_stable_baselines3.py suites/train.yaml efficient_egoistic dqn networks 1010
"""

import argparse
import hashlib
import time
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
import torch
from charms_agents.training.curve import Point, point_of, write_csv
from charms_agents.training.episodes import Episodes
from charms_agents.training.job import reinforcement_job
from charms_agents.training.network_file import read_network, write_manifest
from charms_agents.training.sb3_export import NOT_OBSERVATIONS, export_zip
from charms_agents.training.settings import EPISODES_OF_A_SEED, Stage, TrainingSuite
from charms_agents.training.standardised import folded, standardise, unfolded
from charms_agents.training.suite_file import load_training
from numpy.typing import NDArray
from stable_baselines3 import DQN, PPO
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.vec_env import VecEnv, VecNormalize
from stable_baselines3.common.vec_env.base_vec_env import VecEnvStepReturn
from torch.nn.functional import log_softmax

from charms_bench.envs.sb3 import EpisodesVecEnv
from charms_bench.envs.vector_env import HighwayVectorEnv
from charms_bench.plugins.onnx_policy import OnnxPolicy
from charms_bench.plugins.registry import make_agent
from charms_bench.world.scene import Observations

CHARMS = {  # as CHARMS learns
    "learning_starts": 10_000,
    "batch_size": 256,
    "learning_rate": 5e-4,
    "train_freq": 1,
    "gradient_steps": 25,
    "target_update_interval": 500,
    "tau": 0.1,
    "exploration_final_eps": 0.02,
}
LARGE = {"n_steps": 20, "batch_size": 500}
SETTINGS: dict[str, dict[str, dict[str, Any]]] = {
    "dqn": {
        "default": {"train_freq": 1, "gradient_steps": 125},
        "charms": CHARMS,
        "3-step-returns": {**CHARMS, "n_steps": 3},
        "discount-0.96": {**CHARMS, "n_steps": 3, "gamma": 0.96},
    },
    "ppo": {
        "default": {"scenes": 100, "n_steps": 20},
        "large-batches": LARGE,
        "normalised-rewards": {**LARGE, "normalised_rewards": True},
        "discount-0.96": {**LARGE, "normalised_rewards": True, "gamma": 0.96},
    },
}
"""What differs from the defaults of Stable-Baselines3, by algorithm and trial.

Beside its arguments, `scenes` is the number of episodes side by side, by default `SCENES`, and
`normalised_rewards` says whether rewards are divided by the standard deviation of the return.
"""
DRAWN: dict[str, dict[str, tuple[float, ...]]] = {
    "dqn": {
        "learning_rate": (1e-4, 3e-4, 5e-4, 1e-3),
        "n_steps": (1, 3, 5),
        "gamma": (0.96, 0.99),
        "batch_size": (128, 256),
        "gradient_steps": (12, 25, 50),
        "target_update_interval": (500, 2_000, 5_000),
        "exploration_final_eps": (0.02, 0.05),
    },
    "ppo": {
        "learning_rate": (1e-4, 3e-4, 1e-3),
        "n_steps": (20, 40),
        "batch_size": (250, 500, 1_000),
        "n_epochs": (5, 10),
        "gamma": (0.96, 0.99),
        "gae_lambda": (0.9, 0.95),
        "ent_coef": (0.0, 0.003, 0.01),
        "clip_range": (0.1, 0.2),
    },
}
"""The settings that the trials `drawn-0`, `drawn-1` and following draw, each uniformly."""
CHOSEN = {"dqn": "drawn-18", "ppo": "drawn-4"}
"""The trial with which the networks are trained; docs/training-plan.md says why."""
SCENES = 500
CURVE_STEPS = 25_000
VERSIONS = ("charms-bench", "numba", "numpy", "onnxruntime", "stable_baselines3", "torch")


class Conditions(EpisodesVecEnv):
    """The environments of all conditions as one, with standardised observations."""

    def __init__(self, suite: TrainingSuite, stage: Stage, folder: Path, scenes: int) -> None:
        drivers = {
            name: OnnxPolicy(folder / f"{name}.onnx") if name in suite.names else make_agent(name)
            for name in suite.drivers_of(stage)
        }
        places = suite.places_of(stage)
        environments = [
            HighwayVectorEnv(
                scene,
                scenes // len(places),
                traffic,
                drivers,
                stage.reward_of(suite.weights[stage.weights]),
                suite.first_episode_seed + k * (EPISODES_OF_A_SEED // len(places)),
                suite.observed,
                suite.actions,
            )
            for k, (scene, traffic) in enumerate(places)
        ]
        super().__init__(environments[0])
        self.num_envs, self.drivers = scenes, drivers
        self._side_by_side = Episodes(environments)
        self._prior_weight = suite.hyperparameters_of(stage).prior_weight
        self._prior: torch.nn.Sequential | None = None
        if stage.prior is not None:
            self._prior = unfolded(read_network(folder / f"{stage.prior}.onnx"))

    def reset(self) -> Observations:
        self._seen = _standardised(self._side_by_side.reset())
        return self._seen

    def step_wait(self) -> VecEnvStepReturn:
        costs = self._departures(self._actions)
        step = self._side_by_side.step(self._actions)
        infos: list[dict[str, Any]] = [{} for _ in range(self.num_envs)]
        for row, facts in zip(np.flatnonzero(step.ended), step.facts, strict=True):
            infos[row] = {
                "terminal_observation": _standardised(step.following[row]),
                "TimeLimit.truncated": not step.failed[row],
                "final_info": facts,
            }
        rewards = (step.rewards - costs).astype(np.float32)
        self._seen = _standardised(step.observed)
        return self._seen, rewards, step.ended, infos

    def _departures(self, actions: NDArray[np.int64]) -> NDArray[Any]:
        """(B,) the cost of the actions, which is high if human drivers seldom take them."""
        if self._prior is None:
            return np.zeros(len(actions))
        with torch.no_grad():
            logits = self._prior(torch.from_numpy(self._seen).flatten(1))
        known = log_softmax(logits, -1).numpy()[np.arange(len(actions)), actions]
        return np.asarray(-self._prior_weight * known)


def _standardised(observations: Observations) -> Observations:
    """Observations (..., rows, columns), standardised."""
    flat = standardise(torch.from_numpy(observations).flatten(-2))
    return np.asarray(flat.reshape(observations.shape).numpy())


class Curve(BaseCallback):
    """The learning curve, with a point every `CURVE_STEPS`."""

    def __init__(self) -> None:
        super().__init__()
        self.points: list[Point] = []
        self._ended: list[dict[str, Any]] = []

    def _on_step(self) -> bool:
        self._ended += [info["final_info"] for info in self.locals["infos"] if info]
        if self.num_timesteps // CURVE_STEPS > len(self.points):
            loss = self.model.logger.name_to_value.get("train/loss", float("nan"))
            exploration = getattr(self.model, "exploration_rate", 0.0)
            self.points.append(point_of(self._ended, self.num_timesteps, loss, exploration))
            self._ended = []
        return True


def settings_of(algorithm: str, trial: str) -> dict[str, Any]:
    """What differs from the defaults of Stable-Baselines3 in a trial."""
    if trial in SETTINGS[algorithm]:
        return SETTINGS[algorithm][trial]
    rng = np.random.default_rng(int(trial.removeprefix("drawn-")))
    drawn = {
        name: values[int(rng.integers(len(values)))] for name, values in DRAWN[algorithm].items()
    }
    common = {"dqn": CHARMS, "ppo": {**LARGE, "normalised_rewards": True}}
    return {**common[algorithm], **drawn}


def train(suite: TrainingSuite, name: str, algorithm: str, trial: str, folder: Path) -> None:
    """Trains a network, and writes its `.onnx`, `.csv` and `.json`."""
    stage = suite.stages[name]
    settings = settings_of(algorithm, trial)
    other = ("scenes", "normalised_rewards")
    arguments = {key: value for key, value in settings.items() if key not in other}
    learnt_in = Conditions(suite, stage, folder, settings.get("scenes", SCENES))
    episodes: VecEnv = learnt_in
    if settings.get("normalised_rewards"):
        episodes = VecNormalize(episodes, norm_obs=False, gamma=settings.get("gamma", 0.99))
    layers = {"net_arch": list(suite.hyperparameters_of(stage).hidden_layers)}
    make = {"dqn": DQN, "ppo": PPO}[algorithm]
    model = make(
        "MlpPolicy", episodes, policy_kwargs=layers, seed=suite.seed, device="cpu", **arguments
    )
    curve, began = Curve(), time.process_time()
    model.learn(stage.steps, callback=curve, log_interval=None)
    cpu_s = time.process_time() - began
    _take_plain_observations(model)
    model.save(folder / f"{algorithm}.zip")
    prior = folder / f"{stage.prior}.onnx" if stage.prior else None
    job = reinforcement_job(folder, "", name, suite, learnt_in.drivers, prior)
    facts = {
        "stage": f"{name}, {algorithm}",
        "style": job.style,
        "decision_hz": f"{job.decision_hz:g}",
    }
    network = folder / f"{algorithm}.onnx"
    # VecNormalize divides rewards only; `_take_plain_observations` has standardised the weights.
    given = suite.observed, False, NOT_OBSERVATIONS
    zipped = folder / f"{algorithm}.zip"
    checked = export_zip(zipped, network, facts, *given, actions=job.actions)
    zipped.unlink()
    write_csv(folder / f"{algorithm}.csv", Point, curve.points)
    own = ("hyperparameters", "curve_steps")  # of the suite's learner
    manifest = {
        **{key: value for key, value in job.inputs.items() if key not in own},
        "algorithm": f"{algorithm.upper()} of Stable-Baselines3",
        "trial": trial,
        "settings": {"scenes": learnt_in.num_envs, **settings},
        "onnx_sha256": hashlib.sha256(network.read_bytes()).hexdigest(),
        "export_check": checked,
        "cpu_s": round(cpu_s, 1),
        "versions": {each: version(each) for each in VERSIONS},
    }
    # Written last: from now on, the seed is finished.
    write_manifest(folder / f"{algorithm}.json", manifest)


def _take_plain_observations(model: DQN | PPO) -> None:
    """Changes the network that decides into an equal one for plain observations."""
    policy: Any = model.policy
    network = policy.q_net.q_net if isinstance(model, DQN) else policy.mlp_extractor.policy_net
    network[0].load_state_dict(folded(network)[0].state_dict())


def main() -> None:
    """Trains the seeds that are not finished."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("suite", type=Path)
    parser.add_argument("stage")
    parser.add_argument("algorithm", choices=SETTINGS)
    parser.add_argument("networks", type=Path, help="folder of seed-K/level_1.onnx and the results")
    parser.add_argument("seeds", type=int, nargs="+")
    parser.add_argument("--trial", help="a name in SETTINGS, or drawn-K; by default, as in CHOSEN")
    parser.add_argument("--steps", type=int, help="by default, those of the stage")
    given = parser.parse_args()
    torch.set_num_threads(1)
    for seed in given.seeds:
        folder = given.networks / f"seed-{seed}"
        if not (folder / f"{given.algorithm}.json").exists():
            suite = load_training(given.suite, seed, given.steps)
            trial = given.trial or CHOSEN[given.algorithm]
            train(suite, given.stage, given.algorithm, trial, folder)
            print(f"{folder.name}/{given.algorithm}: finished", flush=True)


if __name__ == "__main__":
    main()
