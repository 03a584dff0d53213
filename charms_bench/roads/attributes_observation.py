"""highway-env's observation `AttributesObservation` of `lane-keeping`, with noise."""

from charms_bench.foundation.arrays import Floats, Ints
from charms_bench.foundation.compiled import compiled_of_scenes
from charms_bench.foundation.generator import random, uniform
from charms_bench.roads.dynamics import rates
from charms_bench.roads.scenes import Scenes
from charms_bench.world.road import heading_at, local_coordinates

ATTRIBUTES = ("state", "derivative", "reference_state")
"""The attributes that are supported; an attribute is an index into this tuple."""
STATE, DERIVATIVE, REFERENCE_STATE = range(len(ATTRIBUTES))
NUMBERS = 4
"""An attribute has one for each of: y, the heading, the lateral speed and the yaw rate."""


@compiled_of_scenes
def skip(scenes: Scenes, rows: Ints, count: int) -> None:
    """Draws so many numbers for nothing: highway-env observes to learn the shapes of the space."""
    for b in rows:
        for _ in range(count):
            random(scenes.generator[b])


@compiled_of_scenes
def observe(scenes: Scenes, rows: Ints, attributes: Ints, noises: Floats, out: Floats) -> None:
    """Writes the attributes (B, A, 4) of the scenes `rows` (R,) [`AttributesObservation`].

    `attributes` (A,) are indices into `ATTRIBUTES`, and `noises` (2,) the largest noise of the
    state and of its derivative.
    """
    for b in rows:
        ego, state = scenes.vehicles[b, 0], scenes.generator[b]
        for k in range(attributes.size):
            if attributes[k] == REFERENCE_STATE:
                s, r = local_coordinates(scenes.road, ego.target_lane, ego.x, ego.y)
                out[b, k, 0], out[b, k, 1] = ego.y - r, heading_at(scenes.road, ego.target_lane, s)
                out[b, k, 2] = out[b, k, 3] = 0.0
                continue
            if attributes[k] == STATE:
                numbers = (ego.y, ego.heading, ego.lateral_speed, ego.yaw_rate)
            else:
                _, y, aside, turn = rates(
                    ego.heading, ego.speed, ego.lateral_speed, ego.yaw_rate, ego.steering
                )
                numbers = (y, ego.yaw_rate, aside, turn)
            noise = noises[attributes[k]]
            for i in range(NUMBERS):
                out[b, k, i] = numbers[i] + uniform(state, -noise, noise)
