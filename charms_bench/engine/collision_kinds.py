"""How vehicles collide, noted before the wrecks move on."""

import numpy as np

from charms_bench.foundation.compiled import compiled, compiled_of_scenes
from charms_bench.world.gaps import side_gap
from charms_bench.world.scene import Bools, Floats, Ints, Scene

COLLISIONS = ("none", "striking", "struck", "side")
"""How a vehicle has collided: with the rear of another vehicle, with the front, or at its side."""
ANY_ANGLE, REAR_END_COS = -2.0, 0.9
"""The least cosine of the angle between vehicles in a rear-end collision: on the straight road,
where all vehicles drive the same way, and on others. 0.9 is 26 degrees, this project's choice."""
NO_COLLISION, STRIKING, STRUCK, SIDE_COLLISION = range(len(COLLISIONS))


@compiled
def vehicle_hit(
    x: Floats, y: Floats, length: Floats, width: Floats, vehicle: int
) -> tuple[int, bool]:
    """The vehicle that a vehicle has hit, and whether this is a rear-end collision.

    Of the vehicles with centres `x` and `y` (N,), this is the one that overlaps it most. In a
    rear-end collision, the two overlap less along the road than across it.
    """
    other, most, is_rear_end = 0, -np.inf, False
    for i in range(x.size):
        along = (length[i] + length[vehicle]) / 2 - abs(x[i] - x[vehicle])
        across = -side_gap(y[i], y[vehicle], width[i], width[vehicle])
        if i != vehicle and min(along, across) > most:
            other, most, is_rear_end = i, min(along, across), along < across
    return other, is_rear_end


@compiled
def are_noted(crashed: Bools, collision: Ints) -> bool:
    """Whether the collisions of all crashed vehicles [B, N] are noted."""
    is_crashed, how = crashed.ravel(), collision.ravel()
    is_missing = False
    for i in range(is_crashed.size):
        is_missing |= is_crashed[i] & (how[i] == NO_COLLISION)
    return not is_missing


@compiled_of_scenes
def note_collisions(scene: Scene, collision: Ints, least_cos: float) -> None:
    """Sets how vehicles [B, N] have just collided, as indices into `COLLISIONS`.

    Where the cosine of the angle between two vehicles is less, it is a side collision.
    """
    x, y, length, width = scene.x, scene.y, scene.length, scene.width
    for b in range(x.shape[0]):
        for i in range(x.shape[1]):
            if scene.crashed[b, i] and collision[b, i] == NO_COLLISION:
                other, is_rear_end = vehicle_hit(x[b], y[b], length[b], width[b], i)
                cos = scene.direction_x[b, i] * scene.direction_x[b, other]
                cos += scene.direction_y[b, i] * scene.direction_y[b, other]
                is_rear_end &= cos >= least_cos
                is_behind = x[b, i] < x[b, other]
                at_an_end = STRIKING if is_behind else STRUCK
                collision[b, i] = at_an_end if is_rear_end else SIDE_COLLISION
