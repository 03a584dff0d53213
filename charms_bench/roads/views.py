"""What each vehicle on a network sees along its own way; see `engine.views`."""

from typing import Any

import numpy as np

from charms_bench.engine.collision_kinds import NO_COLLISION
from charms_bench.foundation import maths
from charms_bench.foundation.arrays import Bools, Floats, Ints
from charms_bench.foundation.compiled import compiled, compiled_of_scenes, inlined, wrap_to_pi
from charms_bench.roads.fault import Fault
from charms_bench.roads.locating import coordinates_of, forget, heading_on
from charms_bench.roads.scenes import (
    BEHIND,
    OBSTACLE,
    WAY_LANES,
    Here,
    Row,
    Scenes,
    here_of,
    lane_of,
    no_ways,
    vehicle_of,
    way_of,
)
from charms_bench.roads.straightened import (
    find_way,
    has_left_way,
    lane_at,
    place_on,
    see,
    target_beside,
)
from charms_bench.world.lane_geometry import END_MARGIN_M
from charms_bench.world.road import Straight, heading_at, is_near_lane, is_on_length
from charms_bench.world.scene import VACANT_X_M, Scene, SceneSettings, Vehicles

ALONG = np.dtype(
    [(name, "f8") for name in ("x", "y")]
    + [(name, "i8") for name in ("lane", "target_lane", "k", "place")]
)
"""Where a vehicle is along a way, beside lane `k` of it, -1 for none. `place` is a column of its
own: the vehicles by x."""


class RoadViews:
    """The `engine.views.Views` of scenes on a network; `state` has them as `Engine.state`."""

    def __init__(self, settings: SceneSettings, scenes: Scenes, state: Scene, fault: Fault) -> None:
        self._settings, self._state, self._fault = settings, state, fault
        count, self._ways = len(scenes.vehicles), no_ways(*state.x.shape)
        self._scenes = scenes._replace(ways=self._ways)
        self._along = np.zeros(state.x.shape[1], ALONG)
        self._along["place"] = np.arange(state.x.shape[1])
        self.own = Scene.empty(settings, count)._replace(entry=state.entry, active=state.active)
        self._entry = np.where(state.present, state.entry, -1)
        self.collision: Ints = np.zeros(state.x.shape, dtype=np.int8)
        self.at_fault: Bools = np.zeros(state.x.shape, dtype=np.bool_)
        self._roads = np.full(state.x.shape, -1)
        self.turned: Bools = np.zeros(state.x.shape, dtype=np.bool_)
        self._has_passed_end: Bools = np.zeros(state.x.shape, dtype=np.bool_)
        self._oncoming = np.full(state.x.shape, -1)
        self._headings = headings_at_ends(scenes)
        self.look(np.arange(count))

    def follow(self) -> None:
        self._follow(np.nonzero(self._state.active)[0])

    def _follow(self, rows: Ints) -> None:
        entry = np.where(self._state.present, self._state.entry, -1)
        is_new = entry != self._entry
        if is_new.any():
            self._entry = entry
            self._ways["lanes"][is_new] = -1
            self.collision[is_new], self.at_fault[is_new] = NO_COLLISION, False
            self._has_passed_end[is_new], self._oncoming[is_new] = False, -1
        follow_all(self._scenes, rows)

    def judge(self) -> None:
        for b, i in zip(*np.nonzero(self._state.crashed & (self.collision == 0)), strict=True):
            if self._state.present[b, i]:
                at_fault, how = self._fault.judged(self._scenes, b, i)
                self.at_fault[b, i], self.collision[b, i] = at_fault == 1.0, how

    def look(self, scenes: Ints) -> None:
        self._follow(scenes)
        roads = self._scenes.road.lanes["first"][self._scenes.vehicles["lane"]]
        self.turned, self._roads = roads != self._roads, roads
        see_themselves(self._scenes, self.own.unpacked, scenes)
        self._has_passed_end |= self._pass_ends()
        self.own.present[:] = self._state.present & ~self._has_passed_end

    def _pass_ends(self) -> Bools:
        """[B, N] whether vehicles are beyond a lane that no lane follows, or only an oncoming one,
        on which they turn round shortly before its end."""
        lanes, starts = self._ways["lanes"], self._ways["starts"][..., BEHIND]
        own, following, road = lanes[..., BEHIND], lanes[..., BEHIND + 1], self._scenes.road.lanes
        beyond, (at_start, at_end) = self.own.x - starts - road["length"][own], self._headings
        has_turned_round = self._roads == self._oncoming
        is_oncoming = (following >= 0) & (np.cos(at_start[following] - at_end[own]) < -0.5)
        self._oncoming = np.where(is_oncoming, road["first"][following], -1)
        passes: Bools = np.where(is_oncoming, beyond >= -END_MARGIN_M / 2, beyond >= END_MARGIN_M)
        passes &= is_oncoming | (following < 0)
        passes |= has_turned_round
        passes[np.arange(len(passes)), self._state.ego] = False
        return passes & (own >= 0)

    def see(self, vehicles: Vehicles, after: Ints, seen: Any) -> None:
        rows, places = vehicles
        see_each(self._scenes, self.own.unpacked, self._along, rows, places, after, seen)


def headings_at_ends(scenes: Scenes) -> tuple[Floats, Floats]:
    """(L,) the headings of all lanes at their starts and at their ends."""
    road, lengths = scenes.road, scenes.road.lanes["length"]
    at_start, at_end = (
        np.array([heading_at(road, lane, s) for lane, s in enumerate(at)])
        for at in (np.zeros_like(lengths), lengths)
    )
    return at_start, at_end


@compiled_of_scenes
def follow_all(scenes: Scenes, rows: Ints) -> None:
    """Finds the ways of all vehicles of the scenes `rows`."""
    for b in rows:
        here = here_of(scenes, b)
        for i in range(here.places):
            if has_left_way(here, i) and vehicle_of(here, i).kind > OBSTACLE:
                find_way(scenes.road, here, i)


@compiled_of_scenes
def see_themselves(scenes: Scenes, own: Any, rows: Ints) -> None:
    """Fills in each vehicle of the scenes `rows` as it sees itself."""
    for b in rows:
        here = here_of(scenes, b)
        for i in range(here.places):
            forget(here, i)
            if vehicle_of(here, i).kind > OBSTACLE:
                see(here, i, i, i + 1, own.scene, b)


@compiled_of_scenes
def see_each(
    scenes: Scenes, own: Any, along: Any, rows: Ints, places: Ints, ends: Ints, seen: Any
) -> None:
    """Fills in what M vehicles see.

    Where the others are along a way is found once for all vehicles of a scene that drive along it.
    """
    road, itself = own.scene.road, own.scene
    is_done, first, after = np.zeros(rows.size, np.bool_), 0, 0
    while first < rows.size:
        b = rows[first]
        here = here_of(scenes, b)
        for i in range(here.places):
            forget(here, i)
        while after < rows.size and rows[after] == b:
            after += 1
        for m in range(first, after):
            if is_done[m]:
                continue
            way = way_of(here, places[m])
            find_along(here, road, way, along)
            for n in range(m, after):
                j = places[n]
                if not is_done[n] and is_same_way(way, way_of(here, j)):
                    x, lane = itself.x[b, j], itself.lane[b, j]
                    mine = seen[ends[n - 1] if n else 0 : ends[n]]
                    look_around(here, road, way, j, x, lane, along, mine)
                    is_done[n] = True
        first = after


@inlined
def is_same_way(one: Row, other: Row) -> bool:
    """Whether two vehicles of a scene drive along the same lanes."""
    if one.starts[BEHIND] != other.starts[BEHIND]:
        return False
    for k in range(WAY_LANES):
        lane = one.lanes[k]
        if lane != other.lanes[k]:
            return False
        if lane >= 0 and one.numbers[k] != other.numbers[k]:
            return False
        if lane >= 0 and one.starts[k] != other.starts[k]:
            return False
    return True


@compiled
def find_along(here: Here, road: Straight, way: Row, along: Any) -> None:
    """Fills in where all vehicles [N] are along a way, as `straighten` does, in order.

    The vehicle that drives along it is placed like the others.
    """
    lanes, numbers, starts = way.lanes, way.numbers, way.starts
    width, count = road.lane_width, min(lane_of(here, lanes[BEHIND]).lanes, road.lanes)
    for i in range(here.places):
        own = along[i]
        own.k = k = place_on(here, i, way, -1.5 * width, (count + 0.5) * width, width)
        own.x = VACANT_X_M
        if k >= 0:
            at = coordinates_of(here, i, lanes[k])
            own.x, own.y = starts[k] + at.s, numbers[k] * width + at.r
            own.lane = lane = lane_at(own.y, width, count)
            own.target_lane = target_beside(here, vehicle_of(here, i), lane, count)
    # As in `engine.neighbours.sort_by_x`: of two that are level, the later one is first.
    for q in range(1, here.places):
        i = along[q].place
        x, m = along[i].x, q
        while m > 0:
            j = along[m - 1].place
            if along[j].x < x or (along[j].x == x and j > i):
                break
            along[m].place = j
            m -= 1
        along[m].place = i


@compiled
def look_around(
    here: Here,
    road: Straight,
    way: Row,
    viewer: int,
    own_x: float,
    own_lane: int,
    along: Any,
    seen: Any,
) -> None:
    """Fills in the rows of what a vehicle sees along its lanes.

    Its neighbours are those that `engine.neighbours` finds in its scene as `straighten` makes it.
    """
    low, high = 0, along.size
    while low < high:
        middle = (low + high) // 2
        if along[along[middle].place].x < own_x:
            low = middle + 1
        else:
            high = middle
    sought = 0
    for side in range(4):
        seen[side].place = -1
        sought += side < 3 and 0 <= own_lane + side - 1 < road.lanes
    for q in range(low, along.size):
        i = along[q].place
        if sought == 0:
            break
        if i == viewer or along[i].k < 0 or not is_on_length(road, along[i].x):
            continue
        for side in range(3):
            on = own_lane + side - 1
            if seen[side].place < 0 <= on < road.lanes and is_near_lane(road, on, along[i].y):
                note(seen[side], i, along[i])
                lane = way.lanes[along[i].k]
                heading = heading_on(here, lane_of(here, lane), coordinates_of(here, i, lane).s)
                heading = wrap_to_pi(vehicle_of(here, i).heading - heading)
                seen[side].direction_y, seen[side].direction_x = maths.sin_cos(heading)
                sought -= 1
    for q in range(low - 1, -1, -1):
        i = along[q].place
        if i == viewer or not is_on_length(road, along[i].x):
            continue
        if is_near_lane(road, own_lane, along[i].y):
            note(seen[3], i, along[i])
            break
    for m in range(4, seen.size):
        i = m - 4 + (m - 4 >= viewer)
        note(seen[m], i, along[i])


@inlined
def note(seen: Any, i: int, other: Any) -> None:
    """Fills in a row of what a vehicle sees of vehicle i."""
    seen.place, seen.x, seen.y = i, other.x, other.y
    seen.lane, seen.target_lane = other.lane, other.target_lane
    seen.direction_x, seen.direction_y = 1.0, 0.0
