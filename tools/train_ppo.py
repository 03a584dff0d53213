"""Trains stock PPO on a stage of a training suite, once per seed, for `suites/seeds.yaml`.

PPO is Stable-Baselines3's with its default hyperparameters, including its own network. Scene,
traffic and reward are those of the stage, which has a single condition, and the observation is
that of the suite. The traffic's networks are those of the suite's run folder. Finished seeds are
not trained again.

    python tools/train_ppo.py suites/train-baselines.yaml prior_level_k RUN networks
"""

import argparse
import csv
import json
import time
from pathlib import Path
from typing import Any

import torch
from charms_agents.training.sb3_export import export_zip
from charms_agents.training.settings import (
    EPISODES_OF_A_SEED,
    FIRST_TRAINING_SEED,
    Stage,
    TrainingSuite,
)
from charms_agents.training.suite_file import load_training
from stable_baselines3 import PPO
from stable_baselines3.common.callbacks import BaseCallback

from charms_bench.envs.sb3 import EpisodesVecEnv
from charms_bench.envs.vector_env import HighwayVectorEnv
from charms_bench.foundation.files import write_bytes
from charms_bench.plugins.onnx_policy import OnnxPolicy
from charms_bench.plugins.registry import make_agent

SCENES = 8


class Curve(BaseCallback):
    """The learning curve: the episodes that ended in every 100,000 steps."""

    def __init__(self) -> None:
        super().__init__()
        self.rows: list[dict[str, Any]] = []
        self._ended: list[dict[str, Any]] = []

    def _on_step(self) -> bool:
        self._ended += [info["final_info"] for info in self.locals["infos"] if info]
        if self.num_timesteps % 100_000 < self.training_env.num_envs and self._ended:
            returns = [each["episode_return"] for each in self._ended]
            crashed = [each["ending"] > 1 for each in self._ended]
            self.rows.append(
                {
                    "steps": self.num_timesteps,
                    "return_mean": sum(returns) / len(returns),
                    "crashed": sum(crashed) / len(crashed),
                }
            )
            self._ended = []
        return True


def train(suite: TrainingSuite, stage: Stage, stage_name: str, trained: Path, output: Path) -> None:
    """Trains with one seed, and writes `ppo.onnx`, `ppo.json` and `ppo.csv`."""
    drivers = {
        name: OnnxPolicy(trained / f"{name}.onnx") if name in suite.names else make_agent(name)
        for name in suite.drivers_of(stage)
    }
    reward = stage.reward_of(suite.weights[stage.weights])
    first_seed = FIRST_TRAINING_SEED + suite.seed * EPISODES_OF_A_SEED
    ((scene, traffic),) = suite.places_of(stage)
    seen = suite.observed
    episodes = HighwayVectorEnv(scene, SCENES, traffic, drivers, reward, first_seed, seen)
    model = PPO("MlpPolicy", EpisodesVecEnv(episodes), seed=suite.seed, device="cpu")
    curve, began = Curve(), time.process_time()
    model.learn(stage.steps, callback=curve)
    cpu_s = time.process_time() - began
    output.mkdir(parents=True, exist_ok=True)
    checkpoint = output / "ppo.zip"
    model.save(checkpoint)
    facts = {"name": "ppo", "seed": str(suite.seed)}
    export_zip(checkpoint, output / "ppo.onnx", facts, suite.observed)
    checkpoint.unlink()
    with (output / "ppo.csv").open("w", newline="") as file:
        writer = csv.DictWriter(file, list(curve.rows[0]))
        writer.writeheader()
        writer.writerows(curve.rows)
    hashes = {name: d.weights_sha256 for name, d in drivers.items() if isinstance(d, OnnxPolicy)}
    manifest = {
        "stage": stage_name,
        "algorithm": "PPO of Stable-Baselines3, default hyperparameters",
        "scenes": SCENES,
        "seed": suite.seed,
        "steps": stage.steps,
        "traffic": hashes,
        "settings": stage.model_dump(mode="json", exclude_defaults=True),
        "cpu_s": round(cpu_s, 1),
    }
    # Last: its presence means finished.
    write_bytes(output / "ppo.json", (json.dumps(manifest, indent=2) + "\n").encode())


def main() -> None:
    """Trains every seed of a suite that is not finished."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("suite", type=Path)
    parser.add_argument("stage")
    parser.add_argument("run", type=Path, help="run folder of the suite")
    parser.add_argument("output", type=Path, help="folder of the networks, seed-K/ppo.onnx")
    parser.add_argument("--seeds", type=int, nargs="*", help="by default, all of the suite")
    parser.add_argument("--steps", type=int, default=2_000_000)
    given = parser.parse_args()
    torch.set_num_threads(1)
    suites = load_training(given.suite).by_seed
    for folder, suite in suites.items():
        finished = (given.output / folder / "ppo.json").exists()
        if not finished and (given.seeds is None or suite.seed in given.seeds):
            trained = given.run / folder / "networks"
            stage = suite.stages[given.stage].model_copy(update={"steps": given.steps})
            train(suite, stage, given.stage, trained, given.output / folder)
            print(f"{folder}/ppo: finished", flush=True)


if __name__ == "__main__":
    main()
