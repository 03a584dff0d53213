"""What `bench` measures: this engine and its environments, highway-env, and EnvPool.

Each function makes a `Step` of scenes with the same settings. One step of many learners is a
decision interval, which counts the decisions of the vehicles that have not crashed before it.
"""

from collections.abc import Callable
from typing import Any

import numpy as np

from charms_bench.engine import EngineName
from charms_bench.engine.endings import RUNNING
from charms_bench.engine.simulation import Simulation
from charms_bench.plugins.registry import make_agent, make_traffic
from charms_bench.world.actions import ACTIONS, IDLE
from charms_bench.world.observations import neighbours
from charms_bench.world.scene import SceneSettings

OBSERVATION = {"type": "Kinematics", "vehicles_count": 7}
SCENES = 384
"""Scenes that this engine advances together."""
SEED = 10**6
WARM_UP = 30
"""Decisions before the measurement of learners, after which the scenes are at all stages."""

Step = Callable[[], int]
"""Makes some environment steps and returns how many."""


def compiled(
    settings: SceneSettings, traffic: str, engine: EngineName = "batched", scenes: int = SCENES
) -> Step:
    """This engine with an ego that stays idle, its observations and new scenes included."""
    plugin = make_traffic(traffic)
    agents = {name: make_agent(name) for name in plugin.agents}
    simulation = Simulation(settings, scenes, None, plugin, agents, engine)
    simulation.reset(np.arange(SEED, SEED + scenes, dtype=np.uint64))
    # Episodes at all stages, so that every step has its share of new scenes.
    simulation.steps[:] = np.arange(scenes) * settings.decisions // scenes
    actions = np.full(scenes, IDLE)

    def step() -> int:
        simulation.step(actions)
        ended = np.nonzero(simulation.ending != RUNNING)[0]
        if ended.size:
            simulation.reset(simulation.seeds[ended] + np.uint64(scenes), ended)
        neighbours(simulation.scene, simulation.ego_vehicles)
        return scenes

    return step


def highway_env(settings: SceneSettings) -> Step:
    """highway-env with an ego that stays idle."""
    environment = _highway_v0(config(settings))

    def step() -> int:
        _, _, terminated, truncated, _ = environment.step(IDLE)
        if terminated or truncated:
            environment.reset()
        return 1

    return step


def config(settings: SceneSettings) -> dict[str, Any]:
    """highway-env's configuration of the same scene."""
    return {
        "lanes_count": settings.lanes,
        "vehicles_count": settings.traffic_vehicles,
        "simulation_frequency": settings.simulation_hz,
        "policy_frequency": settings.decision_hz,
        "duration": settings.duration_s,
        "observation": OBSERVATION,
    }


def _highway_v0(config: dict[str, Any], **options: Any) -> Any:
    import gymnasium
    import highway_env  # noqa: F401  # registers highway-v0

    environment: Any = gymnasium.make("highway-v0", config=config, **options)
    environment.reset(seed=SEED)
    return environment


def vector_environments(environments: Any, count: int, dtype: Any = np.int64) -> Step:
    """Vector environments that have been reset, whose egos stay idle."""
    actions = np.full(count, IDLE, dtype=dtype)

    def step() -> int:
        environments.step(actions)
        return count

    return step


def envpool(settings: SceneSettings, threads: int, count: int) -> Step:
    """EnvPool with egos that stay idle."""
    import envpool

    environments = envpool.make_gymnasium(
        "Highway-v0",
        num_envs=count,
        num_threads=threads,
        max_episode_steps=settings.decisions,
        lanes_count=settings.lanes,
        vehicles_count=settings.traffic_vehicles,
        observation_vehicles_count=7,
        simulation_frequency=settings.simulation_hz,
        policy_frequency=settings.decision_hz,
        duration=round(settings.duration_s),
    )
    environments.reset()
    return vector_environments(environments, count, np.int32)


def learners(settings: SceneSettings) -> Step:
    """A `LearnersVectorEnv` in which random actions drive all vehicles."""
    from charms_bench.envs.learners_vector_env import LearnersVectorEnv

    scene = settings.model_dump(exclude={"scenario"})
    env = LearnersVectorEnv(SCENES, observation=OBSERVATION, **scene)
    env.reset(seed=SEED)
    rng = np.random.default_rng(SEED)

    def step() -> int:
        decisions = int(env.alive.sum())
        env.step(rng.integers(len(ACTIONS), size=env.num_envs))
        return decisions

    for _ in range(WARM_UP):
        step()
    return step


def highway_env_learners(settings: SceneSettings) -> Step:
    """highway-env in which random actions drive all vehicles.

    Its episodes end when the first of the vehicles crashes.
    """
    action = {"type": "DiscreteMetaAction"}
    changes = {
        "controlled_vehicles": settings.vehicles,
        "vehicles_count": 0,
        "ego_spacing": 1 / settings.density,
        "action": {"type": "MultiAgentAction", "action_config": action},
        "observation": {"type": "MultiAgentObservation", "observation_config": OBSERVATION},
    }
    env = _highway_v0(config(settings) | changes, disable_env_checker=True).unwrapped
    rng = np.random.default_rng(SEED)

    def step() -> int:
        decisions = sum(not vehicle.crashed for vehicle in env.controlled_vehicles)
        actions = rng.integers(len(ACTIONS), size=settings.vehicles).tolist()
        *_, terminated, truncated, _ = env.step(tuple(actions))
        if terminated or truncated:
            env.reset()
        return decisions

    return step
