"""When an episode ends, and how."""

import numpy as np

from charms_bench.foundation.compiled import compiled, compiled_of_scenes
from charms_bench.world.road import is_on_lane
from charms_bench.world.scene import Bools, Ints, Scene

ENDINGS = ("running", "time", "rear_end", "side", "off_road", "goal")
"""The states of an episode; `Simulation.ending` holds indices."""
RUNNING, TIME, REAR_END, SIDE, OFF_ROAD, GOAL = range(len(ENDINGS))


@compiled_of_scenes
def end_episodes(
    scene: Scene, decisions: int, ends_off_road: bool, goals: Bools, steps: Ints, ending: Ints
) -> None:
    """Counts a decision interval of the active scenes (B,), and ends those that are over."""
    for b in range(steps.size):
        if not scene.active[b]:
            continue
        steps[b] += 1
        if ending[b] == RUNNING and goals[b]:
            ending[b] = GOAL
        if ending[b] == RUNNING and steps[b] >= decisions:
            ending[b] = TIME
        is_off_road = not is_on_own_lane(b, scene.ego[b], scene)
        if ends_off_road and is_off_road and ending[b] in (RUNNING, TIME, GOAL):
            ending[b] = OFF_ROAD
        scene.active[b] = ending[b] == RUNNING


@compiled_of_scenes
def are_off_road(scene: Scene, rows: Ints, places: Ints) -> Bools:
    """(M,) whether the centres of M vehicles are outside their lanes."""
    off_road = np.empty(rows.size, dtype=np.bool_)
    for m in range(rows.size):
        off_road[m] = not is_on_own_lane(rows[m], places[m], scene)
    return off_road


@compiled
def is_on_own_lane(b: int, i: int, scene: Scene) -> bool:
    """Whether the centre of vehicle i of scene b is on its lane [`RoadObject.on_road`]."""
    x, y, lane = scene.x[b, i], scene.y[b, i], scene.lane[b, i]
    return bool(is_on_lane(scene.road, lane, x, y, 0.0))
