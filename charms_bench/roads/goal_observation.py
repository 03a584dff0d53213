"""highway-env's observation `KinematicsGoalObservation` of `parking`: the ego and its goal."""

from charms_bench.foundation.arrays import Floats, Ints
from charms_bench.foundation.compiled import compiled_of_scenes
from charms_bench.roads.scenes import LANDMARK, Scenes

FEATURES = ("presence", "x", "y", "vx", "vy", "cos_h", "sin_h")
"""The features that are supported; a feature is an index into this tuple."""


@compiled_of_scenes
def observe(scenes: Scenes, rows: Ints, features: Ints, scales: Floats, out: Floats) -> None:
    """Writes the features (2, R, F) of the egos and of their goals, divided by scales (F,).

    The goal is the first landmark of a scene [`KinematicsGoalObservation.observe`].
    """
    goal = 0
    while goal < scenes.vehicles.shape[1] and scenes.vehicles[0, goal].kind != LANDMARK:
        goal += 1
    places = 0, goal % scenes.vehicles.shape[1]
    for which in range(2):
        for r in range(rows.size):
            own = scenes.vehicles[rows[r], places[which]]
            velocity = own.speed * own.direction_x, own.speed * own.direction_y
            numbers = 1.0, own.x, own.y, *velocity, own.direction_x, own.direction_y
            for k in range(features.size):
                out[which, r, k] = numbers[features[k]] / scales[k]
