"""What each vehicle on a network sees along its own way; see `engine.views`."""

from typing import Any

import numpy as np

from charms_bench.engine.collision_kinds import NO_COLLISION
from charms_bench.engine.views import note_view
from charms_bench.foundation.arrays import Bools, Ints
from charms_bench.foundation.compiled import compiled_of_scenes
from charms_bench.roads.fault import Fault
from charms_bench.roads.locating import forget
from charms_bench.roads.scenes import OBSTACLE, Scenes, here_of, vehicle_of
from charms_bench.roads.straightened import BEHIND, Ways, find_way, see, straighten
from charms_bench.world.scene import Scene, SceneSettings, Vehicles


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
        self._own = Scene.empty(settings, count)._replace(
            present=state.present, entry=state.entry, active=state.active
        )
        self._seen = Scene.empty(settings, count)
        self._entry = np.where(state.present, state.entry, -1)
        self._roads = np.full(state.x.shape, -1)
        self.turned: Bools = np.zeros(state.x.shape, dtype=np.bool_)
        self.collision: Ints = np.zeros(state.x.shape, dtype=np.int8)
        self.at_fault: Bools = np.zeros(state.x.shape, dtype=np.bool_)
        self.follow()

    def follow(self) -> None:
        state = self._state
        is_new = np.where(state.present, state.entry, -1) != self._entry
        if is_new.any():
            self._entry[is_new] = np.where(state.present, state.entry, -1)[is_new]
            self._ways.lanes[is_new] = -1
            self.collision[is_new], self.at_fault[is_new] = NO_COLLISION, False
        follow_all(self._scenes, self._ways, np.nonzero(state.active)[0])

    def judge(self) -> None:
        for b, i in zip(*np.nonzero(self._state.crashed & (self.collision == 0)), strict=True):
            if self._state.present[b, i]:
                at_fault, how = self._fault.judged(self._scenes, b, i)
                self.at_fault[b, i], self.collision[b, i] = at_fault == 1.0, how

    @property
    def own(self) -> Scene:
        self.follow()
        rows = np.arange(len(self._own.x))
        see_themselves(self._scenes, self._own.unpacked, self._ways, rows)
        roads = self._scenes.road.lanes["first"][self._scenes.vehicles["lane"]]
        self.turned = roads != self._roads
        self._roads = roads
        return self._own

    def see(self, vehicles: Vehicles, seen: Any) -> None:
        rows, places = vehicles
        see_scenes(self._scenes, self._seen.unpacked, self._ways, rows, places, seen)


@compiled_of_scenes
def follow_all(scenes: Scenes, ways: Ways, rows: Ints) -> None:
    """Finds the ways of all vehicles of the scenes `rows`."""
    for b in rows:
        here = here_of(scenes, b)
        for i in range(here.places):
            if vehicle_of(here, i).kind > OBSTACLE:
                find_way(scenes, b, i, ways)


@compiled_of_scenes
def see_themselves(scenes: Scenes, own: Any, ways: Ways, rows: Ints) -> None:
    """Fills in each vehicle of the scenes `rows` as it sees itself."""
    scene = own.scene
    for b in rows:
        here = here_of(scenes, b)
        for i in range(here.places):
            forget(here, i)
            if vehicle_of(here, i).kind > OBSTACLE:
                find_way(scenes, b, i, ways)
                see(here, i, i, ways, b, BEHIND, scene, b)


@compiled_of_scenes
def see_scenes(scenes: Scenes, view: Any, ways: Ways, rows: Ints, places: Ints, seen: Any) -> None:
    """Fills in where the vehicles are in the views of M vehicles.

    The views of a scene are made in one place, where each finds the order of the one before.
    """
    scene, last = view.scene, -1
    for m in range(rows.size):
        b = rows[m]
        here = here_of(scenes, b)
        for i in range(here.places if b != last else 0):
            forget(here, i)
        last = b
        straighten(scenes, here, ways, b, places[m], scene, b)
        note_view(scene, b, seen[m])
