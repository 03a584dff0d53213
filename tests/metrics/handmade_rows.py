"""Rows written by hand, and what a metric makes of them."""

from typing import Any

import polars as pl

from charms_bench.metrics import PAPER, Metric, MetricSet, standard, sums_by_episode
from charms_bench.recording.columns import DRIVER_SCHEMA, EPISODE_SCHEMA, STEP_SCHEMA
from charms_bench.world.scene import SceneSettings

Rows = list[dict[str, Any]]
Episode = tuple[dict[str, Any], Rows]
"""What is to be said of an episode, and of each of its steps."""

SCENE = SceneSettings()
QUIET_STEP = {
    "speed": 25.0,
    "heading": 0.0,
    "acceleration": 0.0,
    "steering": 0.0,
    "lane": 1,
    "vehicles_near": 1,
    **dict.fromkeys(("length", "leader_length", "follower_length"), 5.0),
}
QUIET_EPISODE = {
    "ending": "time",
    "distance_m": 500.0,
    "traffic_vehicles": 20,
    "traffic_crashed": 0,
    "traffic_distance_m": 10_000.0,
}


def frames(*episodes: Episode) -> tuple[pl.DataFrame, pl.DataFrame]:
    """Episode and step rows; what is not given is quiet or null."""
    heads: Rows = []
    rows: Rows = []
    for number, (episode, steps) in enumerate(episodes):
        count = {"steps": len(steps), "duration_s": len(steps) / 3}
        heads.append({"episode": number, **count, **QUIET_EPISODE, **episode})
        rows += [
            {"episode": number, "step": step, "x": 25.0 / 3 * step, **QUIET_STEP, **row}
            for step, row in enumerate(steps, start=1)
        ]
    return pl.DataFrame(heads, schema=EPISODE_SCHEMA), pl.DataFrame(rows, schema=STEP_SCHEMA)


def driver(episode: int, agent: str, is_ego: bool = False, **sums: float) -> dict[str, Any]:
    """A driver row; what is not given is quiet or 0."""
    quiet = dict.fromkeys(DRIVER_SCHEMA, 0) | {"vehicles": 1, "distance_m": 500.0, "time_s": 20.0}
    return quiet | {"episode": episode, "agent": agent, "is_ego": is_ego, **sums}


def measure(metric: Metric, *episodes: Episode, settings: SceneSettings = SCENE) -> float:
    """The value of a metric over episodes."""
    (sums,) = sums_by_episode([metric], *frames(*episodes), settings)
    return float(metric.value(sums.sum(axis=0)))


def of_paper(name: str) -> Metric:
    """A metric of the set `paper`."""
    return _named(name, PAPER)


def of_standard(name: str, warm_up_s: float = 0.0, **thresholds: float) -> Metric:
    """A metric of the set `standard`, over all steps after a warm-up and before a collision."""
    return _named(name, standard(warm_up_s, **thresholds))


def _named(name: str, metric_set: MetricSet) -> Metric:
    (found,) = (metric for metric in metric_set.metrics if metric.name == name)
    return found
