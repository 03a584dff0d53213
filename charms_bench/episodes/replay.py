"""Simulates episodes of a run again and returns the trajectories of all vehicles.

A run folder holds rows of the ego only. The seed and the agents determine an episode completely, so
a new simulation gives the trajectories of all vehicles. Its rows must equal those of the run.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
import polars as pl

from charms_bench.engine.simulation import Simulation
from charms_bench.episodes.recorded_cell import RecordedCell, title_with
from charms_bench.errors import InputError
from charms_bench.foundation.words import counted
from charms_bench.plugins.registry import make_agent
from charms_bench.recording.recording import Recording
from charms_bench.runs.suite import Cell
from charms_bench.world.actions import ACTIONS
from charms_bench.world.plan_view import OF_VEHICLES, Plan, plan_over_time
from charms_bench.world.scenario import PRESCRIBED
from charms_bench.world.scene import VACANT_X_M, Floats, Ints, SceneSettings
from charms_bench.world.tracks import Motion

TRAJECTORY_SCHEMA = pl.Schema(
    {
        "t_s": pl.Float64(),  # time since the start of the episode
        "vehicle": pl.Int32(),  # index in the order of spawning
        "agent": pl.String(),  # name of the agent that drives the vehicle
        "ego": pl.Boolean(),
        "x": pl.Float64(),  # m, centre along the road
        "y": pl.Float64(),  # m, centre to the right of the leftmost lane's centre
        "heading": pl.Float64(),  # rad, positive to the right
        "length": pl.Float64(),  # m
        "width": pl.Float64(),  # m
        "speed": pl.Float64(),  # m/s
        "acceleration": pl.Float64(),  # m/s2, as commanded
        "lane": pl.Int8(),  # the nearest lane, 0 is the leftmost; on other roads, see below
        "target_lane": pl.Int8(),
        "action": pl.Int8(),  # `Replay.action_names`; null before the first, under a driver model
        "crashed": pl.Boolean(),
    }
)
_SCHEMA_OF_ROADS = pl.Schema({**TRAJECTORY_SCHEMA, "lane": pl.Int32(), "target_lane": pl.Int32()})
"""On one of highway-env's roads, lanes are rows of `Network.lanes`; in a CommonRoad scenario of the
episode, they are lanelets, counted from 1."""


@dataclass(frozen=True, kw_only=True)
class Replay(Motion):
    """An episode with N vehicles: its start, frame 0, and T simulation steps after it.

    Its arrays are [T + 1, N].
    """

    cell: Cell
    settings: SceneSettings
    episode: int
    """Seed of the episode."""
    ego: int
    """Index of the ego in the order of spawning."""
    agents: tuple[str, ...]
    """N names of agents."""
    action_names: tuple[str, ...] = ACTIONS
    """What `action` is an index into: highway-env's meta-actions, and others of the agents."""
    t_s: Floats
    """[T + 1] time since the start."""
    episodes: pl.DataFrame
    """The episode row (`recording.columns.EPISODE`)."""
    steps: pl.DataFrame
    """The step rows (`recording.columns.STEP`)."""
    plan: Plan | None = None
    """Where the vehicles are on one of highway-env's roads. The other arrays show that road
    straightened along the ego's way; a vehicle is present while it is beside it."""

    ego_index: int | None = None
    """Which of several egos, as in the rows of a run; None if there is one. It is vehicle 0, and
    ego 0 is then the vehicle of this number."""

    @property
    def title(self) -> str:
        """The name of its cell and of its ego."""
        return title_with(self.cell, self.ego_index)

    def __repr__(self) -> str:
        what = f"{self.title}, {counted(self.x.shape[1], 'vehicle')}, {self.t_s[-1]:z.1f} s"
        return f"<Replay of episode {self.episode}: {what}, ending {self.ending}>"

    @property
    def ending(self) -> str:
        """One of `simulation.ENDINGS`."""
        return str(self.episodes["ending"].item())

    def frame_of(self, step: int) -> int:
        """Returns the frame at the end of a decision interval; intervals are counted from 1."""
        return step * self.settings.steps_per_decision

    def trajectories(self) -> pl.DataFrame:
        """Returns one row per frame and vehicle there, sorted by both (`TRAJECTORY_SCHEMA`)."""
        frames, vehicles = self.x.shape
        place = np.tile(np.arange(vehicles), frames)
        action, present = pl.Series(self.action.ravel()), self.present
        columns: dict[str, Any] = {
            "t_s": np.repeat(self.t_s, vehicles),
            "vehicle": place,
            "agent": list(self.agents) * frames,
            "ego": place == self.ego,
            **{name: getattr(self, name).ravel() for name in _OF_SCENE},
            "action": action.set(pl.Series(~self.has_action.ravel()), None),
        }
        if self.plan is not None:
            present = self.plan.present & ~self.plan.is_obstacle
            columns |= {name: getattr(self.plan, name).ravel() for name in OF_VEHICLES}
        rows = pl.DataFrame(columns).filter(pl.Series(present.ravel()))
        schema = TRAJECTORY_SCHEMA if self.plan is None else _SCHEMA_OF_ROADS
        return rows.select(schema.names()).cast(schema)


_OF_SCENE = (
    "x", "y", "heading", "length", "width", "speed", "acceleration", "lane", "target_lane",
    "crashed", "present",
)  # fmt: skip


def replay(cell: RecordedCell, episodes: Sequence[int]) -> list[Replay]:
    """Simulates episodes of a cell, given by their seeds, again; returns them in the same order.

    All are kept in memory. If rounding decides between two actions, the choice can depend on the
    size of an agent's batch. So an episode that differs from the run is simulated once more, among
    the episodes of its shard. Raises a `RunFolderError` if the run has no such episode or the new
    rows differ from those of the run, and a `CharmsBenchError` if an agent cannot be made.
    """
    stored = cell.steps(episodes)
    replays = simulate(cell, episodes)
    for place, each in enumerate(replays):
        rows = stored.filter(episode=each.episode)
        if not each.steps.equals(rows):
            (replays[place],) = simulate(cell, [each.episode], among=cell.shard_of(each.episode))
            cell.check_steps(rows, replays[place].steps)
    return replays


class Seat(NamedTuple):
    """An agent that takes over vehicles in the middle of an episode."""

    step: int
    """Its first decision; an episode's decisions are counted from 1."""
    vehicle: int
    """The vehicle's index in the order in which vehicles appear."""
    agent: str


def simulate(
    cell: RecordedCell, episodes: Sequence[int], seat: Seat | None = None, among: Sequence[int] = ()
) -> list[Replay]:
    """Simulates episodes of a cell as `replay` does, but does not compare them with the run.

    An agent takes the `seat` in each of them. `among` are the seeds of all episodes that are
    simulated together, by default only `episodes`.
    """
    together = list(among or episodes)
    kept = [together.index(episode) for episode in episodes]
    guests = {}
    if seat is not None and seat.agent not in {driver.key for driver in cell.drivers}:
        guests[seat.agent] = make_agent(seat.agent)
    simulation = cell.simulation(len(together), guests)
    settings = simulation.settings
    simulation.reset(np.array(together, dtype=np.uint64))
    recording = Recording(simulation)
    frames, plans = [_frame(simulation, kept)], [_plans(simulation, kept)]
    if seat is not None:
        driver = simulation.made.get(simulation.agents.index(seat.agent))
        if getattr(driver, "follows_recording", False):
            raise InputError(
                f"agent '{seat.agent}' puts vehicles where they were recorded, so it cannot take "
                "over a vehicle; choose another agent"
            )
    interval = simulation.settings.steps_per_decision
    decisions = 0
    while simulation.scene.active.any():
        decisions += 1
        if seat is not None and decisions == seat.step:
            seats = _places(simulation, seat.vehicle)
            simulation.restore(simulation.state().seated(seats, seat.agent))
        for _ in range(interval):
            simulation.advance()
            frames.append(_frame(simulation, kept))
            plans.append(_plans(simulation, kept))
        simulation.finish_step()
        recording.note()
    ended, steps = recording.episodes(), recording.steps()
    replays = []
    for place, (b, episode) in enumerate(zip(kept, episodes, strict=True)):
        mine = pl.col("episode") == episode
        length = int(simulation.steps[b]) * interval + 1
        arrays = {k: np.stack([frame[k][place] for frame in frames[:length]]) for k in frames[0]}
        ego = int(simulation.scene.ego[b])
        if settings.straight_inflow is not None:
            ego, arrays = int(arrays["entry"][0, ego]), _by_vehicle(arrays)
        del arrays["entry"]
        plan = [plan for moment in plans[:length] if (plan := moment[place]) is not None]
        replays.append(
            Replay(
                cell=cell.cell,
                settings=settings,
                episode=episode,
                ego=ego,
                agents=_agents(simulation, arrays.pop("driver")),
                action_names=simulation.action_names,
                t_s=np.arange(length) / settings.simulation_hz,
                episodes=ended.filter(mine),
                steps=steps.filter(mine),
                plan=plan_over_time(plan) if plan else None,
                ego_index=cell.ego_index if cell.egos > 1 else None,
                **arrays,
            )
        )
    return replays


def _places(simulation: Simulation, vehicle: int) -> Ints:
    """The place of a vehicle in each scene (B,)."""
    scene, settings = simulation.scene, simulation.settings
    inflow = settings.straight_inflow
    if inflow is None:
        return np.full(scene.ego.size, vehicle)
    if vehicle > settings.traffic_vehicles:  # numbers of those that enter follow the last place
        vehicle += inflow.capacity
    return np.asarray((scene.present & (scene.entry == vehicle)).argmax(axis=1))


def _by_vehicle(arrays: dict[str, Any]) -> dict[str, Any]:
    """Arrays [T + 1, N] of places as arrays of vehicles, of which a place can have had several."""
    frame, place = np.nonzero(arrays["present"])
    _, vehicle = np.unique(arrays["entry"][frame, place], return_inverse=True)
    shape = len(arrays["present"]), vehicle.max() + 1
    found = {name: np.zeros(shape, dtype=array.dtype) for name, array in arrays.items()}
    found["x"][:] = VACANT_X_M - 1000.0 * np.arange(shape[1])
    for name in ("length", "width", "driver"):  # also before it enters and after it has left
        found[name][:, vehicle] = arrays[name][frame, place]
    for name, array in arrays.items():
        found[name][frame, vehicle] = array[frame, place]
    return found


def _agents(simulation: Simulation, drivers: Ints) -> tuple[str, ...]:
    """The names of the agents of some vehicles, given by their indices [T + 1, N], at the end."""
    names = [simulation.agents[k] for k in drivers[-1]]
    if simulation.settings.network is None or simulation.settings.scenario is not None:
        return tuple(names)
    return tuple("IDM of highway-env" if name == PRESCRIBED else name for name in names)


def _plans(simulation: Simulation, scenes: Sequence[int]) -> list[Plan | None]:
    """The plans of some scenes of a simulation; None of a straight road."""
    return [simulation.engine.plan(b) for b in scenes]


def _frame(simulation: Simulation, scenes: Sequence[int]) -> dict[str, Any]:
    """Returns copies of the arrays `[S, N]` that a replay of S scenes keeps."""
    frame = {name: getattr(simulation.scene, name)[scenes] for name in (*_OF_SCENE, "entry")}
    frame["driver"] = simulation.engine.drivers[scenes]
    frame["has_action"] = simulation.has_action[scenes]
    return frame | {"action": simulation.named_actions[scenes]}
