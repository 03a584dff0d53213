"""A run of subset simulation over the random draws of a cell's episodes; workers do this.

A run depends on this module and on what it imports, and its key is a hash of all that code.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np

from charms_bench.engine.draws import count_of
from charms_bench.engine.events import lowest_levels
from charms_bench.engine.simulation import Simulation
from charms_bench.errors import AgentError, RunFolderError
from charms_bench.plugins.consistency import CheckedEvent
from charms_bench.plugins.event import Event
from charms_bench.plugins.registry import EVENTS, find, make
from charms_bench.plugins.specs import AgentSpec, TrafficSpec
from charms_bench.runs.code_hashes import harness_sha256
from charms_bench.runs.document import name_and_options
from charms_bench.runs.intact import harness_names, problem_of
from charms_bench.runs.shard import (
    CellTask,
    CheckedDrivers,
    Software,
    engine_on,
    forget_identities,
    installed,
    origin_of,
)
from charms_bench.statistics.subset_simulation import Seeds, SubsetRun, pilot_run, subset_simulation
from charms_bench.world.scene import Floats

EPISODES_AT_ONCE = 200
"""Enough scenes for the compiled engine to be fast."""


@dataclass(frozen=True, eq=False, kw_only=True)
class RareTask(CellTask):
    """A run or a pilot to make."""

    event: str
    """The event, with options; see `event_of`."""
    samples: int
    """Episodes of each level."""
    seed: int
    run: int = 0
    """From 1; runs with the same seed and different numbers are independent. 0 is the pilot."""
    pilot: SubsetRun | None = None
    """None if this is the pilot."""

    @property
    def place(self) -> tuple[int, int]:
        """The index of its cell and its number."""
        return self.cell, self.run


def event_of(text: str) -> Event:
    """The event that a text like `crash` or `ttc:below_s=1.5` asks for; raises an `InputError`."""
    return make(EVENTS, *name_and_options(text, "event"), Event)  # type: ignore[type-abstract]


def software_of(
    ego: AgentSpec,
    traffic: TrafficSpec,
    networks: Mapping[str, Path],
    event: str,
    on_network: bool = False,
) -> Software:
    """Returns what is installed here and decides the estimates of a cell; see `shard.installed`."""
    found = installed(ego, traffic, networks, on_network)
    name, _ = name_and_options(event, "event")
    plugins = {**found.agents, f"event {name}": origin_of(find(EVENTS, name))}
    return Software(harness_sha256(entry=__name__), found.versions, plugins)


def estimate(task: RareTask) -> SubsetRun:
    """Makes a run or a pilot; raises a `RunFolderError` if the software is not that of the task."""
    forget_identities()
    on_network = task.scene.network is not None
    found = software_of(task.ego, task.traffic, task.networks, task.event, on_network)
    if changed := found.differences(task.software):
        raise RunFolderError(
            f"{task.title}: changed since the first run began: {changed}; start again with another "
            "--output"
        )
    from scipy import special

    names, scene = harness_names(), task.scene
    drivers = CheckedDrivers(task.ego, task.traffic, task.networks, scene, task.seed + task.run)
    steps = scene.decisions * scene.steps_per_decision
    events = event_of(task.event), event_of(task.event)
    event = CheckedEvent(*events, np.random.default_rng([task.seed, task.run, 3]), steps)

    @cache
    def simulation_of(scenes: int) -> Simulation:
        engine = engine_on(scene)
        return Simulation(scene, scenes, task.ego.key, drivers.traffic, drivers.agents, engine)

    def level(normal: Floats, seeds: Seeds) -> Floats:
        levels = []
        for start in range(0, seeds.size, EPISODES_AT_ONCE):
            part = slice(start, start + EPISODES_AT_ONCE)
            simulation = simulation_of(seeds[part].size)
            draws = normal[part]
            if not on_network:  # rounding must not give 1, which is no draw
                draws = np.minimum(special.ndtr(draws), np.nextafter(1.0, 0.0))
            simulation.reset(seeds[part], draws=draws)
            levels.append(lowest_levels(simulation, event))
        return np.concatenate(levels)

    rng = np.random.default_rng([task.seed, task.run])
    space = level, count_of(scene), task.samples
    if task.pilot is None:
        made = pilot_run(*space, rng)
    else:
        (made,) = subset_simulation(*space, 1, task.pilot, rng)
    drivers.finish(task.title)
    event.finish(f"event '{task.event}', {task.title}")
    if problem := problem_of(names):
        raise AgentError(f"{task.title}: {problem}; its estimate is rejected")
    return made
