"""How close an ego came to a collision, as one number that falls towards it and below 0 in it."""

import math

import numpy as np

from charms_bench.engine.events import beside
from charms_bench.engine.simulation import Simulation
from charms_bench.foundation.compiled import compiled
from charms_bench.world.gaps import side_gap
from charms_bench.world.scene import Floats, Ints, Scene

TOUCH = -0.1
"""The margin of a collision without a relative speed."""


def margins(simulation: Simulation, seeds: Ints) -> Floats:
    """Simulates one episode in each of the B scenes, and returns the margin (B,) of each.

    Without a collision, it is the ego's least distance to another vehicle in m: the larger one of
    the gaps along and across the road, and 0 if both are negative, since vehicles that turn can be
    that close. With a collision, it is the negative relative speed in m/s, and at most `TOUCH`.

    On a network, the gaps are those along and across the ego, to the rectangle along it that
    contains the other vehicle, and `TOUCH` is the least margin where it leaves the road.
    """
    simulation.reset(seeds.astype(np.uint64))
    turns = simulation.settings.network is not None
    found = np.full(seeds.size, np.inf)
    while simulation.scene.active.any():
        for _ in range(simulation.settings.steps_per_decision):
            speed = simulation.engine.state.speed.copy()
            simulation.advance()
            lower(simulation.engine.state, speed, turns, found)
        simulation.finish_step()
    return np.where(simulation.failed, np.minimum(found, TOUCH), found)


@compiled
def lower(scene: Scene, speed: Floats, turns: bool, found: Floats) -> None:
    """Lowers the margins to that of the step that has ended; `speed` is from before the step.

    Unless the road `turns`, vehicles are rectangles along it.
    """
    x, y, length, width = scene.x, scene.y, scene.length, scene.width
    for b in range(found.size):
        if not scene.active[b] or found[b] < 0:
            continue
        i = scene.ego[b]
        least, relative = np.inf, 0.0
        for j in range(x.shape[1]):
            if j == i or (turns and not scene.present[b, j]):
                continue
            if turns:
                ahead, aside, along, across, long, wide = beside(scene, speed, b, i, j)
                gap = max(abs(ahead) - long / 2, abs(aside) - wide / 2)
                closing = math.hypot(along, across)
            else:
                gap = max(
                    abs(x[b, j] - x[b, i]) - (length[b, i] + length[b, j]) / 2,
                    side_gap(y[b, i], y[b, j], width[b, i], width[b, j]),
                )
                closing = abs(speed[b, i] - speed[b, j])
            if gap < least:
                least, relative = gap, closing
        if turns and least > 0:  # what it has hit is an obstacle
            relative = abs(speed[b, i])
        if scene.crashed[b, i]:
            found[b] = min(TOUCH, -relative)
        else:
            found[b] = min(found[b], max(least, 0.0))
