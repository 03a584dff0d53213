"""A network trained in one of highway-env's environments acts in a suite on that road as there."""

import json
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pytest
import stable_baselines3 as sb3
import torch
from charms_agents.training.sb3_export import export_zip
from command_line import charms_bench
from handmade_weights import recurrent_weights
from made_checkpoints import zipped

from charms_bench.engine.simulation import Simulation
from charms_bench.errors import InputError
from charms_bench.plugins.onnx_policy import OnnxPolicy
from charms_bench.plugins.registry import make_agent
from charms_bench.plugins.traffic import OneAgent
from charms_bench.roads.engine import RoadEngine
from charms_bench.roads.settings import on_road, problem_of_driver
from charms_bench.world.highway_env_observation import HighwayEnv
from charms_bench.world.named_road import NamedRoad
from charms_bench.world.scenario import PRESCRIBED
from charms_bench.world.scene import SceneSettings

pytestmark = pytest.mark.filterwarnings("ignore:.*is out of date:DeprecationWarning")
BY_SPEEDS = {"type": "DiscreteMetaAction", "lateral": False, "target_speeds": [0, 4.5, 9]}
CASES = [
    ("merge-v0", {}, "DQN"),
    ("roundabout-v0", {}, "DQN"),
    ("intersection-v1", {"action": BY_SPEEDS}, "DQN"),
    ("intersection-v1", {}, "PPO"),
    ("racetrack-v0", {}, "SAC"),
]
FREE = {"name": "charms", "speed_min_mps": 0.0, "target_speed_min_mps": 0.0}
FREE |= {"offroad_terminal": False}


def saved(env: Any, algorithm: str, folder: Path) -> Path:
    """A network with random weights, which acts differently from scene to scene."""
    model = getattr(sb3, algorithm)(
        "MlpPolicy", env, seed=0, device="cpu", policy_kwargs={"net_arch": [32, 32]}
    )
    generator = torch.Generator().manual_seed(0)
    with torch.no_grad():
        for each in model.policy.parameters():
            if each.ndim == 2:
                each.normal_(0.0, 1.5 * each.shape[1] ** -0.5, generator=generator)
        if algorithm == "DQN":  # no action is the best one everywhere
            seen = np.array([env.reset(seed=k)[0] for k in range(20)])
            model.q_net.q_net[-1].bias -= model.q_net(torch.tensor(seen)).mean(dim=0)
    model.save(folder / "model.zip")
    return folder / "model.zip"


def exported(env: Any, algorithm: str, folder: Path) -> OnnxPolicy:
    export_zip(saved(env, algorithm, folder), folder / "out.onnx", {})
    return OnnxPolicy(folder / "out.onnx")


def in_suite(road: str, policy: OnnxPolicy, hz: int = 15) -> Simulation:
    """One scene of a suite on a road, not yet started."""
    scene = {"profile": FREE, "decision_hz": int(policy.decision_hz), "simulation_hz": hz}
    settings = on_road(SceneSettings.model_validate(scene), NamedRoad(name=road))
    return Simulation(settings, 1, "net", OneAgent(PRESCRIBED), {"net": policy}, RoadEngine)


def where_and_how_fast(env: Any) -> list[float]:
    ego = env.unwrapped.vehicle
    return [*ego.position, ego.speed, ego.heading]


def compare(
    env: Any,
    simulation: Simulation,
    policy: OnnxPolicy,
    seeds: Iterable[int],
    most: int,
    tolerance: float = 0.0,
) -> set[str]:
    """Drives both with the same seeds; returns the different actions that have been taken."""
    assert isinstance(simulation.engine, RoadEngine)
    ego, taken = simulation.engine.episodes.scenes.vehicles[0, 0], set()
    for seed in seeds:
        seen, _ = env.reset(seed=seed)
        simulation.reset(np.array([seed], dtype=np.uint64))
        over, decisions = False, 0
        while not over and simulation.scene.active[0] and decisions < most:
            action = policy.decide(np.asarray(seen, np.float32)[None])[0]
            taken.add(str(np.round(action, 2)))
            is_meta = action.ndim == 0
            simulation.step()
            if is_meta:
                assert simulation.action[0, 0] == action
            given = int(action) if is_meta else action[policy.controls]
            seen, _, terminated, truncated, _ = env.step(given)
            found = [ego[name] for name in ("x", "y", "speed", "heading")]
            np.testing.assert_allclose(found, where_and_how_fast(env), tolerance, tolerance)
            over, decisions = terminated or truncated, decisions + 1
    return taken


@pytest.mark.parametrize(("road", "config", "algorithm"), CASES)
def test_it_acts_in_a_suite_as_in_its_environment(
    road: str, config: dict[str, Any], algorithm: str, tmp_path: Path
) -> None:
    env = gymnasium.make(f"charms_bench.envs:charms_bench/{road}", config=config)
    policy = exported(env, algorithm, tmp_path)
    taken = compare(env, in_suite(road, policy), policy, range(3), 40)
    assert len(taken) > 1


@pytest.mark.parametrize("road", ["merge-v0", "roundabout-v0"])
def test_the_lstm_of_a_recurrent_ppo_remembers_the_episode_in_a_suite(
    road: str, tmp_path: Path
) -> None:
    env: Any = gymnasium.make(f"charms_bench.envs:charms_bench/{road}")
    torch.manual_seed(2)
    network, state, taken = torch.nn.LSTM(25, 12), None, []
    with torch.no_grad():  # torch's initial gates are all nearly half open
        for parameter in network.parameters():
            parameter.mul_(6.0)
    checkpoint = zipped(tmp_path, recurrent_weights(network))
    done = charms_bench("export", checkpoint, tmp_path / "out.onnx", "--environment", road)
    assert done.returncode == 0, done.stderr
    simulation = in_suite(road, OnnxPolicy(tmp_path / "out.onnx"))
    for seed in range(3):
        (seen, _), state, over = env.reset(seed=seed), None, False
        simulation.reset(np.array([seed], dtype=np.uint64))
        while not over and simulation.scene.active[0]:
            with torch.no_grad():
                out, state = network(torch.tensor(seen.reshape(1, 1, 25)), state)
            taken.append(int(out[0, 0, :5].argmax()))
            simulation.step()
            assert simulation.action[0, 0] == taken[-1]
            seen, _, terminated, truncated, _ = env.step(taken[-1])
            over = terminated or truncated
    assert len({*taken}) > 1


@pytest.mark.slow
@pytest.mark.parametrize(("road", "config", "algorithm"), CASES)
def test_it_acts_in_a_suite_as_in_highway_env(
    road: str, config: dict[str, Any], algorithm: str, tmp_path: Path
) -> None:
    pytest.importorskip("highway_env")
    there = gymnasium.make(road, config=config)
    here = gymnasium.make(f"charms_bench.envs:charms_bench/{road}", config=config)
    policy = exported(here, algorithm, tmp_path)
    compare(here, in_suite(road, policy), policy, range(100), 300)
    compare(there, in_suite(road, policy), policy, range(5), 40, tolerance=1e-6)


def test_a_saved_state_continues_with_the_observation_that_was_made_before(tmp_path: Path) -> None:
    # At intersections, vehicles leave and enter after highway-env's observation.
    env = gymnasium.make("charms_bench.envs:charms_bench/intersection-v0")
    simulation = in_suite("intersection-v0", exported(env, "DQN", tmp_path))
    branch = in_suite("intersection-v0", simulation.policies[0])
    for seed in range(3):
        simulation.reset(np.array([seed], dtype=np.uint64))
        simulation.step()
        branch.reset(np.array([seed + 1], dtype=np.uint64))
        branch.restore(simulation.state())
        for _ in range(4):
            simulation.step()
            branch.step()
            assert branch.state() == simulation.state()


def test_the_checkpoint_of_highway_env_needs_the_name_of_its_environment(tmp_path: Path) -> None:
    env = gymnasium.make("charms_bench.envs:charms_bench/roundabout-v0")
    like = exported(env, "DQN", tmp_path).observation
    pytest.importorskip("highway_env")
    stock = saved(gymnasium.make("roundabout-v0"), "DQN", tmp_path)
    arguments = stock, tmp_path / "named.onnx"
    assert charms_bench("export", *arguments).returncode == 2
    done = charms_bench("export", *arguments, "--environment", "roundabout-v0", "--json")
    assert json.loads(done.stdout)["trained_in"] == "roundabout-v0"
    policy = OnnxPolicy(tmp_path / "named.onnx")
    assert (policy.observation, policy.decision_hz) == (like, 1.0)
    assert [action.name for action in policy.actions] == [
        *("LANE_LEFT", "IDLE", "LANE_RIGHT", "FASTER", "SLOWER")
    ]


def test_it_drives_egos_on_roads_with_a_name_only(tmp_path: Path) -> None:
    env = gymnasium.make("charms_bench.envs:charms_bench/merge-v0")
    policy = exported(env, "DQN", tmp_path)
    assert problem_of_driver(policy) == ""
    assert "drives egos only" in problem_of_driver(policy, is_ego=False)
    others = {"net": policy, "idm_mobil": make_agent("idm_mobil")}
    with pytest.raises(InputError, match="expected a road with a name"):
        Simulation(SceneSettings(), 1, "net", OneAgent("idm_mobil"), others)


def test_actions_that_are_not_the_environments_are_rejected() -> None:
    with pytest.raises(ValueError, match="no agent has actions of 'DiscreteAction'"):
        HighwayEnv(observation={}, action={"type": "DiscreteAction"}, shape=(5, 5))
