"""A run of subset simulation over the random draws of a cell's episodes; workers do this.

A run depends on this module and on what it imports, and its key is a hash of all that code.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from charms_bench.engine.events import lowest_levels
from charms_bench.engine.simulation import Simulation
from charms_bench.errors import AgentError, RunFolderError
from charms_bench.plugins.event import Event
from charms_bench.plugins.held import HeldEvent
from charms_bench.plugins.registry import EVENTS, find, make_event
from charms_bench.plugins.specs import AgentSpec, TrafficSpec
from charms_bench.runs.code_hashes import harness_sha256
from charms_bench.runs.intact import harness_names, problem_of
from charms_bench.runs.options import name_and_options
from charms_bench.runs.shard import (
    CellTask,
    HeldDrivers,
    Software,
    forget_identities,
    installed,
    origin_of,
)
from charms_bench.statistics.subset_simulation import (
    Seeds,
    SubsetRun,
    pilot_run,
    subset_simulation,
)
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


def event_of(text: str) -> Event:
    """Returns the event that a text like `crash` or `ttc:below_s=1.5` asks for.

    Raises:
        InputError: The text is not of that form, or the event is not installed or takes no such
            options.
    """
    return make_event(*name_and_options(text, "event"))


def software_of(
    ego: AgentSpec, traffic: TrafficSpec, networks: Mapping[str, Path], event: str
) -> Software:
    """Returns what is installed here and decides the estimates of a cell."""
    found = installed(ego, traffic, networks)
    name, _ = name_and_options(event, "event")
    plugins = {**found.agents, f"event {name}": origin_of(find(EVENTS, name))}
    return Software(harness_sha256(entry=__name__), found.versions, plugins)


def estimate(task: RareTask) -> SubsetRun:
    """Makes a run or a pilot.

    Raises:
        RunFolderError: The installed software is no longer that of the task.
        CharmsBenchError: An agent or the event cannot be made, or fails.
    """
    forget_identities()
    found = software_of(task.ego, task.traffic, task.networks, task.event)
    if changed := found.differences(task.software):
        raise RunFolderError(
            f"{task.title}: changed since the first run began: {changed}; start again with another "
            "--output"
        )
    names = harness_names()
    simulations = _Simulations(task)
    steps = task.scene.decisions * task.scene.steps_per_decision
    events = event_of(task.event), event_of(task.event)
    event = HeldEvent(*events, np.random.default_rng([task.seed, task.run, 3]), steps)

    def level(normal: Floats, seeds: Seeds) -> Floats:
        parts = range(0, seeds.size, EPISODES_AT_ONCE)
        blocks = [slice(start, start + EPISODES_AT_ONCE) for start in parts]
        levels = [simulations.levels(event, normal[each], seeds[each]) for each in blocks]
        return np.concatenate(levels)

    rng = np.random.default_rng([task.seed, task.run])
    space = level, 4 * task.scene.vehicles + 1, task.samples
    if task.pilot is None:
        made = pilot_run(*space, rng)
    else:
        (made,) = subset_simulation(*space, 1, task.pilot, rng)
    simulations.held.finish(task.title)
    event.finish(f"event '{task.event}', {task.title}")
    if problem := problem_of(names):
        raise AgentError(f"{task.title}: {problem}; its estimate is refused")
    return made


class _Simulations:
    """Simulates episodes of a cell from normal components."""

    def __init__(self, task: RareTask) -> None:
        cell = (task.ego, task.traffic, task.networks, task.scene)
        self.held = HeldDrivers(*cell, task.seed + task.run)
        self._arguments: tuple[Any, ...] = (task.ego.key, self.held.traffic, self.held.agents)
        self._scene = task.scene
        self._by_size: dict[int, Simulation] = {}

    def levels(self, event: Event, normal: Floats, seeds: Seeds) -> Floats:
        from scipy import special

        if seeds.size not in self._by_size:
            self._by_size[seeds.size] = Simulation(self._scene, seeds.size, *self._arguments)
        simulation = self._by_size[seeds.size]
        # Rounding must not give 1, which is no draw.
        draws = np.minimum(special.ndtr(normal), np.nextafter(1.0, 0.0))
        simulation.reset(seeds, draws=draws)
        return lowest_levels(simulation, event)
