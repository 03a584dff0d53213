"""Records episodes: rows per decision of the ego, per episode and per driver, and counts.

Every metric is computed from these rows, so a new metric needs no new simulation. `columns`
declares the columns.
"""

import numpy as np
import polars as pl

from charms_bench.engine.collision_kinds import STRUCK
from charms_bench.engine.endings import ENDINGS, OFF_ROAD, REAR_END
from charms_bench.engine.simulation import Simulation
from charms_bench.recording.columns import EPISODE_SCHEMA, table
from charms_bench.recording.driver_sums import DriverSums
from charms_bench.recording.fault import Fault
from charms_bench.recording.following_counts import FollowingCounts
from charms_bench.recording.primitives import Primitives
from charms_bench.recording.step_rows import StepRows


class Recording:
    """Keeps what happens in a simulation; call `note` after every decision interval."""

    def __init__(self, simulation: Simulation) -> None:
        self._simulation = simulation
        self._was_running = simulation.scene.active.copy()
        self._kept = Primitives(simulation)
        self._start_x = self._kept.last("x")
        self._left = np.zeros((3, simulation.seeds.size))
        """(3, B) the vehicles that have left, those of them that had crashed, and the distance, m,
        that all of them have driven."""
        self._steps = StepRows(simulation)
        self._following = FollowingCounts(simulation.seeds.size)
        self._drivers = DriverSums(simulation)
        self._fault = Fault(simulation)
        kept, fault = self._kept, self._fault
        simulation.collision_watchers.append(lambda: fault.add(kept.at_collision()))

    def note(self) -> None:
        """Keeps the end of the decision interval that has just ended."""
        was_lost = self._kept.last("lost")
        frames = self._kept.at_decision(np.nonzero(self._was_running)[0])
        left, came = self._kept.left, self._kept.came
        if left.any() or came.any():
            driven = self._simulation.settings.profile.road_length_m - self._start_x
            self._left += [(left * each).sum(axis=1) for each in (1.0, was_lost, driven)]
            self._start_x[came] = self._kept.last("x")[came]
            self._fault.forget(left | came)
            self._drivers.exchange(left, came)
        self._was_running = self._simulation.scene.active.copy()
        self._fault.add(frames)
        self._steps.add(frames)
        self._following.add(frames)
        self._drivers.add(frames, self._fault.at_fault)

    def steps(self) -> pl.DataFrame:
        """Returns the rows of all steps so far (`columns.STEP`), sorted by episode and step."""
        return self._steps.table()

    def episodes(self) -> pl.DataFrame:
        """Returns one row per episode (`columns.EPISODE`), sorted by episode."""
        simulation = self._simulation
        rows, ego = simulation.ego_vehicles
        driven = self._kept.last("x") - self._start_x
        at_fault = self._fault.at_fault[rows, ego] | (simulation.ending == OFF_ROAD)
        struck = simulation.collision[rows, ego] == STRUCK
        is_traffic = simulation.scene.present.copy()
        is_traffic[rows, ego] = False
        lost, (left, crashed, left_m) = self._kept.last("lost"), self._left
        columns = {
            "episode": simulation.seeds,
            "ending": np.array(ENDINGS)[simulation.ending],
            "struck": pl.Series(struck).set(pl.Series(simulation.ending != REAR_END), None),
            "at_fault": pl.Series(at_fault).set(pl.Series(~simulation.failed), None),
            "steps": simulation.steps,
            "duration_s": simulation.steps / simulation.settings.decision_hz,
            "distance_m": driven[rows, ego],
            "traffic_vehicles": is_traffic.sum(axis=1) + left.astype(int),
            "traffic_crashed": (lost & is_traffic).sum(axis=1) + crashed.astype(int),
            "traffic_distance_m": np.where(is_traffic, driven, 0.0).sum(axis=1) + left_m,
        }
        return table(columns, EPISODE_SCHEMA).sort("episode")

    def counts(self) -> pl.DataFrame:
        """Returns what all vehicles did while they followed a leader (`columns.COUNT`)."""
        return self._following.table(self._simulation.seeds)

    def drivers(self) -> pl.DataFrame:
        """Returns what each driver causes and undergoes (`columns.DRIVER`), sorted by its keys."""
        return self._drivers.table()
