"""What the egos have reached and what they should reach, for highway-env's `KinematicsGoal`."""

from collections.abc import Sequence

import numpy as np

from charms_bench.foundation.arrays import Floats, Ints
from charms_bench.roads.scenes import LANDMARK, Scenes

FEATURES = ("presence", "x", "y", "vx", "vy", "cos_h", "sin_h")
"""The features that are supported."""


def achieved_and_desired(
    scenes: Scenes, rows: Ints, features: Sequence[str], scales: Floats
) -> tuple[Floats, Floats]:
    """The features (R, F) of the egos and of their goals, divided by scales (F,).

    [`KinematicsGoalObservation.observe`]
    """
    goal = np.argmax(scenes.vehicles["kind"][0] == LANDMARK)
    achieved, desired = (np.empty((rows.size, len(features))) for _ in range(2))
    for place, out in ((0, achieved), (goal, desired)):
        table = scenes.vehicles[rows, place]
        values = {
            "presence": np.ones(rows.size),
            "x": table["x"],
            "y": table["y"],
            "vx": table["speed"] * table["direction_x"],
            "vy": table["speed"] * table["direction_y"],
            "cos_h": table["direction_x"],
            "sin_h": table["direction_y"],
        }
        for k, name in enumerate(features):
            out[:, k] = values[name] / scales[k]
    return achieved, desired
