"""Simulates one shard, a fixed number of episodes of one cell; this is what workers run.

Rows depend on this module and on what it imports, and a shard's key is a hash of all that code.
So this module imports nothing that does not decide rows.
"""

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields, is_dataclass
from functools import cache, lru_cache
from hashlib import sha256
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl
from pydantic import BaseModel

from charms_bench.engine import MakeEngine
from charms_bench.engine.batched import BatchedEngine
from charms_bench.engine.simulation import Simulation
from charms_bench.errors import AgentError, BrokenWordError, RunFolderError
from charms_bench.plugins.agent import Agent, DriverModel, Policy
from charms_bench.plugins.consistency import (
    Checked,
    CheckedModel,
    CheckedPolicy,
    CheckedTraffic,
    checked,
)
from charms_bench.plugins.registry import (
    AGENTS,
    TRAFFIC,
    Plugin,
    find,
    is_network,
    others_of,
    plugins,
)
from charms_bench.plugins.specs import AgentSpec, TrafficSpec, by_content, drivers_of
from charms_bench.plugins.traffic import Traffic
from charms_bench.recording.columns import DRIVER_KEYS, keys_of, with_ego_index
from charms_bench.recording.recording import Recording
from charms_bench.runs.code_hashes import (
    ROADS,
    code_sha256,
    differences,
    harness_sha256,
    library_versions,
)
from charms_bench.runs.intact import harness_names, problem_of
from charms_bench.world.action_texts import described_actions
from charms_bench.world.actions import DEFAULT_ACTIONS, meta_actions_of
from charms_bench.world.scene import SceneSettings

ShardFiles = Mapping[str, bytes]
"""The Parquet files of a shard, one for each kind of rows in `recording.columns.SCHEMAS`."""


@dataclass(frozen=True)
class Software:
    """Everything installed that decides the rows of a cell."""

    code_sha256: str
    """Hash of this package's modules that decide rows."""
    versions: Mapping[str, str]
    """Versions of libraries."""
    agents: Mapping[str, Mapping[str, str]]
    """See `identify_agents`."""

    def differences(self, expected: "Software") -> str:
        """Returns in words what differs from the expected software; empty if nothing does."""
        return differences(self._flat(), expected._flat())

    def _flat(self) -> dict[str, str]:
        agents = {
            f"{field} of {agent}": value
            for agent, identity in self.agents.items()
            for field, value in identity.items()
        }
        return {"code of charms-bench": self.code_sha256, **self.versions, **agents}


@dataclass(frozen=True, eq=False, kw_only=True)
class CellTask:
    """A part of the work on a cell: all that decides its result."""

    title: str
    """What messages call it. This and `cell` decide nothing."""
    cell: int = 0
    """Index into `Suite.cells`."""
    scene: SceneSettings
    ego: AgentSpec
    traffic: TrafficSpec
    networks: Mapping[str, Path]
    """The files of the cell's networks; see `specs.networks_of`."""
    software: Software
    """What was installed when the run began."""

    @property
    def key(self) -> str:
        """Hash of all that the result depends on: of a network, the content and not the path.

        The order of agents is part of it, because the random draw of a mixture follows that order.
        The contents of networks are numbered, so that two names for the same content stay two keys
        of a mixture.
        """
        inputs = {each.name: _plain(getattr(self, each.name)) for each in fields(self)}
        del inputs["title"], inputs["cell"], inputs["networks"]
        contents = {
            name: f"{self.software.agents[name]['weights_sha256']} {number}"
            for number, name in enumerate(self.networks)
        }
        if self.scene.network is not None:
            inputs["road"] = _plain(road := self.scene.network)
            if road.file is not None:
                contents[str(road.file)] = str(road.sha256)
        if (source := self.scene.recording) is not None:
            contents[str(source.folder)] = source.sha256
        named = by_content(inputs, contents) if contents else inputs
        return sha256(json.dumps(named).encode()).hexdigest()


def _plain(value: Any) -> Any:
    """A field of a task, ready for JSON."""
    if isinstance(value, BaseModel):
        return value.model_dump(mode="json")
    return asdict(value) if is_dataclass(value) and not isinstance(value, type) else value


@dataclass(frozen=True, eq=False, kw_only=True)
class ShardTask(CellTask):
    """A shard to simulate."""

    first_seed: int
    """Seed of the first episode; the next episodes have the next seeds."""
    episodes: int


def simulate(task: ShardTask) -> ShardFiles:
    """Simulates a shard and returns its rows as Parquet files.

    Raises:
        RunFolderError: The installed software is no longer that of the task.
        CharmsBenchError: An agent cannot be made, or fails.
    """
    names = harness_names()
    forget_identities()
    now = installed(task.ego, task.traffic, task.networks, task.scene.network is not None)
    if changed := now.differences(task.software):
        raise RunFolderError(
            f"{task.title}: changed since the run began: {changed}; run the suite again"
        )
    ego, count, first = task.ego.key, task.episodes, task.first_seed
    drivers = CheckedDrivers(task.ego, task.traffic, task.networks, task.scene, first)
    with np.errstate(divide="warn", over="warn", under="ignore", invalid="warn"):
        engine = engine_on(task.scene)
        recordings: list[Recording] = []
        egos = 1
        while len(recordings) < egos:
            simulation = Simulation(task.scene, count, ego, drivers.traffic, drivers.agents, engine)
            simulation.engine.ego_index, egos = len(recordings), simulation.engine.egos
            simulation.reset(np.arange(first, first + count, dtype=np.uint64))
            recordings.append(Recording.of(simulation))
        drivers.finish(task.title)
    if problem := problem_of(names):
        raise AgentError(f"{task.title}: {problem}; its rows are rejected")
    # Rows depend on the content of a network and not on its path, like the key.
    copies = {
        driver.key: f"{task.software.agents[driver.origin]['weights_sha256']}.onnx"
        for driver in drivers.drivers
        if is_network(driver.name)
    }
    conduct = _of_egos([recording.drivers() for recording in recordings])
    conduct = conduct.with_columns(pl.col("agent").replace(copies))
    return {
        "steps": in_parquet(_of_egos([recording.steps() for recording in recordings])),
        "counts": in_parquet(recordings[0].counts()),
        "drivers": in_parquet(conduct.sort(*keys_of(conduct), *DRIVER_KEYS[1:])),
        "episodes": in_parquet(_of_egos([recording.episodes() for recording in recordings])),
    }


def _of_egos(rows: list[pl.DataFrame]) -> pl.DataFrame:
    """The rows of all egos of some episodes, which have been simulated once for each ego."""
    if len(rows) == 1:
        return rows[0]
    found: pl.DataFrame = pl.concat(with_ego_index(each, k) for k, each in enumerate(rows))
    return found.sort(*keys_of(found), maintain_order=True)


def engine_on(scene: SceneSettings) -> MakeEngine:
    """The engine of some scenes: those on highway-env's roads have their own."""
    if scene.network is None:
        return BatchedEngine
    from charms_bench.roads.engine import RoadEngine  # slow to import

    return RoadEngine


class CheckedDrivers:
    """The agents and the traffic of a cell, checked as in `plugins.consistency`.

    `seed` chooses the questions that are asked again.
    """

    def __init__(
        self,
        ego: AgentSpec,
        traffic: TrafficSpec,
        networks: Mapping[str, Path],
        scene: SceneSettings,
        seed: int,
    ) -> None:
        rng = np.random.default_rng([seed, 2])
        self.traffic = CheckedTraffic(traffic.make(), traffic.make(), rng)
        self.drivers = drivers_of(ego, self.traffic)
        self.agents: dict[str, CheckedPolicy | CheckedModel] = {}
        for driver in self.drivers:
            agent, other = (agent_of(driver, networks, instance) for instance in (0, 1))
            try:
                self.agents[driver.key] = checked(agent, other, scene, rng)
            except BrokenWordError as error:
                raise AgentError(f"agent '{driver.key}': {error}") from error

    def finish(self, title: str) -> None:
        """Asks the last questions; raises an `AgentError` if an answer differs."""
        every: dict[str, Checked[Any]] = {f"agent '{key}'": it for key, it in self.agents.items()}
        for whose, each in {**every, "the traffic": self.traffic}.items():
            each.finish(f"{whose}, {title}")


def in_parquet(rows: pl.DataFrame) -> bytes:
    """Returns rows as a Parquet file."""
    file = BytesIO()
    # Only queries on parts of large files need statistics; level 1 compresses as well as level 3.
    rows.write_parquet(file, compression_level=1, statistics=False)
    return file.getvalue()


def installed(
    ego: AgentSpec, traffic: TrafficSpec, networks: Mapping[str, Path], on_network: bool = False
) -> Software:
    """Returns what is installed here and decides the rows of a cell.

    `on_network` says whether the cell is on one of highway-env's roads.
    """
    agents = identify_agents(ego, traffic, networks)
    code = harness_sha256(without=None if on_network else ROADS)
    return Software(code, library_versions(), agents)


def identify_agents(
    ego: AgentSpec, traffic: TrafficSpec, networks: Mapping[str, Path]
) -> dict[str, dict[str, str]]:
    """Returns what tells each agent of a cell, and its traffic plugin, from other versions.

    It is, by `AgentSpec.origin`, the hash of a policy's weights, its meta-actions if they have
    other names than highway-env's, and the plugin's distribution, version and hash of its code.
    """
    drivers = drivers_of(ego, traffic_of(traffic))
    found = {
        driver.origin: dict(_identity(driver.model_dump_json(), networks.get(driver.name)))
        for driver in drivers
    }
    name = traffic.name
    if name is not None and (origin := _origin_of_traffic(name)):
        found[f"traffic {name}"] = dict(origin)
    return found


@cache
def _identity(spec_json: str, network: Path | None) -> Mapping[str, str]:
    """What tells an agent from other versions; many cells share it, so it is found out once."""
    agent = _cached_agent(spec_json, network, 0)
    weights = {}
    if isinstance(agent, Policy):
        weights = {"weights_sha256": agent.weights_sha256}
        actions = meta_actions_of(agent.actions)
        meant, default = (
            [(each.name, each.lanes) for each in some] for some in (actions, DEFAULT_ACTIONS)
        )
        if meant not in ([], default):
            weights["actions"] = described_actions(actions)  # which rows are indices into
    if isinstance(agent, DriverModel) and agent.files_sha256:
        weights = {"files_sha256": agent.files_sha256}
    name = AgentSpec.model_validate_json(spec_json).name
    if is_network(name):
        return weights
    foreseen = {}
    if isinstance(agent, Policy) and agent.rollouts_with:
        others_of(agent)  # is not a planner too
        others = _identity(AgentSpec(name=agent.rollouts_with).model_dump_json(), None)
        foreseen = {f"others_{field}": value for field, value in others.items()}
    return weights | foreseen | origin_of(find(AGENTS, name))


@cache
def _origin_of_traffic(name: str) -> Mapping[str, str]:
    """See `origin_of`; empty for a traffic that is an agent or a network."""
    traffics = plugins(TRAFFIC)
    return origin_of(traffics[name]) if name in traffics else {}


def origin_of(plugin: Plugin) -> dict[str, str]:
    """Returns a plugin's distribution, its version and the hash of its code."""
    return {
        "distribution": plugin.distribution,
        "version": plugin.version,
        "code_sha256": code_sha256(plugin.entry_point.module),
    }


def agent_of(spec: AgentSpec, networks: Mapping[str, Path], instance: int = 0) -> Agent:
    """Returns an agent, of which each instance is made once per process."""
    return _cached_agent(spec.model_dump_json(), networks.get(spec.name), instance)


@lru_cache
def _cached_agent(spec_json: str, network: Path | None, instance: int) -> Agent:
    spec = AgentSpec.model_validate_json(spec_json)
    return spec.make({} if network is None else {spec.name: network})


def traffic_of(spec: TrafficSpec) -> Traffic:
    """Returns a traffic, made once per process, whose agents are looked up and which drives none.

    A suite can have 100 cells with the same traffic.
    """
    key = spec.model_dump_json()
    if key not in _traffics:
        _traffics[key] = spec.make()
    return _traffics[key]


_traffics: dict[str, Traffic] = {}


def forget_agents() -> None:
    """Has agents and traffics made again: a plugin or a network's file may have changed since."""
    _traffics.clear()
    _cached_agent.cache_clear()
    forget_identities()


def forget_identities() -> None:
    """Has `identify_agents` find out again what tells agents and traffics from other versions."""
    _identity.cache_clear()
    _origin_of_traffic.cache_clear()
