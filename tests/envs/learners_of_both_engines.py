"""Steps random actions for many vehicles in both engines, and prints what differs as JSON.

It is a program, because highway-env has to start with `worker_environment("highway-env")` to give
the same bits.
"""

import json
import sys
from collections.abc import Sequence

import numpy as np

from charms_bench.engine.exact_maths import use_exact_maths
from charms_bench.engine.simulation import Simulation
from charms_bench.envs.learners import FromOutside
from charms_bench.plugins.registry import make_agent
from charms_bench.plugins.traffic import OneAgent
from charms_bench.world.actions import ACTIONS
from charms_bench.world.scene import SceneSettings

COMPARED = ("x", "y", "heading", "speed", "acceleration", "steering", "timer_s")
COMPARED += ("lane", "target_lane", "target_speed", "crashed", "impact")


def differences(settings: SceneSettings, numbers: Sequence[int], scenes: int) -> dict[str, float]:
    """Drives these vehicles, as in `Learners`; a wreck gets no more actions."""
    traffic = FromOutside(numbers, OneAgent("idm_mobil"))
    agents = {"idm_mobil": make_agent("idm_mobil")}
    ours, theirs = (
        Simulation(settings, scenes, None, traffic, agents, engine)
        for engine in ("batched", "highway-env")
    )
    for simulation in (ours, theirs):
        simulation.reset(np.arange(scenes, dtype=np.uint64))
    is_driven = ours.drivers == ""
    rng = np.random.default_rng(0)
    largest, lane_changes, steps = 0.0, 0, 0
    while ours.scene.active.any():
        vehicles = np.nonzero(is_driven & ~ours.scene.crashed)
        actions = rng.integers(len(ACTIONS), size=vehicles[0].size)
        before = ours.scene.target_lane.copy()
        for simulation in (ours, theirs):
            simulation.command(vehicles, actions)
        for _ in range(settings.steps_per_decision):
            ours.advance()
            theirs.advance()
            steps += scenes
            for name in COMPARED:
                one, other = (getattr(each.scene, name).astype(float) for each in (ours, theirs))
                largest = max(largest, float(np.abs(one - other).max()))
        lane_changes += int((ours.scene.target_lane != before).sum())
        for simulation in (ours, theirs):
            simulation.finish_step()
    return {
        "largest": largest,
        "driven": int(is_driven.sum()),
        "steps": steps,
        "lane_changes": lane_changes,
        "crashed": int((ours.scene.crashed & is_driven).sum()),
    }


if __name__ == "__main__":
    use_exact_maths("highway-env")
    profile, scenes, *numbers = sys.argv[1:]
    settings = SceneSettings.model_validate(
        {"profile": profile, "traffic_vehicles": 11, "duration_s": 8.0}
    )
    print(json.dumps(differences(settings, [*map(int, numbers)], int(scenes))))
