"""Suites: what an evaluation runs, read from YAML."""

import hashlib
import json
from collections.abc import Mapping, Sequence
from functools import cached_property
from itertools import product, starmap
from pathlib import Path
from typing import Annotated, Any, NamedTuple

import numpy as np
from pydantic import BeforeValidator, Field, ValidationError, ValidationInfo, model_validator

from charms_bench.errors import ALL_METRICS, InputError, ScenarioError, first_problem, suggestion
from charms_bench.foundation.fields import (
    UNLESS_EMPTY,
    Finite,
    FrozenModel,
    Line,
    Name,
    NonNegative,
)
from charms_bench.foundation.names import alike
from charms_bench.foundation.words import counted
from charms_bench.humans.reference import ReferenceSpec
from charms_bench.metrics import PAPER, ROADS, SCENARIOS, WARM_UP_S, MetricSet, standard_after
from charms_bench.plugins.agent import DriverModel
from charms_bench.plugins.registry import AGENTS, find, is_network, make_agent
from charms_bench.plugins.specs import AgentSpec, TrafficSpec
from charms_bench.runs.cells import title_of
from charms_bench.runs.document import Document, Location
from charms_bench.runs.suite_roads import RoadEntry, reject_roads_of_traffic, with_defaults_of_roads
from charms_bench.world.named_road import DRAWN, ENVIRONMENT
from charms_bench.world.placement import Placing, driver_parameters, place
from charms_bench.world.recorded_moments import RecordedScene, moments_of
from charms_bench.world.scenario import PRESCRIBED, Scenario
from charms_bench.world.scene import EVALUATION_SEEDS, Ints, SceneSettings
from charms_bench.world.vehicle_types import check_driver_parameters

EPISODES_LIMIT = 10_000_000
"""Most episodes of a suite, in all cells together."""
PLACED_AT_ONCE = 100_000
"""Episodes whose placements are checked at once."""
ENTRIES_LIMIT = 100
"""Most egos of a suite, and most traffic models."""
UNDECIDING = (
    "episodes", "title", "note", "columns", "warm_up_s", "pairs", "preventable_by", "references"
)  # fmt: skip
"""Fields of a suite that decide no row: all but the first affect only how results are shown."""


def _listed(value: object) -> object:
    """A list, also of a single name or of none."""
    return [value] if isinstance(value, str) else [] if value is None else value


class EgoEntry(FrozenModel):
    """An ego of the suite; a plain text is its agent."""

    plain_text = "agent"
    agent: AgentSpec
    """The agent that drives the ego; a plain text is its name, or the path of a network."""
    label: Name | None = None
    """Its name in tables; by default the agent's, and its style if it is given one."""
    paper: dict[str, Finite] = Field(default={})
    """Published values of the metrics of the set `paper`, shown beside the measured ones."""

    @property
    def title(self) -> str:
        """Its name in tables."""
        return self.label or ", ".join(filter(None, (self.agent.name, self.agent.style)))


class TrafficEntry(FrozenModel):
    """A traffic model of the suite; a plain text is the traffic."""

    traffic: TrafficSpec
    """The traffic model; a plain text is its name, or that of the agent of every vehicle."""
    label: Name | None = None
    """Its name in tables; by default the traffic model's."""
    paper: dict[str, Finite] = Field(default={})
    """Published values of the metrics of the set `paper`, shown beside the measured ones."""

    plain_text = "traffic"

    @property
    def title(self) -> str:
        """Its name in tables."""
        spec = self.traffic
        return self.label or spec.name or " + ".join(spec.mixture) or "scenario"


class Surroundings(NamedTuple):
    """Where the egos of a suite drive, and among whom."""

    road: RoadEntry | None
    """None is the straight road of the suite's scene."""
    traffic: TrafficEntry

    @property
    def title(self) -> str:
        """Their name in tables that have one name for both."""
        return title_of([each.title for each in self if each is not None])


class Cell(FrozenModel):
    """One ego on one road in one traffic."""

    ego: EgoEntry
    road: RoadEntry | None = None
    """None is the straight road of the suite's scene."""
    traffic: TrafficEntry
    scene: SceneSettings
    """The suite's, with the vehicles of the traffic's scenario, or on its road."""

    @property
    def surroundings(self) -> Surroundings:
        """Its road and its traffic."""
        return Surroundings(self.road, self.traffic)

    @property
    def labels(self) -> tuple[str, ...]:
        """Those of its rows in tables; see `Suite.with_road`."""
        return tuple(each.title for each in (self.ego, *self.surroundings) if each is not None)

    @property
    def title(self) -> str:
        """Its name in messages."""
        return f"{self.ego.title} in {self.surroundings.title}"

    @property
    def paper(self) -> dict[str, float]:
        """Values that the paper reports for the cell, by metric."""
        return {**self.traffic.paper, **self.ego.paper}


class Suite(FrozenModel):
    """An evaluation: every ego on every road in every traffic model, on the same episodes."""

    suite: Annotated[str, Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9_-]{0,63}$")]
    """Its name, and that of its tables."""
    title: Line = ""
    """A line that is printed above its tables."""
    note: Line = ""
    """What a reader of its tables has to know, such as what an agent was trained on."""
    episodes: Annotated[int, Field(ge=1, le=EPISODES_LIMIT)]
    """Episodes of each ego on each road in each traffic model."""
    seed: Annotated[int, Field(ge=0, lt=EVALUATION_SEEDS)] = 0
    """Seed of the first episode; the next episodes have the next seeds."""
    scene: RecordedScene = SceneSettings()
    """The road, the vehicles and the duration of an episode."""
    egos: Annotated[
        tuple[EgoEntry, ...], Field(min_length=1, max_length=ENTRIES_LIMIT, strict=False)
    ]
    """The agents that are evaluated, at most 100."""
    roads: Annotated[
        tuple[RoadEntry, ...],
        Field(min_length=1, max_length=ENTRIES_LIMIT, strict=False),
        UNLESS_EMPTY,
    ] = ()
    """Roads of highway-env or in files, at most 100. By default, it is the straight road of the
    scene."""
    traffics: Annotated[
        tuple[TrafficEntry, ...],
        Field(min_length=1, max_length=ENTRIES_LIMIT, strict=False, alias="traffic_models"),
    ]
    """What drives the vehicles around the ego, at most 100. With `roads`, the default is
    `environment`, the vehicles that a road's environment has itself."""
    columns: Annotated[tuple[Name, ...], Field(max_length=1000, strict=False)] = ()
    """Metrics of the printed table; if empty, those of the paper."""
    warm_up_s: NonNegative | None = None
    """Time at the start of an episode in which the set `standard` counts only crashes and what
    drivers do to each other. By default, it is 3 s where all vehicles are drawn on the motorway,
    and 0 with scenarios, recordings and highway-env's roads."""
    pairs: bool = False
    """Whether to compare the egos pair by pair in a table."""
    preventable_by: Annotated[
        tuple[Name, ...], BeforeValidator(_listed), Field(max_length=2, strict=False)
    ] = ()
    """Label of the ego that decides which collisions are preventable: those in the episodes in
    which it does not crash itself. With two labels, tables show the collisions that only one of
    the two egos avoids apart from those that both avoid."""
    references: Annotated[
        tuple[ReferenceSpec, ...], Field(max_length=ENTRIES_LIMIT, strict=False)
    ] = ()
    """Human driving data to compare each traffic model with."""
    folder: Path = Field(default=Path(), exclude=True, strict=False)
    """Folder that relative paths start from: that of the suite file."""

    def __repr__(self) -> str:
        return f"<Suite {self.suite}: {self.size}, {counted(self.episodes, 'episode')} each>"

    __str__ = __repr__

    @property
    def size(self) -> str:
        """How many egos, roads and traffic models it has."""
        named = {"ego": self.egos, "road": self.roads, "traffic model": self.traffics}
        return " x ".join(counted(len(each), name) for name, each in named.items() if each)

    @model_validator(mode="before")
    @classmethod
    def _complete_roads(cls, value: Any) -> Any:
        """Writes down what the roads decide: the traffic model, the profile, and durations."""
        if not isinstance(value, dict):
            return value
        names = {"traffics", "traffic_models"} & {*value}
        for name in names:
            reject_roads_of_traffic(cls.__name__, name, value[name])
        roads = value.get("roads")
        if not isinstance(roads, list | tuple) or not roads:
            return value
        value = {**value} if names else {**value, "traffic_models": [{"traffic": ENVIRONMENT}]}
        return with_defaults_of_roads(value, roads)

    @model_validator(mode="before")
    @classmethod
    def _remember_folder(cls, value: object, info: ValidationInfo) -> object:
        if isinstance(value, dict) and info.context:
            if "folder" in value:
                raise ValueError("folder: unknown key")
            return {**value, "folder": info.context["folder"]}
        return value

    @model_validator(mode="after")
    def _fits_together(self) -> "Suite":
        if self.warm_up_s is not None and self.warm_up_s >= self.scene.duration_s:
            raise ValueError(
                f"warm_up_s: {self.warm_up_s:g} s leave nothing of an episode of "
                f"{self.scene.duration_s:g} s"
            )
        every: dict[str, Sequence[EgoEntry | RoadEntry | TrafficEntry]] = {
            "egos": self.egos,
            "roads": self.roads,
            "traffic models": self.traffics,
        }
        for what, entries in every.items():
            titles = [entry.title for entry in entries]
            if title := alike(titles):
                how = "are called" if titles.count(title) > 1 else "look in tables as if called"
                raise ValueError(f"two {what} {how} '{title}'; give them different labels")
        if self.pairs and (len(self.egos) < 2 or len(self.traffics) > 1):
            raise ValueError("pairs needs two or more egos and one traffic model")
        if not self.roads and any(each.traffic.is_environment for each in self.traffics):
            raise ValueError(f"the traffic model `{ENVIRONMENT}` is that of `roads`; give some")
        if self.references and len(self.egos) > 1:
            raise ValueError("references are compared with traffic models; expected one ego")
        if alike([reference.title for reference in self.references]):
            raise ValueError("a reference is given twice")
        if self.scene.recording and any(each.traffic.scenario for each in self.traffics):
            raise ValueError("a scenario and scene.recording both place vehicles; remove one")
        if self.scene.inflow and any(each.traffic.scenario for each in self.traffics):
            raise ValueError("a scenario places all vehicles; remove scene.inflow")
        labels = [ego.title for ego in self.egos]
        for name in self.preventable_by:
            if name not in labels:
                known = suggestion(name, dict.fromkeys(labels))
                raise ValueError(f"preventable_by: no ego called '{name}'. {known}")
        if len(set(self.preventable_by)) < len(self.preventable_by):
            raise ValueError(f"preventable_by: '{self.preventable_by[0]}' is given twice")
        total = self.episodes * len(self.egos) * max(1, len(self.roads)) * len(self.traffics)
        if total > EPISODES_LIMIT:
            raise ValueError(
                f"{counted(total, 'episode')} in all cells; expected at most {EPISODES_LIMIT:,}"
            )
        return self

    @property
    def surroundings(self) -> tuple[Surroundings, ...]:
        """Every road with every traffic model."""
        return tuple(starmap(Surroundings, product(self.roads or (None,), self.traffics)))

    @cached_property
    def cells(self) -> tuple[Cell, ...]:
        """Every ego in all surroundings; made once, because a suite can have 10,000 of them."""
        scenes = [self._scene_of(each) for each in self.surroundings]
        return tuple(
            Cell(ego=ego, road=road, traffic=traffic, scene=scene)
            for ego in self.egos
            for (road, traffic), scene in zip(self.surroundings, scenes, strict=True)
        )

    def _scene_of(self, surroundings: Surroundings) -> SceneSettings:
        road, traffic = surroundings
        if road is None:
            return self.scene.of_scenario(traffic.traffic.scenario)
        from charms_bench.roads.settings import on_road  # slow to import

        return on_road(self.scene, road.road, road.duration_s, traffic.traffic.scenario)

    def with_road(self, keys: tuple[str, ...]) -> tuple[str, ...]:
        """The keys of a table, and the road before the traffic model if there are `roads`."""
        place = keys.index("traffic") if "traffic" in keys else len(keys)
        return (*keys[:place], "road", *keys[place:]) if self.roads else keys

    @property
    def metric_sets(self) -> tuple[MetricSet, ...]:
        """The metrics of its tables."""
        has_roads = bool(self.roads)
        has_scenarios = any(each.traffic.scenario for each in self.traffics)
        warm_up_s = self.warm_up_s
        if warm_up_s is None:
            is_drawn = not (has_roads or has_scenarios or self.scene.recording)
            warm_up_s = WARM_UP_S if is_drawn else 0.0
        added = (ROADS,) * has_roads + (SCENARIOS,) * has_scenarios
        return (PAPER, standard_after(warm_up_s), *added)

    def deciding(self) -> dict[str, Any]:
        """Everything that decides its rows, except the number of episodes, as a manifest has it."""
        return self.model_dump(mode="json", exclude=set(UNDECIDING))

    def fingerprint(self) -> str:
        """The hash of `deciding`."""
        return hashlib.sha256(json.dumps(self.deciding(), sort_keys=True).encode()).hexdigest()


def load_suite(path: Path) -> Suite:
    """The suite in a YAML file; raises a `SuiteError`, also if a plugin is not installed."""
    return suite_of(Document(path))


def suite_of(document: Document) -> Suite:
    """Returns the suite of a document; see `load_suite`."""
    suite = document.validate(Suite)
    for what, entries in _entries(suite).items():
        for index, entry in enumerate(entries):
            try:
                for name in _names(entry):
                    if not is_network(name):
                        find(AGENTS, name)
            except InputError as error:
                raise document.error((what, index), str(error)) from error
            except ValidationError as error:  # a name in the options of a traffic
                raise document.error((what, index), first_problem(error)[1]) from error
        for index, entry in enumerate(entries):
            for metric in entry.paper:
                _check_metric(document, (what, index, "paper", metric), metric, (PAPER,))
    for index, road in enumerate(suite.roads):
        from charms_bench.roads.settings import reject_of_straight_roads  # slow to import

        try:
            reject_of_straight_roads(road.road, suite.scene.model_fields_set)
            for each in (road, *(road.bounds if road.parameters else ())):
                suite._scene_of(Surroundings(each, suite.traffics[0]))
        except InputError as error:
            raise document.error(("roads", index), str(error)) from error
    for where in suite.surroundings:
        at = ("traffic_models", suite.traffics.index(where.traffic), "traffic")
        scenario = where.traffic.traffic.scenario
        try:
            settings = suite._scene_of(where)
        except InputError as error:
            raise document.error(at, str(error)) from error
        if scenario is not None:
            end = suite.seed + suite.episodes
            for first in range(suite.seed, end, PLACED_AT_ONCE):
                numbers = np.arange(first, min(first + PLACED_AT_ONCE, end))
                check_placement(document, (*at, "scenario"), scenario, settings, numbers)
    _check_types(document, suite)
    if suite.scene.recording is not None:
        count = len(moments_of(suite.scene))
        if suite.episodes > count:
            what = f"the recordings have {count:,} moments; expected at most as many episodes"
            raise document.error(("episodes",), what)
    for index, road in enumerate(suite.roads):
        _check_moments(document, index, suite, road)
    for index, metric in enumerate(suite.columns):
        _check_metric(document, ("columns", index), metric, suite.metric_sets)
    return suite


def _check_moments(document: Document, index: int, suite: Suite, road: RoadEntry) -> None:
    """Raises a `SuiteError` if a recorded scene has fewer moments than the suite has episodes."""
    if road.start == DRAWN:
        return
    from charms_bench.roads.settings import moments_on  # slow to import

    cell = next(each for each in suite.cells if each.road == road)
    assert cell.scene.network is not None
    moments = moments_on(cell.scene.network)
    if suite.episodes > len(moments):
        what = f"the scene has {counted(len(moments), 'moment')} at which an episode can start; "
        what += f"expected at most as many episodes, found {suite.episodes:,}"
        raise document.error(("roads", index), what)


def check_placement(
    document: Document, at: Location, scenario: Scenario, settings: SceneSettings, numbers: Ints
) -> None:
    """Checks that the vehicles of a scenario can be placed at its points of these numbers (R,).

    Raises a `SuiteError` with the line, the document having the scenario at `at`, and the values of
    the parameters.
    """
    kind = Placing
    if settings.network is not None:
        from charms_bench.roads.scripts import PlacingOnRoad  # slow to import

        kind = PlacingOnRoad
    try:
        place(scenario, settings, numbers, kind)
        for k, vehicle in enumerate(scenario.vehicles):
            if vehicle.driver_parameters:
                ranges = _ranges_of(str(vehicle.agent))
                driver_parameters(scenario, k, settings, ranges, numbers)
    except ScenarioError as error:
        raise document.error((*at, *error.location), str(error)) from error


def _check_types(document: Document, suite: Suite) -> None:
    """Checks the driver parameters of a suite's vehicle types against the agents of each cell."""
    if not any(each.driver_parameters for each in suite.scene.vehicle_types):
        return
    entries = [entry for kind in _entries(suite).values() for entry in kind]
    ranges = {name: _ranges_of(name) for entry in entries for name in _names(entry)}
    for cell in suite.cells:
        models = {k: ranges[k] for k in (*_names(cell.ego), *_names(cell.traffic))}
        try:
            check_driver_parameters(cell.scene.vehicle_types, models)
        except ScenarioError as error:
            raise document.error(("scene", *error.location), str(error)) from error


def check_agents(document: Document, suite: Suite) -> None:
    """Raises a `SuiteError` with the line of the first agent that cannot be made as the suite says.

    Those with neither a file nor options are made where they drive.
    """
    for what, entries in _entries(suite).items():
        for index, entry in enumerate(entries):
            if isinstance(entry, EgoEntry):
                specs = [entry.agent]
            else:
                specs = [AgentSpec(name=name) for name in _names(entry)]
            for spec in (each for each in specs if is_network(each.name) or each.options):
                try:
                    spec.make({spec.name: suite.folder / spec.name})
                except InputError as error:
                    said = [
                        each for each in (*spec.options, spec.style) if f"'{each}'" in str(error)
                    ]
                    place = document.place_of(str(said[0] if said else spec.name), (what, index))
                    raise document.error(place, str(error)) from error


def _entries(suite: Suite) -> dict[str, Sequence[EgoEntry | TrafficEntry]]:
    """Returns the egos and the traffic models of a suite by their keys in YAML."""
    return {"egos": suite.egos, "traffic_models": suite.traffics}


def _check_metric(
    document: Document, location: Location, name: str, sets: tuple[MetricSet, ...]
) -> None:
    known = {metric.name: metric for metric_set in sets for metric in metric_set.metrics}
    if name not in known:
        said = suggestion(name, known, ALL_METRICS)
        raise document.error(location, f"no metric named '{name}'. {said}")


def _ranges_of(agent: str) -> Mapping[str, tuple[float, float]]:
    """Returns the parameters of an agent's drivers, and their ranges; policies have none."""
    made = None if is_network(agent) else make_agent(agent)
    return made.parameters if isinstance(made, DriverModel) else {}


def _names(entry: EgoEntry | TrafficEntry) -> tuple[str, ...]:
    """The names of an entry's agents; raises a `ValidationError` if one cannot be a name."""
    if isinstance(entry, EgoEntry):
        return (entry.agent.name,)
    agents = entry.traffic.make().agents
    return tuple(AgentSpec(name=name).name for name in agents if name != PRESCRIBED)
