"""highway-env's reward: the same numbers as highway-env's own `HighwayEnv._reward`."""

from types import SimpleNamespace

import numpy as np
import pytest
from highway_env.envs.highway_env import HighwayEnv

from charms_bench.engine.simulation import Simulation
from charms_bench.envs.highway_reward import HighwayReward
from charms_bench.plugins.registry import make_agent
from charms_bench.plugins.traffic import OneAgent
from charms_bench.testing.reference_engine import HighwayEnvEngine
from charms_bench.world.actions import FASTER, LANE_RIGHT
from charms_bench.world.profile import PROFILES
from charms_bench.world.scene import SceneSettings


@pytest.mark.parametrize("profile", PROFILES)
def test_it_is_what_highway_env_computes_of_the_same_vehicles(profile: str) -> None:
    settings = SceneSettings(profile=PROFILES[profile], density=2.0)
    traffic = {"idm_mobil": make_agent("idm_mobil")}
    simulation = Simulation(settings, 6, None, OneAgent("idm_mobil"), traffic, HighwayEnvEngine)
    simulation.reset(np.arange(6, dtype=np.uint64))
    rng = np.random.default_rng(0)
    reward = HighwayReward()
    compared = []
    for step in range(25):
        actions = (
            rng.integers(5, size=6) if step % 3 else np.full(6, (FASTER, LANE_RIGHT)[step % 2])
        )
        simulation.step(actions)
        found = reward(simulation, reward.prepare(simulation, actions))
        for row, road in enumerate(simulation.engine.roads):
            environment = SimpleNamespace(
                road=road,
                vehicle=road.vehicles[simulation.scene.ego[row]],
                config=HighwayEnv.default_config(),
            )
            environment._rewards = lambda action, of=environment: HighwayEnv._rewards(of, action)
            assert found[row] == pytest.approx(HighwayEnv._reward(environment, 0), abs=1e-12)
            compared.append(found[row])
    assert simulation.scene.crashed.any()
    assert 0.0 <= min(compared) < 0.34 < 0.95 < max(compared) <= 1.0
