"""A replay written by hand: the ego is vehicle 0, and what is not given stays as it is."""

from typing import Any

import numpy as np
import polars as pl

from charms_bench.episodes.replay import Replay
from charms_bench.plugins.specs import AgentSpec, TrafficSpec
from charms_bench.recording.columns import EPISODE_SCHEMA, STEP_SCHEMA
from charms_bench.runs.suite import Cell, EgoEntry, TrafficEntry
from charms_bench.world.scene import SceneSettings

EGO = EgoEntry(agent=AgentSpec(name="somebody"), label="Somebody")
TRAFFIC = TrafficEntry(traffic=TrafficSpec(name="others"), label="Others")


def replay_of(
    ending: str = "time", steps: list[dict[str, Any]] | None = None, **fields: Any
) -> Replay:
    """A replay at 15 Hz with decisions at 3 Hz, on lanes of 4 m.

    Args:
        ending: How it ended.
        steps: What is to be said of each decision.
        fields: Values that broadcast to [T + 1, N]; `x` has that shape.
    """
    shape = np.shape(fields["x"])
    moving = {"y": 0.0, "heading": 0.0, "speed": 25.0, "acceleration": 0.0} | fields
    moving = {"length": 5.0, "width": 2.0} | moving
    floats = {
        name: np.broadcast_to(np.asarray(moving[name], dtype=float), shape).copy()
        for name in ("x", "y", "heading", "speed", "acceleration", "length", "width")
    }
    lane = np.broadcast_to(fields.get("lane", np.round(floats["y"] / 4)), shape).astype(int)
    lengths = dict.fromkeys(("length", "leader_length", "follower_length"), 5.0)
    rows = [
        {"episode": 7, "step": k, "speed": 25.0, "acceleration": 0.0, "lane": 1, **lengths, **row}
        for k, row in enumerate(steps or [{}], start=1)
    ]
    head = {"episode": 7, "ending": ending, "steps": len(rows), "duration_s": len(rows) / 3}
    settings = SceneSettings(traffic_vehicles=shape[1] - 1, ego_slots=1)
    return Replay(
        cell=Cell(ego=EGO, traffic=TRAFFIC, scene=settings),
        settings=settings,
        episode=7,
        ego=0,
        agents=("somebody",) + ("other",) * (shape[1] - 1),
        t_s=np.arange(shape[0]) / 15,
        present=np.ones(shape, dtype=bool),
        **floats,
        lane=lane,
        target_lane=np.broadcast_to(fields.get("target_lane", lane), shape).astype(int),
        crashed=np.broadcast_to(fields.get("crashed", False), shape).astype(bool),
        action=np.zeros(shape, dtype=int),
        has_action=np.zeros(shape, dtype=bool),
        episodes=pl.DataFrame([head], schema=EPISODE_SCHEMA),
        steps=pl.DataFrame(rows, schema=STEP_SCHEMA),
    )
