"""What an agent does in a few episodes that no suite evaluates on."""

import numpy as np

from charms_bench.engine.simulation import Simulation
from charms_bench.envs.ego_env import made_traffic
from charms_bench.metrics.missing_lanes import missing_lanes
from charms_bench.plugins.agent import DriverModel
from charms_bench.plugins.registry import make_agent
from charms_bench.recording.recording import Recording
from charms_bench.world.actions import meta_actions_of
from charms_bench.world.highway_env_observation import HighwayEnv
from charms_bench.world.observations import observation_of
from charms_bench.world.scene import EVALUATION_SEEDS, SceneSettings

EPISODES = 50


def remark_on(name: str) -> str:
    """A remark on the decisions of an agent as the ego among IDM+MOBIL, without its subject.

    It is empty if there is nothing to remark, as of a driver model, which takes no actions, and of
    a policy of highway-env's environments; see `metrics.missing_lanes`. Raises a `CharmsBenchError`
    if the agent cannot drive.
    """
    agent, settings = make_agent(name), SceneSettings()
    if isinstance(agent, DriverModel) or isinstance(observation_of(agent.observation), HighwayEnv):
        return ""
    if rate := settings.simulation_hz_for(float(agent.decision_hz)):
        settings = SceneSettings(simulation_hz=rate)
    around, drivers = made_traffic("idm_mobil")
    drivers[name] = agent
    simulation = Simulation(settings, EPISODES, name, around, drivers)
    simulation.reset(EVALUATION_SEEDS + np.arange(EPISODES, dtype=np.uint64))
    steps, actions = Recording.of(simulation).steps(), meta_actions_of(agent.actions)
    return missing_lanes([steps], settings.lanes, actions).remark()
