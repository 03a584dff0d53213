"""Trajectories written by hand, and what each vehicle does in them."""

from types import SimpleNamespace
from typing import Any

import numpy as np
from scenes import scene_of

from charms_bench.engine.neighbours import locate
from charms_bench.recording.columns import DRIVER_SUMS
from charms_bench.recording.primitives import Primitives
from charms_bench.recording.recording import Recording
from charms_bench.world.scene import Scene

DT = 1 / 3
"""Seconds between two decisions."""


def conduct(ends: bool = True, every: int = 1, **fields: Any) -> list[dict[str, float]]:
    """The sums of each vehicle; each is its own driver.

    Args:
        ends: Whether the episode ends with the last decision.
        every: Frames of a decision interval: 1, or 5 for all of its simulation steps.
        fields: Values that broadcast to [T + 1, N], in lanes of 4 m; `x` has that shape. What is
            not given is: the middle lane, 25 m/s, and the nearest lane as the target lane.
    """
    decisions, vehicles = np.shape(fields["x"])
    given = {"y": 4.0, "speed": 25.0, "acceleration": 0.0, "crashed": False, "collision": 0}
    frames = {
        name: np.broadcast_to(values, (decisions, vehicles))
        for name, values in (given | fields).items()
    }
    collision = np.array(frames.pop("collision"), dtype=np.int8)
    scene = scene_of(profile="charms", **{name: each[0] for name, each in frames.items()})
    scene.active[:] = True
    simulation = SimpleNamespace(
        scene=scene,
        steps=np.zeros(1, dtype=np.int64),
        collision=collision[:1],
        action=np.zeros((1, vehicles), dtype=np.int64),
        has_action=np.zeros((1, vehicles), dtype=np.bool_),
        settings=SimpleNamespace(
            decision_hz=3,
            simulation_hz=15,
            steps_per_decision=5,
            decisions=decisions,
            inflow=None,
            recording=None,
            network=None,
        ),
        phase=0,
        step_watchers=[],
        collision_watchers=[],
        ego_agent="0",
        agents=tuple(map(str, range(vehicles))),
        engine=SimpleNamespace(state=scene, drivers=np.arange(vehicles)[None]),
        ego_vehicles=(np.array([0]), np.array([0])),
        seeds=np.zeros(1, dtype=np.uint64),
    )
    recorded: Any = simulation
    made = Recording(recorded)
    for t in range(1, decisions):
        for name, each in frames.items():
            getattr(scene, name)[0] = each[t]
        locate(scene, np.array([0]))
        if "target_lane" not in fields:
            scene.target_lane[:] = scene.lane
        simulation.collision = collision[t : t + 1]
        simulation.phase = 5 - (-t % every)
        for watch in simulation.step_watchers:
            watch()
        if (collision[t] != collision[t - 1]).any():
            for watch in simulation.collision_watchers:
                watch()
        if t % every:
            continue
        simulation.steps[:], simulation.phase = t // every, 0
        scene.active[:] = t < decisions - 1 or not ends
        made.note()
    rows = made.drivers()
    assert len(rows) == vehicles
    order = sorted(rows.iter_rows(named=True), key=lambda row: int(row["agent"]))
    return [{name: row[name] for name in DRIVER_SUMS} for row in order]


def vehicles_of(scene: Scene) -> Any:
    """[B, N] the vehicles of a scene as they are kept."""
    shape = scene.x.shape
    simulation: Any = SimpleNamespace(
        scene=scene,
        settings=SimpleNamespace(inflow=None, recording=None, network=None),
        steps=np.zeros(shape[0], dtype=np.int64),
        collision=np.zeros(shape, dtype=np.int8),
        action=np.zeros(shape, dtype=np.int64),
        has_action=np.zeros(shape, dtype=np.bool_),
    )
    frames = Primitives(simulation).at_decision(np.arange(shape[0]))
    return frames.vehicles[frames.moments["now"]]


def only(sums: dict[str, float], *names: str) -> dict[str, float]:
    """Some of the sums, for comparison."""
    return {name: sums[name] for name in names}
