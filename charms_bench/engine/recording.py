"""What is kept of an episode: a row a decision of the ego, a row an episode, and counts of all.

Every metric is computed from these rows, so a new one needs no new simulation. A quantity that
does not exist at a moment (the leader's, without a leader) is null.
"""

from typing import Any

import numpy as np
import polars as pl
from numpy.typing import NDArray

from charms_bench.engine.following import FollowingCounts
from charms_bench.engine.simulation import ENDINGS, Simulation
from charms_bench.world.scene import Bools, Ints

INTERACTION_RANGE_M = 30.0

STEP_SCHEMA = pl.Schema(
    {
        "episode": pl.UInt64(),  # the episode's seed
        "step": pl.Int32(),  # decisions made, from 1
        "x": pl.Float32(),  # m
        "y": pl.Float32(),
        "heading": pl.Float32(),  # rad
        "speed": pl.Float32(),  # m/s
        "acceleration": pl.Float32(),  # m/s2, as commanded in the last simulation step
        "steering": pl.Float32(),  # rad
        "lane": pl.Int8(),
        "target_lane": pl.Int8(),
        "action": pl.Int8(),  # index into agent.ACTIONS; null under a driver model
        "leader_distance": pl.Float32(),  # m, centre to centre, on the ego's lane
        "leader_speed": pl.Float32(),
        "follower_distance": pl.Float32(),
        "follower_speed": pl.Float32(),
        "follower_acceleration": pl.Float32(),  # also null for a wreck, which nobody drives
        "vehicles_near": pl.Int16(),  # within 30 m and a lane, the ego included
    }
)

EPISODE_SCHEMA = pl.Schema(
    {
        "episode": pl.UInt64(),
        "ending": pl.String(),  # time, rear_end, side or off_road
        "steps": pl.Int32(),
        "duration_s": pl.Float64(),
        "distance_m": pl.Float64(),  # of the ego, along the road
        "traffic_vehicles": pl.Int32(),
        "traffic_crashed": pl.Int32(),  # vehicles of the traffic that collided or left the road
        "traffic_distance_m": pl.Float64(),  # of all vehicles of the traffic together
    }
)


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
        columns = {
            "episode": simulation.seeds[rows],
            "step": simulation.steps[rows],
            "x": scene.x[egos],
            "y": scene.y[egos],
            "heading": scene.heading[egos],
            "speed": scene.speed[egos],
            "acceleration": scene.acceleration[egos],
            "steering": scene.steering[egos],
            "lane": lane,
            "target_lane": scene.target_lane[egos],
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
        self._frames.append(pl.DataFrame(columns).cast(STEP_SCHEMA))

    def steps(self) -> pl.DataFrame:
        """The rows of all steps so far, by episode and step."""
        frame = pl.concat(self._frames) if self._frames else pl.DataFrame(schema=STEP_SCHEMA)
        return frame.sort("episode", "step")

    def episodes(self) -> pl.DataFrame:
        """A row an episode, by episode."""
        simulation, scene = self._simulation, self._simulation.scene
        rows, ego = simulation.ego_vehicles
        driven = scene.x - self._start
        others = np.ones(driven.shape, dtype=np.bool_)
        others[rows, ego] = False
        columns: dict[str, Any] = {
            "episode": simulation.seeds,
            "ending": [ENDINGS[ending] for ending in simulation.ending],
            "steps": simulation.steps,
            "duration_s": simulation.steps / simulation.settings.decision_hz,
            "distance_m": driven[rows, ego],
            "traffic_vehicles": others.sum(axis=1),
            "traffic_crashed": (self._lost & others).sum(axis=1),
            "traffic_distance_m": np.where(others, driven, 0.0).sum(axis=1),
        }
        return pl.DataFrame(columns).cast(EPISODE_SCHEMA).sort("episode")

    def counts(self) -> pl.DataFrame:
        """What all vehicles did while they followed; see `following.COUNT_SCHEMA`."""
        return self._following.table(self._simulation.seeds)


def _where(present: Bools, values: NDArray[np.float64] | Ints) -> pl.Series:
    """The values, null where they are not present."""
    return pl.select(pl.when(pl.Series(present)).then(pl.Series(values))).to_series()
