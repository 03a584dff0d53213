"""What each vehicle on a network sees along its own way; see `engine.views`."""

from typing import Any

import numpy as np

from charms_bench.engine.collision_kinds import NO_COLLISION
from charms_bench.foundation import maths
from charms_bench.foundation.arrays import Bools, Floats, Ints
from charms_bench.foundation.compiled import Unpacked, compiled, compiled_of_scenes, wrap_to_pi
from charms_bench.roads.fault import Fault
from charms_bench.roads.locating import coordinates_of, forget, heading_on
from charms_bench.roads.scenes import OBSTACLE, Here, Scenes, here_of, lane_of, vehicle_of
from charms_bench.roads.straightened import (
    BEHIND,
    Ways,
    find_way,
    lane_at,
    place_on,
    see,
    target_beside,
)
from charms_bench.world.road import Straight, is_near_lane, is_on_length
from charms_bench.world.scene import VACANT_X_M, Scene, SceneSettings, Vehicles


class RoadViews:
    """The `engine.views.Views` of scenes on a network.

    Args:
        settings: Those of the scenes.
        scenes: The scenes.
        state: The same, as `Engine.state`.
        fault: Judges their collisions.
    """

    def __init__(self, settings: SceneSettings, scenes: Scenes, state: Scene, fault: Fault) -> None:
        self._settings, self._scenes, self._state, self._fault = settings, scenes, state, fault
        count = len(scenes.vehicles)
        self._ways = Ways.empty(*state.x.shape)
        self._unpacked = _unpacked(self._ways)
        self.own = Scene.empty(settings, count)._replace(
            present=state.present, entry=state.entry, active=state.active
        )
        self._entry = np.where(state.present, state.entry, -1)
        self.collision: Ints = np.zeros(state.x.shape, dtype=np.int8)
        self.at_fault: Bools = np.zeros(state.x.shape, dtype=np.bool_)
        self.look(np.arange(count))

    def follow(self) -> None:
        entry = np.where(self._state.present, self._state.entry, -1)
        is_new = entry != self._entry
        if is_new.any():
            self._entry = entry
            self._ways.lanes[is_new] = -1
            self.collision[is_new], self.at_fault[is_new] = NO_COLLISION, False
        follow_all(self._scenes, self._unpacked, np.nonzero(self._state.active)[0])

    def judge(self) -> None:
        for b, i in zip(*np.nonzero(self._state.crashed & (self.collision == 0)), strict=True):
            if self._state.present[b, i]:
                at_fault, how = self._fault.judged(self._scenes, b, i)
                self.at_fault[b, i], self.collision[b, i] = at_fault == 1.0, how

    def look(self, scenes: Ints) -> None:
        self.follow()
        see_themselves(self._scenes, self.own.unpacked, self._unpacked, scenes)

    def see(self, vehicles: Vehicles, seen: Any) -> None:
        see_each(self._scenes, self.own.unpacked, self._unpacked, *vehicles, seen)


@compiled
def _unpacked(ways: Any) -> Unpacked:
    """Unpacks ways; see `roads.scenes`."""
    return Unpacked(ways)  # type: ignore[no-untyped-call]


@compiled_of_scenes
def follow_all(scenes: Scenes, ways: Any, rows: Ints) -> None:
    """Finds the ways of all vehicles of the scenes `rows`."""
    for b in rows:
        here = here_of(scenes, b)
        for i in range(here.places):
            if vehicle_of(here, i).kind > OBSTACLE:
                find_way(scenes, b, i, ways.scene)


@compiled_of_scenes
def see_themselves(scenes: Scenes, own: Any, ways: Any, rows: Ints) -> None:
    """Fills in each vehicle of the scenes `rows` as it sees itself."""
    for b in rows:
        here = here_of(scenes, b)
        for i in range(here.places):
            forget(here, i)
            if vehicle_of(here, i).kind > OBSTACLE:
                find_way(scenes, b, i, ways.scene)
                see(here, i, i, ways.scene, b, BEHIND, own.scene, b)


@compiled_of_scenes
def see_each(scenes: Scenes, own: Any, ways: Any, rows: Ints, places: Ints, seen: Any) -> None:
    """Fills in what M vehicles see."""
    last, found, at_x = -1, np.empty(4, np.int64), np.empty(4)
    for m in range(rows.size):
        here = here_of(scenes, rows[m])
        for i in range(here.places if rows[m] != last else 0):
            forget(here, i)
        last = rows[m]
        look_around(here, own.scene.road, ways.scene, last, places[m], seen[m], found, at_x)


@compiled
def look_around(
    here: Here, road: Straight, ways: Ways, b: int, viewer: int, now: Any, found: Ints, at_x: Floats
) -> None:
    """Fills in the records [N] of what a vehicle sees.

    Its neighbours are those that `engine.neighbours` finds in the scene that `straighten` makes:
    of two vehicles that are level, the later place leads, and the earlier one follows. `found` and
    `at_x` are room for them: the leaders on the lanes from the left, then the follower.
    """
    lanes, numbers, starts = ways.lanes[b, viewer], ways.numbers[b, viewer], ways.starts[b, viewer]
    width, count = road.lane_width, min(lane_of(here, lanes[BEHIND]).lanes, road.lanes)
    least_y, largest_y, own = -1.5 * width, (count + 0.5) * width, now[viewer]
    found[:], at_x[:3], at_x[3] = -1, np.inf, -np.inf
    for i in range(here.places):
        if i == viewer:
            continue
        k, other = place_on(here, i, lanes, numbers, least_y, largest_y, width), now[i]
        if k < 0:
            other.x = VACANT_X_M
            continue
        at = coordinates_of(here, i, lanes[k])
        x, y = starts[k] + at.s, numbers[k] * width + at.r
        lane = lane_at(y, width, count)
        other.x, other.y, other.lane = x, y, lane
        other.target_lane = target_beside(here, vehicle_of(here, i), lane, count)
        for side in range(3 if is_on_length(road, x) else 0):
            on = own.lane + side - 1
            if not 0 <= on < road.lanes or not is_near_lane(road, on, y):
                continue
            if own.x <= x <= at_x[side]:
                found[side], at_x[side] = i, x
            elif side == 1 and own.x > x > at_x[3]:
                found[3], at_x[3] = i, x
    own.left_leader, own.leader, own.right_leader, own.follower = (
        found[0],
        found[1],
        found[2],
        found[3],
    )
    for i in found[:3]:
        if i >= 0:
            k = place_on(here, i, lanes, numbers, least_y, largest_y, width)
            s, other = coordinates_of(here, i, lanes[k]).s, now[i]
            heading = heading_on(here, lane_of(here, lanes[k]), s)
            other.heading = wrap_to_pi(vehicle_of(here, i).heading - heading)
            other.direction_y, other.direction_x = maths.sin_cos(other.heading)
