"""A DQN of stock `highway-v0` takes here, step for step, the actions that it takes there."""

import re
from pathlib import Path
from typing import Any

import gymnasium
import highway_env  # noqa: F401  # registers highway-v0
import numpy as np
import pytest
import stable_baselines3 as sb3
import torch
from charms_agents.training.sb3_export import export_zip

from charms_bench.engine import MakeEngine
from charms_bench.engine.endings import RUNNING, TIME
from charms_bench.engine.simulation import Simulation
from charms_bench.plugins.onnx_policy import OnnxPolicy
from charms_bench.plugins.registry import make_agent
from charms_bench.plugins.traffic import OneAgent
from charms_bench.runs.suite import load_suite
from charms_bench.testing.reference_engine import ENGINES
from charms_bench.world.kinematics_observation import Kinematics
from charms_bench.world.profile import PROFILES
from charms_bench.world.scene import SceneSettings

EXAMPLE: dict[str, Any] = {
    "policy_kwargs": {"net_arch": [256, 256]},
    "learning_rate": 5e-4,
    "buffer_size": 15000,
    "learning_starts": 200,
    "batch_size": 32,
    "gamma": 0.8,
    "train_freq": 1,
    "gradient_steps": 1,
    "target_update_interval": 50,
}
"""The DQN of highway-env's documentation."""
GUIDE = Path(__file__).parents[2] / "docs" / "environments.md"
STOCK = {"lanes": 4, "traffic_vehicles": 50, "duration_s": 40.0}
SMALL = {"lanes": 3, "traffic_vehicles": 12, "duration_s": 12.0}

Episode = tuple[list[int], bool]
"""The actions of an ego, and whether it crashed after them."""


def stock(lanes: int, traffic_vehicles: int, duration_s: float) -> gymnasium.Env[Any, Any]:
    config = {
        "lanes_count": lanes,
        "vehicles_count": traffic_vehicles,
        "duration": duration_s,
    }
    return gymnasium.make("highway-v0", config=config)


def there(model: Any, seed: int, **scene: Any) -> Episode:
    """An episode in highway-env, driven by the model that was trained."""
    environment = stock(**scene)
    observation, _ = environment.reset(seed=seed)
    actions, crashed, over = [], False, False
    while not over:
        action, _ = model.predict(observation, deterministic=True)
        actions.append(int(action))
        observation, _, crashed, truncated, _ = environment.step(action)
        over = crashed or truncated
    return actions, crashed


def here(path: Path, seed: int, engine: MakeEngine, **scene: Any) -> Episode:
    """An episode of this project, driven by the file that was exported."""
    settings = SceneSettings(profile=PROFILES["highway-env"], ego_slots=1, decision_hz=1, **scene)
    agents = {"dqn": OnnxPolicy(path), "idm_mobil": make_agent("idm_mobil")}
    simulation = Simulation(settings, 1, "dqn", OneAgent("idm_mobil"), agents, engine)
    simulation.reset(np.array([seed], dtype=np.uint64))
    actions = []
    while simulation.ending[0] == RUNNING:
        simulation.step()
        actions.append(int(simulation.action[simulation.ego_vehicles][0]))
    return actions, bool(simulation.ending[0] != TIME)


def exported(model: Any, folder: Path) -> Path:
    model.save(folder / "dqn.zip")
    export_zip(folder / "dqn.zip", folder / "dqn.onnx", {"decision_hz": "1"}, Kinematics())
    return folder / "dqn.onnx"


def test_an_untrained_one_does_in_a_small_scene(tmp_path: Path) -> None:
    model = sb3.DQN("MlpPolicy", stock(**SMALL), device="cpu", **EXAMPLE)
    generator = torch.Generator().manual_seed(0)
    layers = [layer for layer in model.policy.q_net.q_net if isinstance(layer, torch.nn.Linear)]
    with torch.no_grad():  # initial weights take the same action everywhere
        for layer in layers:
            layer.weight.normal_(generator=generator)
            layer.bias.zero_()
        layers[0].weight[:, :5] = layers[0].weight[:, ::5] = 0.0  # moved by the others alone
    path = exported(model, tmp_path)
    seen = set()
    for seed in range(2):
        expected = there(model, seed, **SMALL)
        for engine in ENGINES:
            assert here(path, seed, engine, **SMALL) == expected
        seen |= set(expected[0])
    assert len(seen) > 1


def test_the_suite_of_the_guide_is_stock_highway(tmp_path: Path) -> None:
    suites = re.findall(r"```yaml\n(.*?)```", GUIDE.read_text(encoding="utf-8"), re.DOTALL)
    (text,) = (each for each in suites if "profile: highway-env" in each)
    (tmp_path / "highway.yaml").write_text(text)
    scene = load_suite(tmp_path / "highway.yaml").scene
    assert (scene.profile, scene.ego_slots) == (PROFILES["highway-env"], 1)
    config = gymnasium.make("highway-v0").unwrapped.config
    assert scene.lanes == config["lanes_count"]
    assert scene.traffic_vehicles == config["vehicles_count"]
    assert scene.density == config["vehicles_density"]
    assert scene.simulation_hz == config["simulation_frequency"]
    assert scene.decision_hz == config["policy_frequency"]
    assert scene.duration_s == config["duration"]
    assert config["observation"] == {"type": Kinematics.name}


@pytest.mark.slow
def test_one_trained_on_stock_highway_does_over_whole_episodes(tmp_path: Path) -> None:
    model = sb3.DQN("MlpPolicy", gymnasium.make("highway-v0"), seed=0, device="cpu", **EXAMPLE)
    model.learn(500)
    path = exported(model, tmp_path)
    for seed in range(10):
        expected = there(model, seed, **STOCK)
        for engine in ENGINES:
            assert here(path, seed, engine, **STOCK) == expected
