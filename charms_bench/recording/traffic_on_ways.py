"""What the traffic does on a road where vehicles drive different ways.

Each vehicle is described along its own way, on which it sees the others: its leader, its followers
and its lanes are found as on the straight road. An event belongs to the way of the vehicle that
follows or changes lanes. A vehicle that comes to another road, whose lanes have other numbers,
changes no lane. One that has passed the end of a lane that no lane follows, or only an oncoming
one, no longer counts.
"""

import numpy as np
import polars as pl

from charms_bench.engine.simulation import Simulation
from charms_bench.recording.driver_sums import DriverSums
from charms_bench.recording.lane_changes import is_given_up
from charms_bench.recording.primitives import NEAR, SEEN, Primitives
from charms_bench.world.named_road import ENVIRONMENT
from charms_bench.world.scenario import PRESCRIBED
from charms_bench.world.scene import Ints


class TrafficOnWays:
    """Keeps what the traffic of a simulation does; its arguments are those of `Recording`."""

    def __init__(self, simulation: Simulation) -> None:
        self._simulation = simulation
        self._views = simulation.engine.views()
        simulation.step_watchers.append(self._views.follow)
        simulation.collision_watchers.append(self._views.judge)
        self.kept = Primitives(simulation, self._views)
        """All vehicles, each along its own way."""
        self._sums = DriverSums(simulation, self._views.own)

    def add(self, scenes: Ints) -> None:
        """Adds the decision interval of the scenes (S,) that has just ended."""
        self._views.look(scenes)
        frames = self.kept.at_decision(scenes)
        self._sums.forget(self.kept.left)
        self._sums.find_drivers()
        each, places = np.nonzero(self._views.own.present[scenes])
        moments = frames.moments[each]
        moments["first"], moments["after"] = places, places + 1
        was, own = (
            frames.vehicles[["lane", "target_lane"]][moments[name], places]
            for name in ("before", "now")
        )
        # Who took the gap is searched for among all vehicles.
        looks_for_all = is_given_up(
            was["lane"], was["target_lane"], own["lane"], own["target_lane"]
        )
        others = self._simulation.settings.vehicles - 1
        after = np.cumsum(NEAR + others * looks_for_all)
        moments["seen_after"], moments["seen"][1:] = after, after[:-1]
        seen = np.empty(after[-1] if each.size else 0, dtype=SEEN)
        self._views.see((scenes[each], places), after, seen)
        self._sums.add(frames._replace(moments=moments), self._views.at_fault, seen=seen)

    def drivers(self) -> pl.DataFrame:
        """The rows of the traffic's drivers (`columns.DRIVER`)."""
        rows = self._sums.table().filter(~pl.col("is_ego"))
        if self._simulation.settings.scenario is not None:
            return rows
        return rows.with_columns(pl.col("agent").replace(PRESCRIBED, ENVIRONMENT))
