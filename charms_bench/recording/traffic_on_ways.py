"""What the traffic does on a road where vehicles drive different ways.

Each vehicle is described along its own way, on which it sees the others: its leader, its followers
and its lanes are found as on the straight road. An event belongs to the way of the vehicle that
follows or changes lanes. A vehicle that comes to another road, whose lanes have other numbers,
changes no lane.
"""

import numpy as np
import polars as pl

from charms_bench.engine.simulation import Simulation
from charms_bench.recording.driver_sums import DriverSums
from charms_bench.recording.primitives import VEHICLE, Primitives
from charms_bench.world.named_road import ENVIRONMENT
from charms_bench.world.scenario import PRESCRIBED
from charms_bench.world.scene import Ints

VIEWED = 2**16
"""The most vehicles in the views that are kept at once."""
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
        self._at_once = max(1, VIEWED // simulation.settings.vehicles)

    def add(self, scenes: Ints) -> None:
        """Adds the decision interval of the scenes (S,) that has just ended."""
        self._views.look(scenes)
        frames = self.kept.at_decision(scenes)
        self._sums.forget(self.kept.left)
        self._sums.find_drivers()
        each, places = np.nonzero(self._simulation.engine.state.present[scenes])
        for start in range(0, each.size, self._at_once):
            part = slice(start, start + self._at_once)
            moments = frames.moments[each[part]]
            moments["first"], moments["after"] = places[part], places[part] + 1
            seen = frames.vehicles.view(_WHOLE)[moments["now"]].view(VEHICLE)
            self._views.see((scenes[each[part]], places[part]), seen)
            moments["seen"] = np.arange(moments.size)
            some = frames._replace(moments=moments)
            self._sums.add(some, self._views.at_fault, seen=seen)

    def drivers(self) -> pl.DataFrame:
        """The rows of the traffic's drivers (`columns.DRIVER`)."""
        rows = self._sums.table().filter(~pl.col("is_ego"))
        return rows.with_columns(pl.col("agent").replace(PRESCRIBED, ENVIRONMENT))
