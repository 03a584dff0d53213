"""One simulation step of the default engine.

Each function of the step names the highway-env function that it follows. Operations keep
highway-env's order, because floating-point sums depend on it. Scenes are advanced in blocks that
stay in the processor's cache.

A kernel takes its arrays out of the scene once and passes numbers to the functions that it calls
per vehicle: passing an array costs an atomic reference count, which takes longer than the physics.
Kernels are private to the harness; `tests/naive.py` holds plain versions of them.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from charms_bench.engine.collision_detection import collide
from charms_bench.engine.motion import move, room_to_turn
from charms_bench.engine.neighbours import find_neighbours, sort_by_x
from charms_bench.foundation import maths
from charms_bench.foundation.compiled import compiled, compiled_of_scenes
from charms_bench.world.road import closest_lane
from charms_bench.world.scene import Bools, Floats, Scene

BLOCK_VEHICLES = 1024
"""Vehicles of a block, unless one scene has more."""


class Put(NamedTuple):
    """Vehicles that a step ends somewhere else for than where they would drive; all are [B, N]."""

    moves: Bools
    """Whether the vehicle is one of them."""
    x: Floats
    """m, as in the scene."""
    y: Floats
    heading: Floats
    speed: Floats
    acceleration: Floats
    follows: Bools
    """Whether the vehicle follows a recording; two of these do not collide."""
    leaves: Bools
    """Whether the vehicle leaves before the step."""

    @classmethod
    def empty(cls, shape: tuple[int, ...]) -> "Put":
        """No vehicle of scenes of this shape."""
        kinds: dict[str, Any] = dict.fromkeys(("moves", "follows", "leaves"), np.bool_)
        return cls(**{name: np.zeros(shape, kinds.get(name, np.float64)) for name in cls._fields})


BeforeMove = Callable[[], Put | None]
"""Called between the decisions of agents and the motion of vehicles."""


@compiled_of_scenes
def advance(scene: Scene, modelled: Bools, zero_order_hold: Bools, put: Put | None = None) -> None:
    """One simulation step of every active scene, after the driver models have acted; see `move`.

    Vehicles are put somewhere before collisions are found; without any, no code for it is compiled.
    """
    vehicles = scene.x.shape[1]
    turning = room_to_turn(max(BLOCK_VEHICLES, vehicles))
    for first, after in blocks_of(scene.active, vehicles):
        move(scene, first, after, modelled, zero_order_hold, turning)
        if put is not None:
            put_vehicles(scene, first, after, put)
        sort_by_x(scene, first, after)
        if put is not None:
            collide(scene, first, after, put.follows)
        else:
            collide(scene, first, after)
        find_neighbours(scene, first, after)


@compiled
def put_vehicles(scene: Scene, first: int, after: int, put: Put) -> None:
    """Puts vehicles of the scenes from `first` to before `after` where they are to be."""
    for b in range(first, after):
        for i in range(scene.x.shape[1]):
            if not put.moves[b, i]:
                continue
            scene.x[b, i], scene.y[b, i] = put.x[b, i], put.y[b, i]
            scene.heading[b, i], scene.speed[b, i] = put.heading[b, i], put.speed[b, i]
            scene.acceleration[b, i], scene.steering[b, i] = put.acceleration[b, i], 0.0
            sine, cosine = maths.sin_cos(put.heading[b, i])
            scene.direction_y[b, i], scene.direction_x[b, i] = sine, cosine
            lane = closest_lane(scene.road, put.x[b, i], put.y[b, i], put.heading[b, i])
            scene.lane[b, i] = scene.target_lane[b, i] = lane


@compiled
def blocks_of(active: Bools, vehicles: int) -> list[tuple[int, int]]:
    """Splits the active scenes into blocks of neighbouring scenes: (first, first after)."""
    most = max(1, BLOCK_VEHICLES // vehicles)
    blocks = []
    first = 0
    while first < active.size:
        if not active[first]:
            first += 1
            continue
        after = first + 1
        while after < active.size and active[after] and after - first < most:
            after += 1
        blocks.append((first, after))
        first = after
    return blocks
