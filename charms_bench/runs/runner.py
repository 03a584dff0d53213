"""Runs a suite: cells into shards, shards over workers, rows into the run folder."""

import hashlib
import json
import os
import platform
from collections.abc import Callable, Generator, Mapping, Sequence
from contextlib import closing
from functools import lru_cache, partial
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from charms_bench import __version__
from charms_bench.engine import EngineName
from charms_bench.errors import CharmsBenchError, RunFolderError, SuiteError
from charms_bench.plugins.agent import Agent, Policy
from charms_bench.plugins.registry import AGENTS, TRAFFIC, Plugin, find, plugins
from charms_bench.plugins.specs import AgentSpec
from charms_bench.runs.finished import FinishedRun
from charms_bench.runs.folder import RunFolder, Shard, ShardFiles, in_parquet, recorded_versions
from charms_bench.runs.keys import code_sha256, harness_sha256
from charms_bench.runs.suite import Cell, Suite
from charms_bench.runs.workers import in_processes, use_exact_maths
from charms_bench.world.scene import EVALUATION_SEEDS

SHARD_EPISODES: dict[EngineName, int] = {"batched": 150, "highway-env": 10}
"""Enough scenes for the compiled engine to be fast; few enough to lose little by a kill."""

SHARD_LIMIT_S = 1800.0
"""Far more than any shard needs whose agents answer at all."""

Progress = Callable[[Cell, int], None]
"""Told of every finished shard: its cell and its number of episodes."""


class Elsewhere(Protocol):
    """Runs shards on other machines."""

    def __call__(
        self,
        suite: Suite,
        agents: Mapping[str, Any],
        shards: Sequence[Shard],
        title: Callable[[Shard], str],
        limit_s: float,
    ) -> Generator[tuple[Shard, ShardFiles], None, None]:
        """Each shard with its files, as they finish; closing it ends the others.

        Args:
            suite: Whose shards they are.
            agents: Who takes part; see `plan`.
            shards: What is to be run, on the batched engine.
            title: What a shard is called in messages.
            limit_s: How long a shard may take.
        """


def plan(suite: Suite, engine: EngineName) -> tuple[tuple[Shard, ...], dict[str, Any]]:
    """The shards of a suite, and what is to be known of the agents that take part."""
    if suite.seed + suite.episodes > EVALUATION_SEEDS:
        raise SuiteError(
            f"suite '{suite.suite}': the seeds {suite.seed} to {suite.seed + suite.episodes} "
            f"reach those of trainings, which start at {EVALUATION_SEEDS}"
        )
    agents: dict[str, Any] = {}
    shards = []
    size = SHARD_EPISODES[engine]
    for index in range(len(suite.cells)):
        agents |= _inputs(suite, engine, index)["agents"]
        for start in range(0, suite.episodes, size):
            episodes = min(size, suite.episodes - start)
            shards.append(_shard(suite, engine, index, suite.seed + start, episodes))
    return tuple(shards), agents


def _shard(suite: Suite, engine: EngineName, cell: int, first_seed: int, episodes: int) -> Shard:
    """A shard, its key made of all that decides its rows."""
    described = {"first_seed": first_seed, "episodes": episodes}
    inputs = json.dumps([_inputs(suite, engine, cell), described], sort_keys=True)
    key = hashlib.sha256(inputs.encode()).hexdigest()
    return Shard(cell=cell, first_seed=first_seed, episodes=episodes, key=key)


def _inputs(suite: Suite, engine: EngineName, index: int) -> dict[str, Any]:
    """What decides the rows of a cell, but for the seeds: settings, weights and code."""
    cell = suite.cells[index]
    return {
        "charms_bench": __version__,
        "code_sha256": harness_sha256(),
        "versions": recorded_versions(),
        "engine": engine,
        "scene": suite.scene.model_dump(mode="json"),
        "ego": cell.ego.agent.key,
        "traffic": cell.traffic.traffic.model_dump(mode="json"),
        "agents": _identities(cell, suite.folder),
    }


def run(
    suite: Suite,
    output: Path,
    engine: EngineName = "batched",
    workers: int | None = None,
    progress: Progress = lambda cell, episodes: None,
    rows: Path | None = None,
    shard_limit_s: float = SHARD_LIMIT_S,
    notice: Callable[[str], None] = lambda what: None,
    elsewhere: Elsewhere | None = None,
) -> FinishedRun:
    """Runs what is missing of a suite in the folder `output`.

    Args:
        suite: What to run.
        output: The run folder; a run that was interrupted there goes on.
        engine: `batched` or `highway-env`.
        workers: Processes; by default one a core.
        progress: Told of every shard, those that were there first.
        rows: Another run's folder, whose finished shards are taken where they are the same.
        shard_limit_s: How long a shard may take.
        notice: Told of what went wrong and was put right.
        elsewhere: Runs the shards, instead of processes on this machine.

    Raises:
        CharmsBenchError: As soon as something is wrong; finished shards are kept.
    """
    folder = RunFolder(output)
    with folder.opened_for(suite, engine):
        shards, agents = plan(suite, engine)
        folder.write_manifest(suite, engine, agents)
        for spec in (ego.agent for ego in suite.egos if ego.agent.onnx is not None):
            folder.keep_network(suite.folder / str(spec.onnx), agents[spec.key]["weights_sha256"])
        if rows is not None:
            folder.take(shards, rows)
        missing = []
        for shard in shards:
            if folder.is_whole(shard):
                progress(suite.cells[shard.cell], shard.episodes)
                continue
            missing.append(shard)
            if folder.has(shard):
                notice(f"{_title(suite, shard)}: changed since they were written; simulated again")
        if engine == "highway-env":
            use_exact_maths()
        count = min(workers or os.cpu_count() or 1, len(missing))
        work, title = partial(run_shard, suite, engine), partial(_title, suite)
        if elsewhere is None:
            ran = in_processes(work, missing, count, title, shard_limit_s, notice)
        else:
            ran = elsewhere(suite, agents, missing, title, shard_limit_s)
        with closing(ran) as finished:
            try:
                for shard, files in finished:
                    folder.write(shard, files)
                    progress(suite.cells[shard.cell], shard.episodes)
            except CharmsBenchError as error:
                error.add_note(f"finished shards are in {output}; the same command goes on there")
                raise
        folder.drop_others(shards)
    return FinishedRun(suite, folder, shards)


def run_shard(suite: Suite, engine: EngineName, shard: Shard) -> ShardFiles:
    """Simulates one shard: the files of its rows; a pure function of what its key names.

    Raises:
        RunFolderError: What its key names is not what is installed here now.
        CharmsBenchError: An agent cannot be made, or fails.
    """
    from charms_bench.engine.recording import Recording
    from charms_bench.engine.simulation import Simulation

    if _shard(suite, engine, shard.cell, shard.first_seed, shard.episodes) != shard:
        raise RunFolderError(
            f"{_title(suite, shard)}: the code, a library or a network is another on "
            f"{platform.node()} now than when the run began; run the suite again"
        )
    cell = suite.cells[shard.cell]
    ego = cell.ego.agent
    traffic = cell.traffic.traffic.make()
    agents = {name: _agent(AgentSpec(name=name), suite.folder) for name in traffic.agents}
    agents[ego.key] = _agent(ego, suite.folder)
    simulation = Simulation(suite.scene, shard.episodes, ego.key, traffic, agents, engine)
    first = shard.first_seed
    simulation.reset(np.arange(first, first + shard.episodes, dtype=np.uint64))
    recording = Recording(simulation)
    while simulation.scene.active.any():
        simulation.step()
        recording.note()
    return {
        "steps": in_parquet(recording.steps()),
        "counts": in_parquet(recording.counts()),
        "episodes": in_parquet(recording.episodes()),
    }


def _title(suite: Suite, shard: Shard) -> str:
    cell = suite.cells[shard.cell]
    last = shard.first_seed + shard.episodes - 1
    return f"{cell.ego.title} in {cell.traffic.title}, episodes {shard.first_seed} to {last}"


def _identities(cell: Cell, folder: Path) -> dict[str, Any]:
    """What tells each agent of a cell from any other version of it."""
    return dict(_identified(cell.model_dump_json(), folder))


@lru_cache
def _identified(cell_json: str, folder: Path) -> dict[str, Any]:
    """Found out once a process, which keeps the code that it has."""
    cell = Cell.model_validate_json(cell_json)
    traffic = cell.traffic.traffic
    specs = [cell.ego.agent, *(AgentSpec(name=name) for name in traffic.make().agents)]
    identities: dict[str, Any] = {spec.key: _identity(spec, folder) for spec in specs}
    installed = plugins(TRAFFIC)
    if traffic.name in installed:
        identities[f"traffic {traffic.name}"] = _origin(installed[traffic.name])
    return identities


def _identity(spec: AgentSpec, folder: Path) -> dict[str, str]:
    agent = _agent(spec, folder)
    identity = {"weights_sha256": agent.weights_sha256} if isinstance(agent, Policy) else {}
    return identity if spec.name is None else identity | _origin(find(AGENTS, spec.name))


def _origin(plugin: Plugin) -> dict[str, str]:
    return {
        "distribution": plugin.distribution,
        "version": plugin.version,
        "code_sha256": code_sha256(plugin.entry_point.module),
    }


def _agent(spec: AgentSpec, folder: Path) -> Agent:
    return _made(spec.model_dump_json(), folder)


@lru_cache
def _made(spec: str, folder: Path) -> Agent:
    """An agent is made once a process."""
    return AgentSpec.model_validate_json(spec).make(folder)
