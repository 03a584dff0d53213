"""How close an ego came to a collision, as one number that falls towards it and below 0 in it."""

import numpy as np

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
    """
    simulation.reset(seeds.astype(np.uint64))
    found = np.full(seeds.size, np.inf)
    while simulation.scene.active.any():
        for _ in range(simulation.settings.steps_per_decision):
            speed = simulation.scene.speed.copy()
            simulation.advance()
            _lower(simulation.scene, speed, found)
        simulation.finish_step()
    return np.where(simulation.failed, np.minimum(found, TOUCH), found)


@compiled
def _lower(scene: Scene, speed: Floats, found: Floats) -> None:
    """Lowers the margins to that of the step that has ended; `speed` is from before the step."""
    x, y, length, width = scene.x, scene.y, scene.length, scene.width
    for b in range(found.size):
        if not scene.active[b] or found[b] < 0:
            continue
        i = scene.ego[b]
        least, nearest = np.inf, i
        for j in range(x.shape[1]):
            along = abs(x[b, j] - x[b, i]) - (length[b, i] + length[b, j]) / 2
            across = side_gap(y[b, i], y[b, j], width[b, i], width[b, j])
            if j != i and max(along, across) < least:
                least, nearest = max(along, across), j
        if scene.crashed[b, i]:
            found[b] = min(TOUCH, -abs(speed[b, i] - speed[b, nearest]))
        else:
            found[b] = min(found[b], max(least, 0.0))
