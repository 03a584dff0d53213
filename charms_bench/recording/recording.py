"""Records episodes: rows per decision of the ego, per episode and per driver, and counts.

Every metric is computed from these rows, so a new metric needs no new simulation. `columns`
declares the columns.
"""

import numpy as np
import polars as pl

from charms_bench.engine.collision_kinds import STRUCK
from charms_bench.engine.endings import ENDINGS, OFF_ROAD, REAR_END
from charms_bench.engine.simulation import Simulation
from charms_bench.recording.columns import (
    DRIVER_KEYS,
    EPISODE_SCHEMA,
    HAS_GOAL,
    ON_ROAD,
    OPTIONAL,
    TIME_OF_TRAFFIC,
    table,
)
from charms_bench.recording.driver_sums import DriverSums
from charms_bench.recording.fault import Fault
from charms_bench.recording.following_counts import FollowingCounts
from charms_bench.recording.primitives import Primitives
from charms_bench.recording.step_rows import StepRows
from charms_bench.recording.traffic_on_ways import TrafficOnWays
from charms_bench.world.scene import Bools


class Recording:
    """Keeps what happens in a simulation; call `note` after every decision interval."""

    def __init__(self, simulation: Simulation) -> None:
        self._simulation = simulation
        self._on_network = simulation.settings.network is not None
        """On one of highway-env's roads, vehicles are seen only beside the ego's way."""
        self._was_running = simulation.scene.active.copy()
        self._kept = Primitives(simulation)
        self._traffic = TrafficOnWays(simulation) if self._on_network else None
        self._places = self._kept if self._traffic is None else self._traffic.kept
        """Where all vehicles are along their own ways."""
        self._start_x = self._places.last("x")
        self._end_x = self._start_x.copy()
        scene = self._places.scene
        self._seen = np.where(scene.present, scene.entry, -1)
        """[B, N] the number of the last vehicle at each place, -1 for none so far."""
        self._gone = np.zeros(simulation.seeds.size, dtype=np.int64)
        self._gone_m = np.zeros(simulation.seeds.size)
        """Vehicles (B,) whose places others have taken, and how far they drove."""
        self._traffic_decisions = np.zeros(simulation.seeds.size, dtype=np.int64)
        """(B,) decision intervals of the traffic while it was there, where vehicles come and go."""
        self._left_lost = np.zeros(simulation.seeds.size, dtype=np.int64)
        """Vehicles (B,) that left after they had crashed or left the lanes."""
        self._steps = StepRows(simulation)
        self._following = FollowingCounts(simulation.seeds.size, simulation.scene.road)
        self._drivers = DriverSums(simulation)
        self._fault = Fault(simulation)
        kept, fault = self._kept, self._fault
        if self._on_network:  # where the rows show no fault, and lanes are found at decisions
            simulation.collision_watchers.append(fault.note_entries)
        else:
            simulation.step_watchers.append(fault.note_entries)
        simulation.collision_watchers.append(lambda: fault.add(kept.at_collision(), judges=True))

    @classmethod
    def of(cls, simulation: Simulation) -> "Recording":
        """The recording of a simulation, which it steps to its end."""
        recording = cls(simulation)
        while simulation.scene.active.any():
            simulation.step()
            recording.note()
        return recording

    def note(self) -> None:
        """Keeps the end of the decision interval that has just ended."""
        was_lost = self._places.last("lost") if self._kept.changes else None
        was_running = self._was_running
        scenes = np.nonzero(was_running)[0]
        frames = self._kept.at_decision(scenes)
        if self._traffic is not None:
            self._traffic.add(scenes)
        self._was_running = self._simulation.scene.active.copy()
        if was_lost is not None:
            self._left_lost += (self._places.left & was_lost).sum(axis=1)
            self._fault.forget(self._kept.left)
            self._drivers.forget(self._kept.left)
            self._note_places(was_running)
        if self._on_network:
            self._fault.note_entries()
        # Only a vehicle whose place has just been another's can have missed its collision's frame.
        self._fault.add(frames, judges=self._kept.changes)
        self._steps.add(frames)
        self._following.add(frames)
        self._drivers.add(frames, self._fault.at_fault, self._kept.changes)

    def _note_places(self, was_running: Bools) -> None:
        """Notes where vehicles are, from the decision after they have appeared until they leave."""
        scene, x = self._places.scene, self._places.last("x")
        has_appeared = scene.present & (scene.entry != self._seen)
        is_gone = has_appeared & (self._seen >= 0)
        stayed = scene.present & ~has_appeared & was_running[:, None]
        stayed[self._simulation.ego_vehicles] = False
        self._traffic_decisions += stayed.sum(axis=1)
        self._gone += is_gone.sum(axis=1)
        self._gone_m += np.where(is_gone, self._end_x - self._start_x, 0.0).sum(axis=1)
        self._start_x = np.where(has_appeared, x, self._start_x)
        self._end_x = np.where(scene.present, x, self._end_x)
        self._seen = np.where(has_appeared, scene.entry, self._seen)

    def steps(self) -> pl.DataFrame:
        """Returns the rows of all steps so far (`columns.STEP`), sorted by episode and step."""
        return self._steps.table()

    def episodes(self) -> pl.DataFrame:
        """Returns one row per episode (`columns.EPISODE`), sorted by episode."""
        simulation = self._simulation
        rows, ego = simulation.ego_vehicles
        end_x = self._end_x if self._kept.changes else self._places.last("x")
        driven = end_x - self._start_x
        at_fault = self._fault.at_fault[rows, ego] | (simulation.ending == OFF_ROAD)
        struck = simulation.collision[rows, ego] == STRUCK
        is_traffic = self._seen >= 0
        is_traffic[rows, ego] = False
        is_lost = self._places.last("lost") & self._places.scene.present
        columns = {
            "episode": simulation.seeds,
            "ending": np.array(ENDINGS)[simulation.ending],
            "struck": pl.Series(struck).set(pl.Series(simulation.ending != REAR_END), None),
            "at_fault": pl.Series(at_fault).set(pl.Series(~simulation.failed), None),
            "steps": simulation.steps,
            "duration_s": simulation.steps / simulation.settings.decision_hz,
            "distance_m": driven[rows, ego],
            "traffic_vehicles": is_traffic.sum(axis=1) + self._gone,
            "traffic_crashed": (is_lost & is_traffic).sum(axis=1) + self._left_lost,
            "traffic_distance_m": np.where(is_traffic, driven, 0.0).sum(axis=1) + self._gone_m,
        }
        if self._kept.changes:
            decision_s = 1 / simulation.settings.decision_hz
            columns[TIME_OF_TRAFFIC] = self._traffic_decisions * decision_s
        if self._on_network:
            measures = simulation.engine.measures.items()
            columns["at_fault"] = None
            columns[HAS_GOAL] = np.full(simulation.seeds.size, simulation.engine.has_goal)
            columns |= {name: pl.Series(values).fill_nan(None) for name, values in measures}
            has_left = pl.Series(simulation.ending == OFF_ROAD)
            columns[ON_ROAD] = (columns[ON_ROAD] > 0) | has_left
        names = [name for name in EPISODE_SCHEMA if name in columns or name not in OPTIONAL]
        schema = pl.Schema({name: EPISODE_SCHEMA[name] for name in names})
        return table(columns, schema).sort("episode")

    def counts(self) -> pl.DataFrame:
        """Returns what all vehicles did while they followed a leader (`columns.COUNT`)."""
        return self._following.table(self._simulation.seeds)

    def drivers(self) -> pl.DataFrame:
        """Returns what each driver causes and undergoes (`columns.DRIVER`), sorted by its keys."""
        rows = self._drivers.table()
        if self._traffic is None:
            return rows
        return pl.concat((rows.filter("is_ego"), self._traffic.drivers())).sort(DRIVER_KEYS)
