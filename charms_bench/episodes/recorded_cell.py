"""One ego in one traffic of a finished run: simulated again, and compared with the run's rows."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from types import MappingProxyType

import numpy as np
import polars as pl
from numpy.typing import NDArray

from charms_bench.engine.simulation import Simulation
from charms_bench.errors import InputError, RunFolderError, suggestion
from charms_bench.foundation.words import counted
from charms_bench.plugins.agent import Agent, Policy
from charms_bench.plugins.specs import AgentSpec, drivers_of, networks_of
from charms_bench.plugins.traffic import Traffic
from charms_bench.recording.columns import of_ego
from charms_bench.runs.audit_software import names_installed_code
from charms_bench.runs.cells import CellRows
from charms_bench.runs.finished_run import EPISODES_AND_STEPS, FinishedRun, read_rows
from charms_bench.runs.shard import engine_on, identify_agents
from charms_bench.runs.suite import Cell
from charms_bench.world.actions import DEFAULT_ACTIONS, meta_actions_of
from charms_bench.world.scene import SceneSettings


def title_with(cell: Cell, ego_index: int | None) -> str:
    """The name of a cell, with the number of one of several egos."""
    return cell.title if ego_index is None else f"{cell.title}, ego {ego_index}"


@dataclass(frozen=True)
class RecordedCell:
    """A cell of a finished run."""

    run: FinishedRun
    index: int
    """Its place among the cells of the suite."""
    folder: Path
    """Where relative paths of networks in the suite start."""
    ego_index: int = 0
    """Which of several egos; see `recording.columns.EGO_INDEX`."""

    @property
    def cell(self) -> Cell:
        """What was run."""
        return self.run.suite.cells[self.index]

    @property
    def rows(self) -> CellRows:
        """What was recorded."""
        return self.run.cell(self.index)

    @property
    def egos(self) -> int:
        """The number of egos that drive in its episodes."""
        from charms_bench.roads.settings import egos_on  # slow to import

        return 1 if self.cell.road is None else egos_on(self.cell.scene)

    @property
    def title(self) -> str:
        """Its name in messages, with the number of the ego if there are several."""
        return title_with(self.cell, self.ego_index if self.egos > 1 else None)

    @property
    def drivers(self) -> tuple[AgentSpec, ...]:
        """The agents that drive in it."""
        cell = self.cell
        return drivers_of(cell.ego.agent, cell.traffic.traffic.make())

    @property
    def networks(self) -> dict[str, Path]:
        """The files of its networks: the copies in the run folder, if it has them."""
        cell = self.cell
        given = networks_of(cell.ego.agent, cell.traffic.traffic.make(), self.folder)
        return {name: self.run.folder.network(name) or path for name, path in given.items()}

    def simulation(
        self,
        scenes: int,
        guests: Mapping[str, Agent] = MappingProxyType({}),
        settings: SceneSettings | None = None,
        is_ego_outside: bool = False,
    ) -> Simulation:
        """A simulation of some of its scenes, in which guests may be seated.

        Args:
            guests: Agents beside those of the cell, by name; they act after these.
            settings: Other settings than the suite's.
            is_ego_outside: Whether the actions given to `Simulation.step` drive the ego. They are
                its agent's meta-actions, or if it has none, highway-env's.

        Raises an `InputError` if a guest cannot drive on the road of the cell.
        """
        cell, networks, traffic = self.cell, self.networks, self.cell.traffic.traffic.make()
        agents = {driver.key: driver.make(networks) for driver in self.drivers}
        if guests or is_ego_outside:
            if cell.scene.network is not None:
                check_guests(guests, cell.scene)
            seats = dict.fromkeys((*agents, *traffic.agents, *guests))
            traffic = _WithGuests(traffic, tuple(seats))
        key, actions = cell.ego.agent.key, DEFAULT_ACTIONS
        if is_ego_outside and isinstance(ego := agents[key], Policy):
            actions = meta_actions_of(ego.actions) or actions
        simulation = Simulation(
            settings or cell.scene,
            scenes,
            None if is_ego_outside else key,
            traffic,
            {**guests, **agents},
            engine_on(settings or cell.scene),
            actions=actions,
        )
        simulation.engine.ego_index = self.ego_index
        return simulation

    def steps(self, episodes: Sequence[int]) -> pl.DataFrame:
        """The step rows of these episodes in the run folder; raises a `RunFolderError`."""
        run = self.run
        first, last = run.suite.seed, run.suite.seed + run.suite.episodes - 1
        for episode in episodes:
            if not first <= episode <= last:
                raise RunFolderError(
                    f"{run.folder.path}: holds the episodes {first} to {last}, not {episode}"
                )
        shards = [each for each in run.shards_of[self.index] if {*each.seeds} & {*episodes}]
        _, steps = read_rows(run.folder, EPISODES_AND_STEPS, shards)
        return of_ego(steps, self.ego_index).filter(pl.col("episode").is_in(list(episodes)))

    def shard_of(self, episode: int) -> range:
        """The seeds of the episodes that the run simulated together with this one."""
        shards = self.run.shards_of[self.index]
        return next(each.seeds for each in shards if episode in each.seeds)

    def check_steps(self, stored: pl.DataFrame, again: pl.DataFrame) -> None:
        """Raises a `RunFolderError` if the rows simulated `again` are not those of `steps`."""
        if again.equals(stored):
            return
        both = stored.join(again, on=["episode", "step"], how="full", coalesce=True, suffix="_now")
        differing = [
            (row["episode"], row["step"], name, row[name], row[f"{name}_now"])
            for row in both.iter_rows(named=True)
            for name in stored.columns
            if name not in ("episode", "step") and row[name] != row[f"{name}_now"]
        ]
        episode, step, name, then, now = min(differing, key=lambda difference: difference[:2])
        raise RunFolderError(
            f"{self.run.folder.path}: episode {episode} of {self.cell.ego.title} no longer follows "
            f"the recorded trajectory: step {step}, {name} was {then}, now {now}. {self._reason()}"
        )

    def _reason(self) -> str:
        """Says which software the run was made with, agents first, or that it is this one."""
        manifest, cell = self.run.folder.manifest(), self.cell
        agents = identify_agents(cell.ego.agent, cell.traffic.traffic, self.networks)
        recorded = manifest.get("agents", {})
        changed = [name for name, identity in agents.items() if recorded.get(name) != identity]
        if changed:
            names = ", ".join(changed)
            return f"The run used other versions of {names}; install those to replay it"
        if names_installed_code(manifest):
            return (
                "The software is that of the run, so its rows have been changed, or an agent does "
                "not repeat its answers; `charms-bench audit` and `charms-bench check` tell which"
            )
        versions = f"charms-bench {manifest.get('charms_bench')} and {manifest.get('versions')}"
        return f"The run was made with {versions}; install those to replay it"


def check_guests(guests: Mapping[str, Agent], scene: SceneSettings) -> None:
    """Raises an `InputError` if a guest cannot drive on the road of some scenes."""
    from charms_bench.roads.settings import problem_of_driver  # slow to import

    for name, agent in guests.items():
        if problem := problem_of_driver(agent):
            raise InputError(
                f"agent '{name}' cannot drive on the road '{scene.network}': {problem}"
            )


class _WithGuests(Traffic):
    """A traffic in which more agents may be seated."""

    def __init__(self, traffic: Traffic, agents: tuple[str, ...]) -> None:
        self.agents = agents
        self._traffic = traffic

    def assign(self, rng: np.random.Generator, scenes: int, vehicles: int) -> NDArray[np.str_]:
        return self._traffic.assign(rng, scenes, vehicles)


def find_cells(
    run: FinishedRun,
    folder: Path,
    ego: str | None = None,
    traffic: str | None = None,
    road: str | None = None,
    ego_index: int | None = None,
) -> list[RecordedCell]:
    """Returns the cells whose ego, traffic and road have these titles; None is any.

    A cell with several egos is listed for each of them, or for one.
    """
    suite = run.suite
    asked = (("ego", ego, suite.egos), ("traffic", traffic, suite.traffics))
    for what, title, entries in (*asked, ("road", road, suite.roads)):
        if what == "road" and title is not None and not entries:
            raise RunFolderError(f"{run.folder.path}: its suite has no `roads`; remove --road")
        titles = {entry.title: entry for entry in entries}
        if title is not None and title not in titles:
            known = suggestion(title, titles)
            raise RunFolderError(f"{run.folder.path}: no {what} called '{title}'. {known}")
    found = [
        RecordedCell(run, index, folder, ego_index or 0)
        for index, cell in enumerate(run.suite.cells)
        if ego in (None, cell.ego.title)
        and traffic in (None, cell.traffic.title)
        and (road is None or (cell.road is not None and cell.road.title == road))
    ]
    if ego_index is not None:
        return found
    return [replace(each, ego_index=k) for each in found for k in range(each.egos)]


def find_cell(
    run: FinishedRun,
    folder: Path,
    ego: str | None,
    traffic: str | None,
    road: str | None = None,
    how: str = "",
    ego_index: int = 0,
) -> RecordedCell:
    """Returns the only one of `find_cells`, or raises an `InputError` that says `how` to choose."""
    cells = find_cells(run, folder, ego, traffic, road, ego_index)
    how = how or ("--ego, --road and --traffic" if run.suite.roads else "--ego and --traffic")
    if len(cells) > 1:
        titles = "; ".join(each.cell.title for each in cells)
        first, last = run.suite.seed, run.suite.seed + run.suite.episodes - 1
        raise InputError(
            f"{run.folder.path}: {len(cells)} cells have the episodes {first} to {last}; choose "
            f"one with {how}. Cells: {titles}"
        )
    if not 0 <= ego_index < (count := cells[0].egos):
        raise InputError(
            f"{run.folder.path}: {cells[0].cell.title} has {counted(count, 'ego')}; expected an "
            f"ego index from 0 to {count - 1}, found {ego_index}"
        )
    return cells[0]
