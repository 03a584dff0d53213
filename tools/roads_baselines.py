"""DQN and PPO of Stable-Baselines3 where CHARMS for all roads learns, for one style.

They have CHARMS's scenes, traffic, observation, actions, reward, prior and steps. Lambda times the
logarithm of the probability that the prior gives an action is added to its reward, as for CHARMS.
"""

import json
import time
from hashlib import sha256
from pathlib import Path
from typing import Any

import numpy as np
import torch
from charms_agents.training.episodes import Episodes
from charms_agents.training.network_file import read_network
from charms_agents.training.own_traffic import OwnTraffic
from charms_agents.training.reinforcement import environments_of
from charms_agents.training.sb3_export import NOT_OBSERVATIONS, export_zip
from charms_agents.training.suite_file import load_training
from numpy.typing import NDArray
from stable_baselines3 import DQN, PPO
from stable_baselines3.common.vec_env import VecEnv, VecNormalize
from stable_baselines3.common.vec_env.base_vec_env import VecEnvStepReturn
from torch.nn.functional import log_softmax

from charms_bench.envs.sb3 import EpisodesVecEnv
from charms_bench.envs.vector_env import HighwayVectorEnv
from charms_bench.plugins.agent import Agent
from charms_bench.plugins.onnx_policy import OnnxPolicy
from charms_bench.plugins.registry import make_agent
from charms_bench.world.scene import Observations

FIRST: dict[str, dict[str, Any]] = {
    "DQN": {
        "learning_rate": 1e-3, "n_steps": 3, "gamma": 0.99, "batch_size": 256, "gradient_steps": 50,
        "target_update_interval": 500, "exploration_final_eps": 0.02,
    },
    "PPO": {
        "learning_rate": 1e-3, "n_steps": 40, "batch_size": 1_000, "n_epochs": 10, "gamma": 0.99,
        "gae_lambda": 0.95, "ent_coef": 0.01, "clip_range": 0.1,
    },
}  # fmt: skip
"""The settings of the first trial: those that the plan on the straight road chose of 26 trials each
(docs/training-plan.md), with CHARMS's discount."""
DRAWN: dict[str, dict[str, tuple[float, ...]]] = {
    "DQN": {
        "learning_rate": (1e-4, 3e-4, 5e-4, 1e-3),
        "n_steps": (1, 3, 5),
        "gamma": (0.98, 0.99),
        "batch_size": (128, 256),
        "gradient_steps": (25, 50, 100),
        "target_update_interval": (500, 2_000, 5_000),
        "exploration_final_eps": (0.02, 0.05),
    },
    "PPO": {
        "learning_rate": (1e-4, 3e-4, 1e-3),
        "n_steps": (20, 40),
        "batch_size": (250, 500, 1_000),
        "n_epochs": (5, 10),
        "gamma": (0.98, 0.99),
        "gae_lambda": (0.9, 0.95),
        "ent_coef": (0.0, 0.003, 0.01),
        "clip_range": (0.1, 0.2),
    },
}
"""The settings that the other trials draw, each uniformly."""
ALGORITHMS = {"DQN": (DQN, 640), "PPO": (PPO, 120)}
"""The algorithms, and their scenes side by side."""


def settings_of(algorithm: str, trial: int) -> dict[str, Any]:
    """What differs from the defaults of Stable-Baselines3 in a trial."""
    found, rng = FIRST[algorithm], np.random.default_rng(trial)
    if trial:
        found = {
            name: values[rng.integers(len(values))] for name, values in DRAWN[algorithm].items()
        }
    always = {"train_freq": 1, "tau": 0.1, "learning_starts": 10_000} if algorithm == "DQN" else {}
    return {**found, **always}


class Learner:
    """A model of Stable-Baselines3 as what `OwnTraffic` asks."""

    prior = None

    def __init__(self, model: Any) -> None:
        self._model = model

    @torch.no_grad()
    def preferences(self, observations: Observations, given: torch.Tensor) -> NDArray[np.float32]:
        """The values, or the logits (M, A), of the actions."""
        seen = torch.from_numpy(observations)
        if isinstance(self._model, DQN):
            return np.asarray(self._model.q_net(seen).numpy())
        return np.asarray(self._model.policy.get_distribution(seen).distribution.logits.numpy())


class Conditions(EpisodesVecEnv):
    """The environments of all conditions of a stage as one, whose rewards include the prior's."""

    def __init__(
        self, environments: list[HighwayVectorEnv[Any]], prior: Path, weight: float
    ) -> None:
        super().__init__(environments[0])
        self.num_envs = sum(each.num_envs for each in environments)
        self._side_by_side, self._weight = Episodes(environments), weight
        self._prior = read_network(prior)

    def reset(self) -> Observations:
        self._seen = self._side_by_side.reset()
        return self._seen

    def step_wait(self) -> VecEnvStepReturn:
        with torch.no_grad():
            logits = self._prior(torch.from_numpy(self._seen).flatten(1))
        known = log_softmax(logits, -1).numpy()[np.arange(self.num_envs), self._actions]
        step = self._side_by_side.step(self._actions)
        infos: list[dict[str, Any]] = [{} for _ in range(self.num_envs)]
        for row in np.flatnonzero(step.ended):
            infos[row] = {
                "terminal_observation": step.following[row],
                "TimeLimit.truncated": not step.failed[row],
            }
        self._seen = step.observed
        rewards = (step.rewards + self._weight * known).astype(np.float32)
        return self._seen, rewards, step.ended, infos


def train_baseline(
    file: Path, algorithm: str, trial: int, steps: int, among: Path, output: Path
) -> None:
    """Trains the stage `roads` of a suite by an algorithm, and writes OUTPUT.onnx and .json.

    `among` is the folder of the networks of its Level-1 and its prior.
    """
    if output.with_suffix(".json").exists():
        return
    torch.set_num_threads(1)
    suite, began = load_training(file), time.process_time()
    (make, scenes), arguments = ALGORITHMS[algorithm], settings_of(algorithm, trial)
    few = suite.hyperparameters.model_copy(update={"scenes": scenes})
    suite, stage = suite.model_copy(update={"hyperparameters": few}), suite.stages["roads"]
    own = OwnTraffic(
        suite.observed, suite.actions_in(stage.scene), np.zeros((1, 0), dtype=np.float32)
    )
    drivers: dict[str, Agent] = {"roads": own}
    for name in suite.drivers_of(stage):
        if name != "roads":
            is_stage = name in suite.names
            drivers[name] = OnnxPolicy(among / f"{name}.onnx") if is_stage else make_agent(name)
    prior = among / f"{stage.prior}.onnx"
    environments = environments_of(suite, stage, drivers)
    episodes: VecEnv = Conditions(environments, prior, few.prior_weight)
    if make is PPO:
        episodes = VecNormalize(episodes, norm_obs=False, gamma=arguments["gamma"])
    layers = {"net_arch": list(few.hidden_layers)}
    how = {"policy_kwargs": layers, "seed": suite.seed, "device": "cpu"}
    model = make("MlpPolicy", episodes, **how, **arguments)
    own.learner = Learner(model)
    model.learn(steps, log_interval=None)
    cpu_s = time.process_time() - began
    zipped, network = output.with_suffix(".zip"), output.with_suffix(".onnx")
    output.parent.mkdir(parents=True, exist_ok=True)
    model.save(zipped)
    facts = {"stage": f"roads, {algorithm}", "decision_hz": f"{stage.scene.decision_hz:g}"}
    given = suite.observed, False, NOT_OBSERVATIONS
    export_zip(zipped, network, facts, *given, actions=suite.actions)
    manifest = {"cpu_s": cpu_s, "onnx_sha256": sha256(network.read_bytes()).hexdigest()}
    output.with_suffix(".json").write_text(json.dumps(manifest), encoding="utf-8")
