"""Vehicles that arrive at random where a road's lanes begin, and leave where they end.

The rules are those of `engine.open_road`. Each road between two nodes that no other one leads to
has arrivals and a queue of its own. Arrivals depend on an episode's seed alone and are numbered by
their times.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from charms_bench.engine.open_road import STREAM
from charms_bench.engine.type_draws import draw_vehicles
from charms_bench.errors import InputError
from charms_bench.foundation.arrays import Floats, Ints
from charms_bench.foundation.compiled import compiled, compiled_of_scenes
from charms_bench.roads.locating import as_followed, coordinates_of, distance_to, forget
from charms_bench.roads.scenes import (
    IDM,
    NOTHING,
    OBSTACLE,
    Here,
    Scenes,
    here_of,
    place_near,
    tidy_all,
)
from charms_bench.roads.vehicle_order import neighbours
from charms_bench.world.idm_mobil import equilibrium_gap
from charms_bench.world.road import heading_at, position
from charms_bench.world.scene import SceneSettings

ENTRY_M = 5.0
"""How far along its lane a vehicle enters."""


class Arrivals(NamedTuple):
    """The A next vehicles at K starts in B scenes; SI units."""

    lanes: Ints
    """Those of each start."""
    ends: Ints
    """(K,) the place in `lanes` after the last one of each start."""
    times: Floats
    """(B, K, A + 1), the last infinite."""
    numbers: Ints
    """(B, K, A) those of the vehicles; see `world.scene.Scene`."""
    desired: Floats
    """(B, K, A) their desired speeds, NaN for those that want the speed limit; then their sizes."""
    length: Floats
    width: Floats


class RoadInflow:
    """The arrivals in B scenes at the lanes `starts`, which begin where no other one ends."""

    def __init__(self, settings: SceneSettings, scenes: Scenes, starts: Ints) -> None:
        assert settings.inflow is not None
        self._settings, count = settings, len(scenes.vehicles)
        firsts = scenes.road.lanes["first"][starts]
        lanes = np.unique(firsts, return_counts=True)[1]
        self._per_s = settings.inflow.vehicles_per_hour_and_lane * lanes / 3600
        expected = float(self._per_s.max()) * settings.duration_s
        most = math.ceil(expected + 10 * math.sqrt(expected) + 10)
        shape = count, lanes.size, most
        by_road = starts[np.argsort(firsts, kind="stable")]
        numbers = np.zeros(shape, dtype=np.int64)
        times = np.full((*shape[:2], most + 1), np.inf)
        sizes = (float(scenes.constants[name][0]) for name in ("length", "width"))
        drawn = (np.full(shape, value) for value in (np.nan, *sizes))
        self._arrivals = Arrivals(by_road, lanes.cumsum(), times, numbers, *drawn)
        self.most = lanes.size * most
        """More vehicles than ever arrive in an episode."""
        self.entered = np.zeros(shape[:2], dtype=np.int64)
        """(B, K) how many have entered at each start."""

    def draw(self, rows: Ints, seeds: NDArray[np.uint64]) -> None:
        """Draws the arrivals in the scenes `rows` (R,), by their seeds."""
        arrivals, settings = self._arrivals, self._settings
        starts, most = arrivals.numbers.shape[1:]
        for row, seed in zip(rows.tolist(), seeds, strict=True):
            rng = np.random.default_rng([int(seed), STREAM])
            between = rng.exponential(1 / self._per_s[:, None], (starts, most))
            arrivals.times[row, :, :-1] = times = between.cumsum(axis=1)
            ranks = times.ravel().argsort(kind="stable").argsort()
            arrivals.numbers[row] = ranks.reshape(starts, most) + settings.vehicles
            if not settings.vehicle_types:
                continue
            numbers = arrivals.numbers[[row]].reshape(1, -1)
            nobody = np.zeros(numbers.shape, dtype=np.bool_)
            drawn = draw_vehicles(settings, np.array([seed]), numbers, nobody)
            for array, values in zip(arrivals[-3:], drawn, strict=True):
                array[row] = values.reshape(starts, most)

    def flow(self, scenes: Scenes, rows: Ints, times_s: Floats) -> Ints:
        """Has vehicles leave and enter the scenes `rows` (R,) at the times `times_s` (R,).

        Returns the numbers (R, N) of those that have entered, -1 for all others; raises an
        `InputError` if a scene is full.
        """
        numbers = np.full((rows.size, scenes.vehicles.shape[1]), -1)
        full = _flow(scenes, rows, times_s, self._arrivals, self.entered, numbers)
        if full >= 0:
            there = int((scenes.vehicles["kind"][rows[full]] > OBSTACLE).sum())
            raise InputError(
                f"scene.inflow.capacity: an episode is full after {times_s[full]:.1f} s, with "
                f"{there} vehicles; use a larger number"
            )
        tidy_all(scenes, rows)
        return numbers


@compiled_of_scenes
def _flow(
    scenes: Scenes, rows: Ints, times_s: Floats, arrivals: Arrivals, entered: Ints, numbers: Ints
) -> int:
    """See `RoadInflow.flow`; returns the index of a row that is full, or -1."""
    for r in range(rows.size):
        b = rows[r]
        here = here_of(scenes, b)
        for i in range(here.places):
            forget(here, i)
        for i in range(1, here.places):
            vehicle = scenes.vehicles[b, i]
            row = scenes.road.lanes[vehicle.lane]
            is_on_last = vehicle.kind > OBSTACLE and row.next_count == 0
            if is_on_last and coordinates_of(here, i, vehicle.lane).s >= row.length:
                vehicle.kind = NOTHING
                forget(here, i)
        for k in range(entered.shape[1]):
            while arrivals.times[b, k, entered[b, k]] <= times_s[r]:
                i = 1
                while i < here.places and scenes.vehicles[b, i].kind != NOTHING:
                    i += 1
                if i == here.places:
                    return r
                if not enter(scenes, here, b, i, k, arrivals, entered[b, k]):
                    break
                numbers[r, i] = arrivals.numbers[b, k, entered[b, k]]
                entered[b, k] += 1
    return -1


@compiled
def enter(
    scenes: Scenes, here: Here, b: int, i: int, k: int, arrivals: Arrivals, number: int
) -> bool:
    """Puts the next vehicle of start k on the lane with the most room, if it is enough."""
    road, vehicle = scenes.road, scenes.vehicles[b, i]
    best, most, ahead = -1, -math.inf, 0.0
    for m in range(arrivals.ends[k - 1] if k > 0 else 0, arrivals.ends[k]):
        stand(scenes, here, b, i, arrivals.lanes[m], 0.0)
        vehicle.length, vehicle.width = arrivals.length[b, k, number], arrivals.width[b, k, number]
        room, leader_speed = room_ahead(scenes, here, b, i)
        if room > most:
            best, most, ahead = arrivals.lanes[m], room, leader_speed
    wanted = arrivals.desired[b, k, number]
    has_wish, limit = not math.isnan(wanted), road.lanes[best].speed_limit
    target = min(wanted, limit) if has_wish else limit
    speed = max(min(target, ahead), 0.0)
    if best < 0 or most < equilibrium_gap(speed, here.constants):
        vehicle.kind = NOTHING
        forget(here, i)
        return False
    stand(scenes, here, b, i, best, speed)
    vehicle.length, vehicle.width = arrivals.length[b, k, number], arrivals.width[b, k, number]
    vehicle.target_speed = target
    if has_wish:
        vehicle.desired_speed = wanted
    return True


@compiled
def stand(scenes: Scenes, here: Here, b: int, i: int, lane: int, speed: float) -> None:
    """Puts vehicle i at the start of a lane."""
    s = min(ENTRY_M, scenes.road.lanes[lane].length)
    x, y = position(scenes.road, lane, s, 0.0)
    place_near(scenes, b, i, IDM, lane, x, y, heading_at(scenes.road, lane, s), speed)
    forget(here, i)


@compiled
def room_ahead(scenes: Scenes, here: Here, b: int, i: int) -> tuple[float, float]:
    """How far ahead of vehicle i the next one is that is on its lane or steers to it, m.

    And that one's speed. There is no room as long as another one is behind.
    """
    lane = scenes.vehicles[b, i].lane
    front, rear = neighbours(here, i, lane)
    room, speed = math.inf, math.inf
    if front >= 0:
        room, speed = as_followed(here, i, front, here.clock.gap), scenes.vehicles[b, front].speed
    for j in range(here.places):
        other = scenes.vehicles[b, j]
        if other.kind > OBSTACLE and other.target_lane == lane and other.lane != lane:
            away = distance_to(here, i, j)
            if away < room:
                room, speed = away, other.speed
    return (-math.inf if rear >= 0 else room), speed
