"""Two engines, one behaviour: what both of them do.

In one simulation step every driver model acts, one model after another in the order in which they
were given to `reset`; within a model, vehicles act in the order of spawning, each seeing the
target lanes of those before it. Then all vehicles move, and then collisions are found. Meta-actions
given by `command` take effect before the step that follows.
"""

from collections.abc import Sequence
from typing import Literal, Protocol

import numpy as np
from numpy.typing import NDArray

from charms_bench.plugins.agent import DriverModel
from charms_bench.world.actions import Actions
from charms_bench.world.scene import Ints, Scene, SceneSettings, Vehicles

EngineName = Literal["batched", "highway-env"]
ENGINES: tuple[EngineName, ...] = ("batched", "highway-env")


class Engine(Protocol):
    """B scenes of N vehicles that advance together."""

    scene: Scene

    def reset(
        self,
        rows: Ints,
        seeds: NDArray[np.uint64],
        models: Sequence[DriverModel],
        ego_model: int,
        traffic_models: Ints,
    ) -> None:
        """Spawns new scenes.

        Args:
            rows: (R,) the scenes to spawn.
            seeds: (R,) their seeds; a scene depends on its seed and the settings alone.
            models: The driver models of the engine, in the order in which they act; the same at
                every call.
            ego_model: Index in `models` of the ego's, -1 where `command` drives the ego.
            traffic_models: (R, N - 1) those of the other vehicles, likewise.
        """

    def command(self, vehicles: Vehicles, actions: Actions) -> None:
        """Gives M vehicles a meta-action each, (M,)."""

    def advance(self) -> None:
        """Advances every active scene by one simulation step."""


def make_engine(name: EngineName, settings: SceneSettings, scenes: int) -> Engine:
    """An engine by name, for `scenes` scenes; nothing is spawned yet."""
    if name == "batched":
        from charms_bench.engine.batched import BatchedEngine

        return BatchedEngine(settings, scenes)
    from charms_bench.engine.highway_env import HighwayEnvEngine

    return HighwayEnvEngine(settings, scenes)
