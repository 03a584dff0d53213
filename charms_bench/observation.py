"""What a policy sees.

`neighbours`: (7, 5) float32, a row a vehicle: presence, x, y, vx, vy. Row 0 is the vehicle
itself: 1, 1, y / 12 m, and its velocity / 66 m/s. Rows 1 to 6 are its nearest neighbours within
99 m, relative to it, x / 165 m, y / 12 m, velocity / 66 m/s, clipped to [-1, 1]; a row without a
neighbour is all zeros. Neighbours follow highway-env's rule, see `Scene.leader`.
"""

import math

import numpy as np

from charms_bench.agent import Observations
from charms_bench.compiled import compiled
from charms_bench.scene import Ints, Scene, Vehicles

EGO, LEFT_FRONT, LEFT_REAR, FRONT, REAR, RIGHT_FRONT, RIGHT_REAR = range(7)
"""The rows of `neighbours`."""
X_SCALE_M = 165.0
Y_SCALE_M = 12.0
SPEED_SCALE_MPS = 66.0
RANGE_M = 99.0


def neighbours(scene: Scene, vehicles: Vehicles) -> Observations:
    """The observation `neighbours` of M vehicles, (M, 7, 5)."""
    observations = np.zeros((vehicles[0].size, 7, 5), dtype=np.float32)
    _fill(scene, vehicles[0], vehicles[1], observations)
    return observations


OBSERVATIONS = {"neighbours": neighbours}
"""The observations a policy may name."""


@compiled
def _fill(scene: Scene, rows: Ints, places: Ints, observations: Observations) -> None:
    for m in range(rows.size):
        b, i = rows[m], places[m]
        x, y, speed, heading = scene.x[b, i], scene.y[b, i], scene.speed[b, i], scene.heading[b, i]
        vx, vy = speed * math.cos(heading), speed * math.sin(heading)
        observations[m, 0, 0] = 1.0
        observations[m, 0, 1] = 1.0
        observations[m, 0, 2] = y / Y_SCALE_M
        observations[m, 0, 3] = vx / SPEED_SCALE_MPS
        observations[m, 0, 4] = vy / SPEED_SCALE_MPS
        for side in range(3):
            lane = scene.lane[b, i] + side - 1
            if not 0 <= lane < scene.constants.lanes:
                continue
            for behind in range(2):
                j = scene.followers[b, i, lane] if behind else scene.leaders[b, i, lane]
                if j < 0 or abs(scene.x[b, j] - x) > RANGE_M:
                    continue
                row = 1 + 2 * side + behind
                other_vx = scene.speed[b, j] * math.cos(scene.heading[b, j])
                other_vy = scene.speed[b, j] * math.sin(scene.heading[b, j])
                observations[m, row, 0] = 1.0
                observations[m, row, 1] = _clipped((scene.x[b, j] - x) / X_SCALE_M)
                observations[m, row, 2] = _clipped((scene.y[b, j] - y) / Y_SCALE_M)
                observations[m, row, 3] = _clipped((other_vx - vx) / SPEED_SCALE_MPS)
                observations[m, row, 4] = _clipped((other_vy - vy) / SPEED_SCALE_MPS)


@compiled
def _clipped(value: float) -> float:
    return min(max(value, -1.0), 1.0)
