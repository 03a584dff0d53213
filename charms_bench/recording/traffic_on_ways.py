"""What the traffic does on a road where vehicles drive different ways.

Each vehicle is described along its own way, on which it sees the others: its leader, its followers
and its lanes are found as on the straight road. An event belongs to the way of the vehicle that
follows or changes lanes. A vehicle that comes to another road, whose lanes have other numbers,
changes no lane.
"""

from typing import Any

import numpy as np
import polars as pl

from charms_bench.engine.simulation import Simulation
from charms_bench.foundation.compiled import compiled_of_scenes
from charms_bench.recording.driver_sums import DriverSums
from charms_bench.recording.primitives import VEHICLE, Primitives
from charms_bench.world.candidate_lanes import LEFT, OWN, RIGHT
from charms_bench.world.named_road import ENVIRONMENT
from charms_bench.world.scenario import PRESCRIBED
from charms_bench.world.scene import Ints, Scene

_WHOLE = np.dtype((np.void, VEHICLE.itemsize))
"""A vehicle as one piece of memory; see `step_rows`."""


class TrafficOnWays:
    """Keeps what the traffic of a simulation does; its arguments are those of `Recording`."""

    def __init__(self, simulation: Simulation) -> None:
        self._simulation = simulation
        self._views = simulation.engine.views()
        simulation.step_watchers.append(self._views.follow)
        simulation.collision_watchers.append(self._views.judge)
        self.kept = Primitives(simulation, self._views)
        """All vehicles, each along its own way."""
        self._sums = DriverSums(simulation)
        scenes, vehicles = simulation.scene.x.shape
        self._seen = np.zeros((2 * scenes, vehicles), dtype=VEHICLE)

    def add(self, scenes: Ints) -> None:
        """Adds the decision interval of the scenes (S,) that has just ended."""
        frames = self.kept.at_decision(scenes)
        self._sums.forget(self.kept.left)
        self._sums.find_drivers()
        for place in range(self._seen.shape[1]):
            present = self._simulation.engine.state.present[scenes, place]
            rows = scenes[present]
            if rows.size:
                some = frames._replace(moments=frames.moments[present])
                view = self._views.seen_by((rows, np.full(rows.size, place)))
                now = some.moments["now"]
                self._seen.view(_WHOLE)[now] = some.vehicles.view(_WHOLE)[now]
                see(view, some.moments, self._seen)
                self._sums.add_seen(some, self._seen, place, self._views.at_fault)

    def drivers(self) -> pl.DataFrame:
        """The rows of the traffic's drivers (`columns.DRIVER`)."""
        rows = self._sums.table().filter(~pl.col("is_ego"))
        return rows.with_columns(pl.col("agent").replace(PRESCRIBED, ENVIRONMENT))


@compiled_of_scenes
def see(scene: Scene, moments: Any, seen: Any) -> None:
    """Fills in where the vehicles of some frames are in the views (S, N) of some of them."""
    leaders, followers = scene.leaders, scene.followers
    for m in range(moments.size):
        now = seen[moments[m].now]
        for j in range(now.size):
            other = now[j]
            other.x, other.y, other.heading = scene.x[m, j], scene.y[m, j], scene.heading[m, j]
            other.direction_x, other.direction_y = scene.direction_x[m, j], scene.direction_y[m, j]
            other.lane, other.target_lane = scene.lane[m, j], scene.target_lane[m, j]
            other.leader, other.follower = leaders[m, j, OWN], followers[m, j, OWN]
            other.left_leader, other.left_follower = leaders[m, j, LEFT], followers[m, j, LEFT]
            other.right_leader, other.right_follower = leaders[m, j, RIGHT], followers[m, j, RIGHT]
