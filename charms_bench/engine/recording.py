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
from charms_bench.engine.following import FollowingCounts
from charms_bench.engine.simulation import ENDINGS, REAR_END, Simulation
from charms_bench.world.compiled import compiled
from charms_bench.world.scene import Bools, Ints, Scene

INTERACTION_RANGE_M = 30.0
MASKS = {
    "has_action": ["action"],
    "has_leader": ["leader", "leader_distance", "leader_speed"],
    "has_follower": ["follower", "follower_distance", "follower_speed"],
    "follower_drives": ["follower_acceleration"],
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

    def note(self) -> None:
        """Adds the rows of the step that has just ended."""
        simulation, scene = self._simulation, self._simulation.scene
        scenes = np.nonzero(self._was_running)[0]
        self._was_running = scene.active.copy()
        self._following.note(scene, scenes)
        self._conduct.note(scenes)
        _note(
            scene,
            scenes,
            simulation.seeds,
            simulation.steps,
            simulation.action,
            simulation.has_action,
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


@compiled
def _note(
    scene: Scene,
    scenes: Ints,
    seeds: NDArray[np.uint64],
    steps: Ints,
    action: Ints,
    has_action: Bools,
    rows: Any,
    masks: Any,
) -> None:
    """Fills `rows` and `masks` [B, T] with a step of the scenes (S,)."""
    for b in scenes:
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
        row.lane = lane
        row.target_lane = scene.target_lane[b, ego]
        row.action = action[b, ego]
        mask.has_action = has_action[b, ego]
        leader = scene.leaders[b, ego, lane]
        if leader >= 0:
            mask.has_leader = True
            row.leader = leader
            row.leader_distance = scene.x[b, leader] - x
            row.leader_speed = scene.speed[b, leader]
        follower = scene.followers[b, ego, lane]
        if follower >= 0:
            mask.has_follower = True
            row.follower = follower
            row.follower_distance = x - scene.x[b, follower]
            row.follower_speed = scene.speed[b, follower]
            row.follower_acceleration = scene.acceleration[b, follower]
            mask.follower_drives = not scene.crashed[b, follower]
        near = 0
        for i in range(scene.x.shape[1]):
            is_near = abs(scene.x[b, i] - x) <= INTERACTION_RANGE_M
            near += is_near and abs(scene.lane[b, i] - lane) <= 1
        row.vehicles_near = near
