"""Where the vehicles of an episode are on the network, for pictures."""

import numpy as np

from charms_bench.roads.scenes import LANDMARK, NOTHING, OBSTACLE, Scenes
from charms_bench.world.plan import OF_VEHICLES, Lines, Plan


def plan_of(lines: Lines, scenes: Scenes, b: int) -> Plan:
    """The plan of scene b, whose network has these lines."""
    vehicles = scenes.vehicles[b]
    return Plan(
        scenes.road,
        lines,
        present=vehicles["kind"] != NOTHING,
        is_obstacle=np.isin(vehicles["kind"], (LANDMARK, OBSTACLE)),
        **{name: vehicles[name].copy() for name in OF_VEHICLES[1:]},
    )
