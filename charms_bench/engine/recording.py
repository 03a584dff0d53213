"""Records episodes: rows per decision of the ego, per episode and per driver, and counts.

Every metric is computed from these rows, so a new metric needs no new simulation. `engine.columns`
declares the columns. A value that does not exist, such as the speed of a missing leader, is null.
"""

from typing import Any

import numpy as np
import polars as pl
from numpy.typing import NDArray

from charms_bench.engine.collisions import STRUCK
from charms_bench.engine.columns import EPISODE_SCHEMA, STEP_RECORD, STEP_SCHEMA, table
from charms_bench.engine.conduct import Conduct
from charms_bench.engine.endings import ENDINGS, OFF_ROAD, REAR_END
from charms_bench.engine.following_counts import FollowingCounts
from charms_bench.engine.lane_changes import imposed_decisions
from charms_bench.engine.planar_ttc import planar_ttc
from charms_bench.engine.simulation import Simulation
from charms_bench.foundation.compiled import compiled_of_scenes
from charms_bench.world.scene import Bools, Floats, Ints, Scene

INTERACTION_RANGE_M = 30.0
MASKS = {
    "has_action": ["action"],
    "has_leader": ["leader", "leader_distance", "leader_length", "leader_speed"],
    "has_follower": ["follower", "follower_distance", "follower_length", "follower_speed"],
    "follower_drives": ["follower_acceleration"],
    "new_follower_drives": ["new_follower_acceleration"],
    "has_planar_ttc": ["planar_ttc"],
}
"""The columns with values that can be missing, by what a step must have for these values."""
_MASK_RECORD = np.dtype([(name, np.bool_) for name in ("recorded", *MASKS)])


class Recording:
    """Collects the rows of a simulation; call `note` after every step."""

    def __init__(self, simulation: Simulation) -> None:
        scene, shape = simulation.scene, (simulation.seeds.size, simulation.settings.decisions)
        self._simulation = simulation
        self._start = scene.x.copy()
        self._rows = np.zeros(shape, dtype=STEP_RECORD)
        self._masks = np.zeros(shape, dtype=_MASK_RECORD)
        self._was_running = scene.active.copy()
        self._following = FollowingCounts(scene)
        self._conduct = Conduct(simulation)
        self._window = imposed_decisions(1 / simulation.settings.decision_hz)

    def note(self) -> None:
        """Adds the rows of the step that has just ended."""
        simulation, scene = self._simulation, self._simulation.scene
        scenes = np.nonzero(self._was_running)[0]
        self._was_running = scene.active.copy()
        self._following.note(scene, scenes)
        self._conduct.note(scenes)
        note_step(
            scene,
            scenes,
            simulation.seeds,
            simulation.steps,
            simulation.action,
            simulation.has_action,
            planar_ttc(scene, scenes),
            self._window,
            self._rows,
            self._masks,
        )

    def steps(self) -> pl.DataFrame:
        """Returns the rows of all steps so far (`rows.STEP`), sorted by episode and step."""
        recorded = self._masks["recorded"]
        rows, masks = self._rows[recorded], self._masks[recorded]
        frame = table({name: rows[name] for name in STEP_SCHEMA}, STEP_SCHEMA)
        for mask, names in MASKS.items():
            frame = frame.with_columns(pl.when(pl.Series(masks[mask])).then(pl.col(names)))
        return frame.sort("episode", "step")

    def episodes(self) -> pl.DataFrame:
        """Returns one row per episode (`rows.EPISODE`), sorted by episode."""
        simulation, scene = self._simulation, self._simulation.scene
        rows, ego = simulation.ego_vehicles
        driven = scene.x - self._start
        at_fault = self._conduct.at_fault[rows, ego] | (simulation.ending == OFF_ROAD)
        is_traffic = np.ones(driven.shape, dtype=np.bool_)
        is_traffic[rows, ego] = False
        columns = {
            "episode": simulation.seeds,
            "ending": [ENDINGS[ending] for ending in simulation.ending],
            "struck": [
                bool(collision == STRUCK) if ending == REAR_END else None
                for collision, ending in zip(
                    simulation.collision[rows, ego], simulation.ending, strict=True
                )
            ],
            "at_fault": [
                bool(fault) if failed else None
                for fault, failed in zip(at_fault, simulation.failed, strict=True)
            ],
            "steps": simulation.steps,
            "duration_s": simulation.steps / simulation.settings.decision_hz,
            "distance_m": driven[rows, ego],
            "traffic_vehicles": is_traffic.sum(axis=1),
            "traffic_crashed": (self._conduct.lost & is_traffic).sum(axis=1),
            "traffic_distance_m": np.where(is_traffic, driven, 0.0).sum(axis=1),
        }
        return table(columns, EPISODE_SCHEMA).sort("episode")

    def counts(self) -> pl.DataFrame:
        """Returns what all vehicles did while they followed a leader (`rows.COUNT`)."""
        return self._following.table(self._simulation.seeds)

    def drivers(self) -> pl.DataFrame:
        """Returns what each driver causes and undergoes (`columns.DRIVER`), sorted by its keys."""
        return self._conduct.table()


@compiled_of_scenes
def note_step(
    scene: Scene,
    scenes: Ints,
    seeds: NDArray[np.uint64],
    steps: Ints,
    action: Ints,
    has_action: Bools,
    planar_ttc_s: Floats,
    window: int,
    rows: Any,
    masks: Any,
) -> None:
    """Fills `rows` and `masks` [B, T] with a step of the scenes (S,).

    `planar_ttc_s` (S,) are the egos' planar TTC. The braking of a new follower belongs to the row
    of the lane change, and is noted in `window` decisions.
    """
    for s in range(scenes.size):
        b = scenes[s]
        ego, step = scene.ego[b], steps[b]
        row, mask = rows[b, step - 1], masks[b, step - 1]
        x, lane = scene.x[b, ego], scene.lane[b, ego]
        mask.recorded = True
        row.episode = seeds[b]
        row.step = step
        row.x = x
        row.y = scene.y[b, ego]
        row.heading = scene.heading[b, ego]
        row.speed = scene.speed[b, ego]
        row.acceleration = scene.acceleration[b, ego]
        row.steering = scene.steering[b, ego]
        row.length = scene.length[b, ego]
        row.lane = lane
        row.target_lane = scene.target_lane[b, ego]
        row.action = action[b, ego]
        mask.has_action = has_action[b, ego]
        leader = scene.leaders[b, ego, lane]
        if leader >= 0:
            mask.has_leader = True
            row.leader = leader
            row.leader_distance = scene.x[b, leader] - x
            row.leader_length = scene.length[b, leader]
            row.leader_speed = scene.speed[b, leader]
        follower = scene.followers[b, ego, lane]
        if follower >= 0:
            mask.has_follower = True
            row.follower = follower
            row.follower_distance = x - scene.x[b, follower]
            row.follower_length = scene.length[b, follower]
            row.follower_speed = scene.speed[b, follower]
            row.follower_acceleration = scene.acceleration[b, follower]
            mask.follower_drives = not scene.crashed[b, follower]
        for t in range(max(step - window, 1), 0 if scene.crashed[b, ego] else step):
            has_changed = rows[b, t].lane != rows[b, t - 1].lane
            new_follower = rows[b, t].follower
            if has_changed and masks[b, t].has_follower and not scene.crashed[b, new_follower]:
                least = scene.acceleration[b, new_follower]
                if masks[b, t].new_follower_drives:
                    least = min(least, rows[b, t].new_follower_acceleration)
                masks[b, t].new_follower_drives = True
                rows[b, t].new_follower_acceleration = least
        mask.has_planar_ttc = np.isfinite(planar_ttc_s[s])
        row.planar_ttc = planar_ttc_s[s]
        near = 0
        for i in range(scene.x.shape[1]):
            is_near = abs(scene.x[b, i] - x) <= INTERACTION_RANGE_M
            near += is_near and abs(scene.lane[b, i] - lane) <= 1
        row.vehicles_near = near
