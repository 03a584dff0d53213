"""Many learners measured: random actions for all vehicles, here and in highway-env.

One step of a contestant is a decision interval; it counts the decisions of the vehicles that have
not crashed before it.
"""

from collections.abc import Callable
from typing import Any

import numpy as np

from charms_bench.envs.learners_vector_env import LearnersVectorEnv
from charms_bench.world.actions import ACTIONS
from charms_bench.world.scene import SceneSettings

WARM_UP = 30
"""Decisions before the measurement, after which the scenes are at all stages."""


def our_learners(
    settings: SceneSettings, scenes: int, observation: dict[str, Any], seed: int
) -> Callable[[], int]:
    """A step of a `LearnersVectorEnv` in which all vehicles are learners."""
    scene = settings.model_dump(exclude={"scenario"})
    env = LearnersVectorEnv(scenes, observation=observation, **scene)
    env.reset(seed=seed)
    rng = np.random.default_rng(seed)

    def step() -> int:
        decisions = int(env.alive.sum())
        env.step(rng.integers(len(ACTIONS), size=env.num_envs))
        return decisions

    for _ in range(WARM_UP):
        step()
    return step


def highway_env_learners(
    settings: SceneSettings, observation: dict[str, Any], seed: int
) -> Callable[[], int]:
    """A step of highway-env with `MultiAgentAction` and `MultiAgentObservation`.

    Its episodes end when the first of the vehicles crashes.
    """
    import gymnasium
    import highway_env  # noqa: F401  # registers highway-v0

    config = {
        "lanes_count": settings.lanes,
        "controlled_vehicles": settings.vehicles,
        "vehicles_count": 0,
        "ego_spacing": 1 / settings.density,
        "simulation_frequency": settings.simulation_hz,
        "policy_frequency": settings.decision_hz,
        "duration": settings.duration_s,
        "action": {
            "type": "MultiAgentAction",
            "action_config": {"type": "DiscreteMetaAction"},
        },
        "observation": {
            "type": "MultiAgentObservation",
            "observation_config": observation,
        },
    }
    env: Any = gymnasium.make("highway-v0", config=config, disable_env_checker=True).unwrapped
    env.reset(seed=seed)
    rng = np.random.default_rng(seed)

    def step() -> int:
        decisions = sum(not vehicle.crashed for vehicle in env.controlled_vehicles)
        *_, terminated, truncated, _ = env.step(
            tuple(rng.integers(len(ACTIONS), size=settings.vehicles).tolist())
        )
        if terminated or truncated:
            env.reset()
        return decisions

    return step
