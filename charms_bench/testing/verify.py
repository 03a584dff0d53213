"""Compares the two engines, simulation step by simulation step."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated

import numpy as np
from pydantic import Field

from charms_bench.engine import ENGINES
from charms_bench.engine.simulation import Simulation
from charms_bench.foundation.fields import FrozenModel
from charms_bench.plugins.specs import AgentSpec, TrafficSpec, drivers_of, networks_of
from charms_bench.runs.document import Document
from charms_bench.runs.suite import Suite
from charms_bench.testing.chunks import in_chunks
from charms_bench.world.actions import ActionKind
from charms_bench.world.scene import Floats, SceneSettings

TOLERANCE = 1e-6
"""Largest difference allowed in a position or a speed, m or m/s, or a heading, rad."""
EVENTS = ("present", "entry", "lane", "target_lane", "crashed", "timer_s")
CONTINUOUS = ("x", "y", "heading", "speed")
_CHUNK = 4


class Case(FrozenModel):
    """An ego in a traffic model in a kind of scene."""

    scene: SceneSettings
    ego: AgentSpec | None
    """If None, random accelerations and steering angles drive the ego; see `random_controls`."""
    traffic: TrafficSpec
    folder: Path = Path()

    @property
    def title(self) -> str:
        """A description in one line."""
        scene, ego = self.scene, self.ego.name if self.ego else "continuous actions"
        around = f"density {scene.density:g}"
        if scene.recording is not None:
            around = "recorded"
        elif scene.inflow is not None:
            around = "open boundaries"
        return (
            f"{ego}, {scene.profile.name}: {scene.lanes} lanes, {scene.vehicles} vehicles, {around}"
        )


@dataclass(frozen=True)
class Difference:
    """The first difference between the engines in an episode."""

    episode: int
    step: int
    """Simulation step, from 1."""
    vehicle: int
    quantity: str
    batched: float
    highway_env: float


@dataclass(frozen=True)
class Comparison:
    """What was compared in some episodes of a case, and the differences found."""

    case: Case
    episodes: int = 0
    steps: int = 0
    """Simulation steps of all episodes."""
    lane_changes: int = 0
    """How often a vehicle got a new target lane."""
    crashed: int = 0
    """Vehicles that have crashed by the end."""
    largest: float = 0.0
    """Largest difference of a continuous quantity, up to the first beyond the tolerance."""
    differences: tuple[Difference, ...] = ()

    def __add__(self, other: "Comparison") -> "Comparison":
        added = ("episodes", "steps", "lane_changes", "crashed", "differences")
        sums = {name: getattr(self, name) + getattr(other, name) for name in added}
        return replace(self, largest=max(self.largest, other.largest), **sums)


class _Cell(FrozenModel):
    scene: SceneSettings
    traffic: TrafficSpec


class _DefaultCases(FrozenModel):
    episodes: Annotated[int, Field(ge=1)]
    continuous_episodes: Annotated[int, Field(ge=1)]
    scenes: tuple[SceneSettings, ...] = Field(strict=False)
    egos: tuple[AgentSpec, ...] = Field(strict=False)
    traffic: TrafficSpec
    """Drives in all `scenes`."""
    cells: tuple[_Cell, ...] = Field(strict=False)


def default_cases(continuous: bool = False) -> tuple[list[Case], int]:
    """The cases that are compared if no suite is given, and the episodes of each.

    If `continuous`, random accelerations and steering angles drive the egos.
    """
    cases = Document(Path(__file__).with_name("verify.yaml")).validate(_DefaultCases)
    egos = (None,) if continuous else cases.egos
    cells = [(scene, cases.traffic) for scene in cases.scenes]
    for cell in cases.cells:
        cells.append((cell.scene.of_scenario(cell.traffic.scenario), cell.traffic))
    return [
        Case(scene=scene, ego=ego, traffic=traffic) for ego in egos for scene, traffic in cells
    ], cases.continuous_episodes if continuous else cases.episodes


def cases_of(suite: Suite) -> list[Case]:
    """The cells of a suite without `roads`, which `road_parity` compares."""
    return [
        Case(
            scene=cell.scene, ego=cell.ego.agent, traffic=cell.traffic.traffic, folder=suite.folder
        )
        for cell in suite.cells
    ]


def verify(
    cases: list[Case],
    episodes: int,
    seed: int,
    workers: int | None = None,
    progress: Callable[[int], None] = lambda episodes: None,
) -> list[Comparison]:
    """Compares the engines over some episodes of each case, starting at a seed.

    For the other arguments, see `in_chunks`.
    """
    seeds = range(seed, seed + episodes)
    found = in_chunks(compare, cases, seeds, _CHUNK, lambda case: case.title, workers, progress)
    return [sum(each, Comparison(case)) for case, each in zip(cases, found, strict=True)]


def compare(case: Case, seeds: range) -> Comparison:
    """Compares the engines over the episodes of these seeds."""
    traffic = case.traffic.make()
    ego = case.ego
    kind: ActionKind = "meta" if ego else "continuous"
    networks = networks_of(ego, traffic, case.folder) if ego else {}
    drivers = drivers_of(ego, traffic) if ego else map(AgentSpec.model_validate, traffic.agents)
    agents = {driver.key: driver.make(networks) for driver in drivers}
    key = ego.key if ego else None
    ours, theirs = (
        Simulation(case.scene, len(seeds), key, traffic, agents, engine, kind) for engine in ENGINES
    )
    for simulation in (ours, theirs):
        simulation.reset(np.array(seeds, dtype=np.uint64))
    # highway-env computes with the numbers that it gets; networks return float32.
    controls = np.stack([random_controls(int(k), case.scene.decisions) for k in ours.seeds], 1)
    controls = controls.astype(np.float32 if seeds.start // _CHUNK % 2 else np.float64)
    differences: list[Difference] = []
    largest, steps, lane_changes, frame = 0.0, 0, 0, 0
    while ours.scene.active.any():
        for phase in range(case.scene.steps_per_decision):
            given = controls[ours.steps.max()] if phase == 0 and ego is None else None
            frame += 1
            steps += int(ours.scene.active.sum())
            before = ours.scene.target_lane.copy()
            ours.advance(given)
            theirs.advance(given)
            lane_changes += int((ours.scene.target_lane != before).sum())
            found, size = _differences(ours, theirs, frame)
            differences += found
            largest = max(largest, size)
        running = ours.scene.active.copy()
        ours.finish_step()
        theirs.finish_step()
        for row in np.nonzero(running & (ours.ending != theirs.ending))[0]:
            where = (int(ours.seeds[row]), frame, int(ours.scene.ego[row]))
            pair = (float(ours.ending[row]), float(theirs.ending[row]))
            differences.append(Difference(*where, "ending", *pair))
            ours.scene.active[row] = theirs.scene.active[row] = False
    crashed = int(ours.scene.crashed.sum())
    return Comparison(case, len(seeds), steps, lane_changes, crashed, largest, tuple(differences))


def random_controls(seed: int, decisions: int) -> Floats:
    """Continuous actions (T, 2) of an episode, with means and spreads drawn per episode.

    The steering ranges from 0.1 % to all of its range. So there are egos that stay on the road,
    leave it, drive in circles, stop, and drive backwards.
    """
    rng = np.random.default_rng([seed, 5])
    size = np.array([1.0, 10 ** rng.uniform(-3, 0)])
    mean, spread = rng.uniform(-1, 1, 2), rng.uniform(0, 1, 2)
    return np.clip(size * (mean + spread * rng.normal(size=(decisions, 2))), -1, 1)


def _differences(
    ours: Simulation, theirs: Simulation, frame: int
) -> tuple[list[Difference], float]:
    """Ends the scenes that differ; returns the first difference of each, and the largest."""
    rows = np.nonzero(ours.scene.active)[0]
    found: dict[int, Difference] = {}
    largest = 0.0
    for name in (*EVENTS, *CONTINUOUS):
        a, b = getattr(ours.scene, name)[rows], getattr(theirs.scene, name)[rows]
        apart = np.abs(a.astype(np.float64) - b)
        if name in CONTINUOUS and apart.size:
            largest = max(largest, float(apart.max()))
        for r, vehicle in zip(*np.nonzero(~(apart <= TOLERANCE)), strict=True):
            values = (float(a[r, vehicle]), float(b[r, vehicle]))
            episode = int(ours.seeds[rows[r]])
            found.setdefault(rows[r], Difference(episode, frame, int(vehicle), name, *values))
    for row in found:
        ours.scene.active[row] = theirs.scene.active[row] = False
    return list(found.values()), largest
