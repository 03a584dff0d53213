"""Compiles the engine before the first run, in two processes, and each function in one of them."""

import os
from collections.abc import Callable

import numpy as np

from charms_bench.engine.collision_kinds import ANY_ANGLE, note_collisions
from charms_bench.engine.simulation import Simulation
from charms_bench.engine.stepping import advance
from charms_bench.foundation.compiled import is_kept
from charms_bench.foundation.threads import ONE_THREAD
from charms_bench.foundation.workers import in_processes
from charms_bench.plugins.registry import make_agent
from charms_bench.plugins.traffic import OneAgent
from charms_bench.recording.recording import Recording
from charms_bench.world.observations import neighbours
from charms_bench.world.scene import EVALUATION_SEEDS, SceneSettings


def _simulation(agent: str = "") -> Simulation:
    """One episode, which has not been started; without an agent, nothing drives in it."""
    made = {agent: make_agent(agent)} if agent else {}
    return Simulation(SceneSettings(), 1, agent or None, OneAgent(agent), made)


def _start(agent: str = "") -> Simulation:
    simulation = _simulation(agent)
    simulation.reset(np.array([EVALUATION_SEEDS], dtype=np.uint64))
    return simulation


def _recording() -> None:
    simulation = _simulation()
    Recording(simulation).note()
    note_collisions(simulation.scene, simulation.collision, ANY_ANGLE)


def _observation() -> None:
    simulation = _simulation()
    neighbours(simulation.scene.read_only(), simulation.ego_vehicles)


def _driver_models() -> None:
    for agent in ("idm_mobil", "stackelberg"):
        _start(agent).step()


# In an order in which two processes take equally long, and nothing is compiled twice.
PARTS: dict[str, Callable[[], object]] = {
    "motion": lambda: _simulation().step(),
    "start": _start,
    "recording": _recording,
    "driver models": _driver_models,
    "observation": _observation,
}


def is_warm() -> bool:
    """Whether an earlier run has compiled the engine for this installation and this processor."""
    return is_kept(advance) and is_kept(note_collisions)


def compile_parts(tell: Callable[[str, int], None]) -> None:
    """Compiles what every run needs; calls `tell` with each part of `PARTS` that is done, and 1."""
    count = min(os.cpu_count() or 1, 2)
    for part, _ in in_processes(_compile, PARTS, count, environment=ONE_THREAD):
        tell(part, 1)


def _compile(part: str) -> None:
    PARTS[part]()
