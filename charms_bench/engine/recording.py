"""Records episodes: one row per decision of the ego, one per episode, and counts of all vehicles.

Every metric is computed from these rows, so a new metric needs no new simulation. `engine.columns`
declares the columns. A value that does not exist, such as the speed of a missing leader, is null.
"""

import numpy as np
import polars as pl
from numpy.typing import NDArray

from charms_bench.engine.columns import EPISODE_SCHEMA, STEP_SCHEMA, table
from charms_bench.engine.following import FollowingCounts
from charms_bench.engine.simulation import ENDINGS, Simulation
from charms_bench.world.scene import Bools, Ints

INTERACTION_RANGE_M = 30.0


class Recording:
    """Collects the rows of a simulation; call `note` after every step."""

    def __init__(self, simulation: Simulation) -> None:
        self._simulation = simulation
        self._start = simulation.scene.x.copy()
        self._lost = np.zeros(self._start.shape, dtype=np.bool_)
        self._frames: list[pl.DataFrame] = []
        self._was_running = simulation.scene.active.copy()
        self._following = FollowingCounts(simulation.scene)

    def note(self) -> None:
        """Adds the rows of the step that has just ended."""
        simulation, scene = self._simulation, self._simulation.scene
        rows = np.nonzero(self._was_running)[0]
        self._was_running = scene.active.copy()
        self._lost[rows] |= (scene.crashed | scene.off_road)[rows]
        self._following.note(scene, rows)
        egos = (rows, scene.ego[rows])
        lane = scene.lane[egos]
        leader, has_leader = scene.leader(egos, lane)
        follower, has_follower = scene.follower(egos, lane)
        near = (np.abs(scene.x[rows] - scene.x[egos][:, None]) <= INTERACTION_RANGE_M) & (
            np.abs(scene.lane[rows] - lane[:, None]) <= 1
        )
        own = ("x", "y", "heading", "speed", "acceleration", "steering", "lane", "target_lane")
        columns = {
            "episode": simulation.seeds[rows],
            "step": simulation.steps[rows],
            **{name: getattr(scene, name)[egos] for name in own},
            "action": _where(simulation.has_action[egos], simulation.action[egos]),
            "leader_distance": _where(has_leader, scene.x[rows, leader] - scene.x[egos]),
            "leader_speed": _where(has_leader, scene.speed[rows, leader]),
            "follower_distance": _where(has_follower, scene.x[egos] - scene.x[rows, follower]),
            "follower_speed": _where(has_follower, scene.speed[rows, follower]),
            "follower_acceleration": _where(
                has_follower & ~scene.crashed[rows, follower], scene.acceleration[rows, follower]
            ),
            "vehicles_near": near.sum(axis=1),
        }
        self._frames.append(table(columns, STEP_SCHEMA))

    def steps(self) -> pl.DataFrame:
        """Returns the rows of all steps so far (`rows.STEP`), sorted by episode and step."""
        frame = pl.concat(self._frames) if self._frames else pl.DataFrame(schema=STEP_SCHEMA)
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
            "steps": simulation.steps,
            "duration_s": simulation.steps / simulation.settings.decision_hz,
            "distance_m": driven[rows, ego],
            "traffic_vehicles": is_traffic.sum(axis=1),
            "traffic_crashed": (self._lost & is_traffic).sum(axis=1),
            "traffic_distance_m": np.where(is_traffic, driven, 0.0).sum(axis=1),
        }
        return table(columns, EPISODE_SCHEMA).sort("episode")

    def counts(self) -> pl.DataFrame:
        """Returns what all vehicles did while they followed a leader (`rows.COUNT`)."""
        return self._following.table(self._simulation.seeds)


def _where(present: Bools, values: NDArray[np.float64] | Ints) -> pl.Series:
    """Returns the values, null where they are not present."""
    return pl.select(pl.when(pl.Series(present)).then(pl.Series(values))).to_series()
