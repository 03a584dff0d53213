"""What `bench` measures: this engine and its environments, highway-env, and EnvPool.

Each function returns a `Stepping` of scenes with the same settings. One step of many learners is a
decision interval, which counts the decisions of the vehicles that have not crashed before it.
"""

import time
from collections.abc import Callable
from typing import Any

import numpy as np

from charms_bench.engine import MakeEngine
from charms_bench.engine.batched import BatchedEngine
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

Stepping = Callable[[float], tuple[int, float]]
"""Steps for about `seconds`; returns the number of environment steps and their duration, s."""


def repeated(step: Callable[[], int]) -> Stepping:
    """Repeats a step, at least once; it makes some environment steps and returns how many."""

    def run(seconds: float) -> tuple[int, float]:
        start = time.perf_counter()
        steps = step()
        while time.perf_counter() < start + seconds:
            steps += step()
        return steps, time.perf_counter() - start

    return run


def compiled(
    settings: SceneSettings, traffic: str, engine: MakeEngine = BatchedEngine, scenes: int = SCENES
) -> Stepping:
    """This engine with an ego that stays idle, its observations and new scenes included."""
    plugin = make_traffic(traffic)
    agents = {name: make_agent(name) for name in plugin.agents}
    simulation = Simulation(settings, scenes, None, plugin, agents, engine)
    simulation.reset(np.arange(SEED, SEED + scenes, dtype=np.uint64))
    # Episodes at all stages, so that every step begins about as many new scenes.
    simulation.steps[:] = np.arange(scenes) * settings.decisions // scenes
    actions = np.full(scenes, IDLE)

    def step() -> int:
        simulation.step(actions)
        ended = np.nonzero(simulation.ending != RUNNING)[0]
        if ended.size:
            simulation.reset(simulation.seeds[ended] + np.uint64(scenes), ended)
        neighbours(simulation.scene, simulation.ego_vehicles)
        return scenes

    return repeated(step)


def highway_env(settings: SceneSettings) -> Stepping:
    """highway-env with an ego that stays idle."""
    environment = _highway_v0(config(settings))

    def step() -> int:
        _, _, terminated, truncated, _ = environment.step(IDLE)
        if terminated or truncated:
            environment.reset()
        return 1

    return repeated(step)


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


def vector_environments(environments: Any, count: int, act: Callable[[], Any]) -> Stepping:
    """Vector environments that have been reset, with the actions that `act` returns."""

    def step() -> int:
        environments.step(act())
        return count

    return repeated(step)


def envpool(settings: SceneSettings, threads: int, count: int) -> Stepping:
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
    idle = np.full(count, IDLE, dtype=np.int32)
    return vector_environments(environments, count, lambda: idle)


def learners(settings: SceneSettings) -> Stepping:
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
    return repeated(step)


def highway_env_learners(settings: SceneSettings) -> Stepping:
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

    return repeated(step)


def road(name: str, count: int) -> Stepping:
    """Vector environments on one of highway-env's roads, with random actions."""
    from charms_bench.envs.road_env import RoadVectorEnv

    env = RoadVectorEnv(count, name)
    env.reset(seed=SEED)
    env.action_space.seed(SEED)
    return vector_environments(env, count, env.action_space.sample)


def highway_env_road(name: str) -> Stepping:
    """highway-env's environment of that name, with random actions."""
    import gymnasium
    import highway_env  # noqa: F401  # registers its environments

    env: Any = gymnasium.spec(name).make(disable_env_checker=True)
    env.reset(seed=SEED)
    env.action_space.seed(SEED)

    def step() -> int:
        truncated = env.step(env.action_space.sample())[3]
        if truncated or env.unwrapped._is_terminated():
            env.reset()
        return 1

    return repeated(step)
