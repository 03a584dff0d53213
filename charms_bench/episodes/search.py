"""Searches the parameters of a scenario or of a road for failures, by differential evolution.

A failure is a preventable collision: the agent collides, and a reference driver of the suite does
not. The search minimises the agent's margin to a collision (`severity`); where it collides, the
larger one of its margin and the negative of the reference drivers' largest margin, which is below 0
in a failure only. So the reference drivers are simulated only where the agent collides.

A point at which prescribed vehicles collide with one another is no scenario: it is left out.
Where the configuration of a road is searched, all episodes of the suite are simulated at each
point: it is as good as the best of them, and a failure if one of them is.

Agents that draw their actions, the ego, other vehicles or reference drivers, draw others in each
episode. So a failure is noted only if it is one in the episode of the suite of failures, too.

The margins of all points that are simulated together are kept in a file. A search that was
interrupted is done again from its beginning, with these margins instead of simulations.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import count
from pathlib import Path

import numpy as np
from pydantic import TypeAdapter

from charms_bench.engine.pile_ups import pile_ups
from charms_bench.engine.simulation import Simulation
from charms_bench.episodes.severity import margins
from charms_bench.errors import InputError, suggestion
from charms_bench.foundation.words import counted
from charms_bench.plugins.registry import AGENTS, is_network, plugins
from charms_bench.plugins.specs import AgentSpec, agents_of, networks_of
from charms_bench.runs.checked_result import read_result, write_result
from charms_bench.runs.code_hashes import harness_sha256
from charms_bench.runs.shard import CellTask, engine_on, installed
from charms_bench.runs.suite import Cell, EgoEntry, Suite, Surroundings, TrafficEntry
from charms_bench.world.parameter_points import from_unit_cube, sobol
from charms_bench.world.scenario import Parameter, Scenario
from charms_bench.world.scene import Floats, Ints, SceneSettings

FIRST_POINTS = 32
"""Sobol points that every start of the search simulates. Chosen, like the other numbers and the
strategy, with seeds that no result uses."""
POPULATION = 8
"""Points of a generation; at first, the best of the Sobol points."""
GENERATIONS = 12
"""Generations after which the search starts again, from the next Sobol points."""

MANIFEST = "search.json"
FOUND = "found.yaml"
"""The suite of the failures, in the folder of a search."""

Point = dict[str, float]
_MARGINS = TypeAdapter(list[float])


@dataclass
class Search:
    """The failures of an agent, and how many episodes it took to find them."""

    cell: Cell
    """On a road, its scene is that of the suite, whatever the road and the scenario."""
    references: Sequence[EgoEntry]
    """The drivers that decide which collisions are preventable; if there are none, all are."""
    folder: Path
    """Folder that relative paths of networks start from."""
    path: Path | None = None
    """Folder of the search; if there is none, the margins are not kept."""
    seeds: Ints = field(default_factory=lambda: np.zeros(1, dtype=np.int64))
    """Those of the episodes of a road; a scenario has one episode at each point."""
    failures: list[Point] = field(default_factory=list)
    preventable_by: list[list[str]] = field(default_factory=list)
    """The titles of the reference drivers that avoid each failure."""
    simulations: int = 0
    """Episodes simulated, also before an interruption, those of the reference drivers included."""
    left_out: int = 0
    """How many of these episodes are left out, because prescribed vehicles collide in them."""
    simulations_to_first: int | None = None
    found: Callable[[], None] = lambda: None
    """Called when there are new failures."""
    told: Callable[[int], None] = lambda episodes: None
    """Called with the episodes simulated since the last call."""

    def __repr__(self) -> str:
        found = (
            f"{counted(len(self.failures), 'failure')} in {counted(self.simulations, 'episode')}"
        )
        return f"<Search of {self.cell.title}: {found}>"

    @property
    def varies_road(self) -> bool:
        """Whether the points are configurations of a road, and not those of a scenario."""
        return self.cell.traffic.traffic.scenario is None

    def run(self, failures: int, budget: int, seed: int) -> None:
        """Searches until there are so many failures, or so many episodes have been simulated."""
        from scipy.optimize import differential_evolution

        dimensions = len(self._parameters)

        episodes = self.seeds.size if self.varies_road else 1

        def is_over(*_: object) -> bool:
            return len(self.failures) >= failures or self.simulations >= budget

        for start in count():
            if is_over():
                break
            points = min(FIRST_POINTS, max(1, (budget - self.simulations) // episodes))
            first = sobol(dimensions, start * FIRST_POINTS, points, scramble=seed)
            best = first[np.argsort(self.values(first))[:POPULATION]]
            if is_over() or points < POPULATION:
                break
            differential_evolution(
                lambda coordinates: self.values(coordinates.T),
                [(0.0, 1.0)] * dimensions,
                strategy="randtobest1bin",
                init=best,
                maxiter=GENERATIONS,
                mutation=(0.4, 0.9),
                recombination=0.9,
                tol=0.0,
                polish=False,
                vectorized=True,
                updating="deferred",
                callback=is_over,
                rng=np.random.default_rng([seed, start]),
            )
        del self.failures[failures:], self.preventable_by[failures:]

    def values(self, coordinates: Floats) -> Floats:
        """Returns what the search minimises at points (R, P) of the unit cube; notes failures."""
        points = self._points_at(coordinates)
        found = self._margins_of_scenarios(points)
        collides = np.nonzero((found < 0).any(axis=1))[0]
        avoided_by: list[list[str]] = [[] for _ in collides]
        if collides.size and self.references:
            asked, own = [points[k] for k in collides], found[collides]
            theirs = np.array([self._margins(each.agent, asked) for each in self.references])
            found[collides] = np.where(own < 0, np.maximum(own, -theirs.max(axis=0)), own)
            avoids = ((own < 0) & (theirs >= 0)).any(axis=2)
            for k, each in zip(*np.nonzero(avoids.T), strict=True):
                avoided_by[k].append(self.references[each].title)
        # Each generation begins with points that were simulated before.
        new = [
            (points[k], names)
            for k, names in zip(collides, avoided_by, strict=True)
            if (names or not self.references) and points[k] not in self.failures
        ]
        for point, names in new:
            avoided = self._avoided_again(point) if self._draws else names
            if avoided is not None:
                self.failures.append(point)
                self.preventable_by.append(avoided)
                self.simulations_to_first = self.simulations_to_first or self.simulations
        if new and self.failures:
            self.found()
        return np.asarray(found.min(axis=1))

    def _points_at(self, coordinates: Floats) -> list[Point]:
        values = from_unit_cube(self._parameters, coordinates)
        points = [
            {name: float(each[r]) for name, each in values.items()} for r in range(len(coordinates))
        ]
        if not self.varies_road:
            return points
        from charms_bench.roads.configuration import whole  # which scenarios do not need

        return [whole(point) for point in points]

    def _margins_of_scenarios(self, points: list[Point]) -> Floats:
        """The ego's margins, as `_margins`; infinite where prescribed vehicles collide."""
        if self.varies_road:
            return self._margins(self.cell.ego.agent, points)
        settings = self._settings_of(points)
        is_pile_up = pile_ups(settings, np.arange(len(points)), engine_on(settings))
        found = np.full((len(points), 1), np.inf)
        asked = [points[k] for k in np.nonzero(~is_pile_up)[0]]
        if asked:
            found[~is_pile_up] = self._margins(self.cell.ego.agent, asked)
        if count := int(is_pile_up.sum()):
            self.left_out += count
            self.simulations += count
            self.told(count)
        return found

    @property
    def _scenario(self) -> Scenario:
        scenario = self.cell.traffic.traffic.scenario
        assert scenario is not None
        return scenario

    @property
    def _parameters(self) -> Mapping[str, Parameter]:
        road = self.cell.road
        return road.parameters if road and self.varies_road else self._scenario.parameters

    def _settings_of(self, points: Sequence[Point]) -> SceneSettings:
        scenario, road = None, self.cell.road
        if not self.varies_road:
            scenario = self._scenario.model_copy(update={"points": tuple(points)})
        if road is None:
            return self.cell.scene.of_scenario(scenario)
        from charms_bench.roads.settings import on_road  # slow to import

        road = road.at(points[0]) if scenario is None else road
        return on_road(self.cell.scene, road.road, road.duration_s, scenario)

    @cached_property
    def _draws(self) -> bool:
        """Whether the ego, another vehicle of the scenario or a reference driver draws.

        If so, a point of a scenario has other draws as an episode of the suite of failures.
        """
        if self.varies_road:
            return False
        traffic = self.cell.traffic.traffic.make()
        egos = [self.cell.ego.agent, *(each.agent for each in self.references)]
        agents = (agents_of(ego, traffic, self.folder).values() for ego in egos)
        return any(getattr(agent, "noise_draws", 0) for some in agents for agent in some)

    def _avoided_again(self, point: Point) -> list[str] | None:
        """Who avoids this point's episode of the suite of failures; None if it is no failure."""
        episode = len(self.failures)
        if self._margins(self.cell.ego.agent, [point], episode)[0, 0] >= 0:
            return None
        avoided = [
            each.title
            for each in self.references
            if self._margins(each.agent, [point], episode)[0, 0] >= 0
        ]
        return avoided if avoided or not self.references else None

    def _margins(self, agent: AgentSpec, points: list[Point], first: int = 0) -> Floats:
        """The margins [R, E] at points, those of a scenario in the episodes from `first` on."""
        cell = self.cell
        if self.varies_road and len(points) > 1:
            return np.concatenate([self._margins(agent, [point]) for point in points])
        seeds = self.seeds if self.varies_road else first + np.arange(len(points))
        traffic = cell.traffic.traffic.make()
        agents = agents_of(agent, traffic, self.folder)
        settings = self._settings_of((*points[:1] * first, *points))
        file = None
        if self.path is not None:
            networks, on_network = networks_of(agent, traffic, self.folder), cell.road is not None
            software = installed(agent, cell.traffic.traffic, networks, on_network)
            task = CellTask(
                title=cell.title,
                scene=settings,
                ego=agent,
                traffic=cell.traffic.traffic,
                networks=networks,
                software=replace(software, code_sha256=harness_sha256(entry=__name__)),
            )
            file = self.path / "runs" / f"{self.simulations:08d}-{task.key[:16]}.json"
        found = None if file is None else read_result(file, _MARGINS)
        if found is None or len(found) != seeds.size:
            engine = engine_on(settings)
            simulation = Simulation(settings, seeds.size, agent.key, traffic, agents, engine)
            found = margins(simulation, seeds).tolist()
            if file is not None:
                write_result(file, found)
        self.simulations += seeds.size
        self.told(seeds.size)
        return np.array(found).reshape(len(points), -1)


def surroundings_of(
    path: Path, suite: Suite, road: str | None, traffic: str | None
) -> Surroundings:
    """A suite's scenario, or its road with parameters and a traffic model; None is the only one.

    A scenario can be on one of the roads. Raises an `InputError`.
    """
    varied = {each.title: each for each in suite.roads if each.parameters}
    traffics = {each.title: each for each in suite.traffics}
    scenarios = [each.title for each in suite.traffics if each.traffic.scenario]
    if not suite.roads or traffic in scenarios or (scenarios and not varied):
        entry = scenario_of(path, suite, traffic)
        roads = {each.title: each for each in suite.roads}
        return Surroundings(roads[_chosen(path, "road", roads, road)] if roads else None, entry)
    if not varied:
        what = "no road has `parameters` to search; give one of them, such as"
        raise InputError(f"{path}: {what} {{vehicles_count: [3, 12]}}, the range of a number")
    return Surroundings(
        varied[_chosen(path, "road", varied, road)],
        traffics[_chosen(path, "traffic", traffics, traffic)],
    )


def _chosen(path: Path, option: str, known: Mapping[str, object], title: str | None) -> str:
    """The title, or the only one; raises an `InputError`."""
    title = next(iter(known)) if title is None and len(known) == 1 else title
    if title is None:
        how = f"choose one with --{option}" if known else "expected one with parameters"
        what = f"{len(known)} that can be searched; {how}"
        raise InputError(f"{path}: {what}. {suggestion('', known)}")
    if title not in known:
        what = f"--{option}: none called '{title}' can be searched"
        raise InputError(f"{path}: {what}. {suggestion(title, known)}")
    return title


def scenario_of(path: Path, suite: Suite, title: str | None) -> TrafficEntry:
    """A suite's scenario; None is the only one. Raises an `InputError`."""
    found = {
        entry.title: entry
        for entry in suite.traffics
        if entry.traffic.scenario is not None and entry.traffic.scenario.parameters
    }
    return found[_chosen(path, "traffic", found, title)]


def ego_of(path: Path, suite: Suite, name: str | None) -> EgoEntry:
    """A suite's ego by its label, or an agent; None is the only one. Raises an `InputError`."""
    known = {entry.title: entry for entry in suite.egos if entry.title not in suite.preventable_by}
    if name is None or name in known:
        return known[_chosen(path, "ego", known, name)]
    if is_network(name):
        what = "is not the label of an ego; give a network's file with --agent"
        raise InputError(f"{path}: --ego {name} {what}")
    if name not in plugins(AGENTS):
        everyone = {**known, **plugins(AGENTS)}
        raise InputError(f"{path}: no agent named '{name}'. {suggestion(name, everyone)}")
    return EgoEntry(agent=AgentSpec(name=name))
