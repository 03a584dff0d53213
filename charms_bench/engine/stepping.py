"""One simulation step of the default engine.

Each function of the step names the highway-env function that it follows. Operations keep
highway-env's order, because floating-point sums depend on it. Scenes are advanced in blocks that
stay in the processor's cache.

A kernel takes its arrays out of the scene once and passes numbers to the functions that it calls
per vehicle: passing an array costs an atomic reference count, which takes longer than the physics.
Kernels are private to the harness; `tests/naive.py` holds plain versions of them.
"""

from charms_bench.engine.collision_detection import collide
from charms_bench.engine.motion import move, room_to_turn
from charms_bench.engine.neighbours import find_neighbours, sort_by_x
from charms_bench.foundation.compiled import compiled, compiled_of_scenes
from charms_bench.world.scene import Bools, Scene

BLOCK_VEHICLES = 1024
"""Vehicles of a block, unless one scene has more."""


@compiled_of_scenes
def advance(scene: Scene, modelled: Bools, held: Bools) -> None:
    """One simulation step of every active scene, after the driver models have acted; see `move`."""
    vehicles = scene.x.shape[1]
    turning = room_to_turn(max(BLOCK_VEHICLES, vehicles))
    for first, after in blocks_of(scene.active, vehicles):
        move(scene, first, after, modelled, held, turning)
        sort_by_x(scene, first, after)
        collide(scene, first, after)
        find_neighbours(scene, first, after)


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
