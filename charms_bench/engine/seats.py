"""Which agent drives which vehicle, and the places without one."""

import numpy as np

from charms_bench.foundation.compiled import compiled
from charms_bench.world.scene import VACANT_X_M, Bools, Ints, Scene


@compiled
def seat(
    rows: Ints,
    ego: Ints,
    agents: Ints,
    models: Bools,
    drivers: Ints,
    is_modelled: Bools,
    is_ego: Bools,
) -> None:
    """Gives the vehicles of the scenes `rows` (R,) their drivers.

    `agents` (R, N) are the agent of the ego, and then those of the other vehicles. `models` marks
    the agents that are driver models; agents beyond its end are not.
    """
    for r in range(rows.size):
        b = rows[r]
        for i in range(drivers.shape[1]):
            drivers[b, i] = agents[r, 0 if i == ego[b] else i + (i < ego[b])]
    mark_seats(rows, ego, models, drivers, is_modelled, is_ego)


@compiled
def mark_seats(
    rows: Ints, ego: Ints, models: Bools, drivers: Ints, is_modelled: Bools, is_ego: Bools
) -> None:
    """Marks the egos of the scenes `rows`, and the vehicles that driver models drive.

    Arguments are those of `seat`.
    """
    for b in rows:
        for i in range(drivers.shape[1]):
            agent = drivers[b, i]
            is_ego[b, i] = i == ego[b]
            is_modelled[b, i] = agent < models.size and models[agent]


@compiled
def vehicles_of(
    agent: int, drivers: Ints, scenes: Bools, present: Bools, entry: Ints
) -> tuple[Ints, Ints]:
    """The vehicles (M,) that an agent drives in the scenes [B] marked, by scene and place.

    They are sorted by scene, and then in the order of entry [B, N].
    """
    rows = np.empty(drivers.size, dtype=np.int64)
    places = np.empty(drivers.size, dtype=np.int64)
    found = 0
    for b in range(drivers.shape[0]):
        if scenes[b]:
            for i in range(drivers.shape[1]):
                if drivers[b, i] != agent or not present[b, i]:
                    continue
                k = found
                while k > 0 and rows[k - 1] == b and entry[b, places[k - 1]] > entry[b, i]:
                    places[k] = places[k - 1]
                    k -= 1
                rows[found], places[k] = b, i
                found += 1
    return rows[:found].copy(), places[:found].copy()


def vacate(scene: Scene, rows: Ints) -> None:
    """Puts the vehicles of empty places where nobody meets them."""
    empty = ~scene.present[rows]
    if not empty.any():
        return
    for name in ("y", "heading", "speed", "acceleration", "target_speed", "target_lane"):
        getattr(scene, name)[rows] *= ~empty
    for name in ("crashed", "impact"):
        getattr(scene, name)[rows] &= ~empty
    vacant_x = VACANT_X_M - 1000.0 * np.arange(scene.x.shape[1])
    scene.x[rows] = np.where(empty, vacant_x, scene.x[rows])
