"""An agent of the straight road drives the ego of one of highway-env's environments.

The agent sees each scene straightened along the ego's way (`straightened`); what it answers is
carried out on the network. All vehicles have highway-env's controllers and limits, and the others
drive as in the environment. The profile decides between which target speeds the ego chooses, and
the constants of its driver model.
"""

from collections.abc import Collection, Mapping
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from charms_bench.engine.meta_actions import choose_target_speeds, command, command_rule, obey
from charms_bench.engine.stepping import Put
from charms_bench.errors import InputError
from charms_bench.foundation.arrays import Bools, Floats, Ints
from charms_bench.foundation.compiled import compiled, compiled_of_scenes
from charms_bench.plugins.agent import DriverModel
from charms_bench.roads.driving import (
    act,
    is_reachable,
    neighbours,
)
from charms_bench.roads.dynamics import move
from charms_bench.roads.episodes import Episodes
from charms_bench.roads.locating import coordinates_of, forget, locate
from charms_bench.roads.scenes import (
    CONTINUOUS,
    Here,
    Scenes,
    here_of,
    lane_of,
    vehicle_of,
)
from charms_bench.roads.stepping import collide
from charms_bench.roads.straightened import Ways, straighten
from charms_bench.world.actions import Actions, controls_of
from charms_bench.world.gaps import gap_to
from charms_bench.world.scene import Scene, SceneSettings, Vehicles
from charms_bench.world.thresholds import DRAC_LIMIT_MPS2

HEADWAY_S = 0.3
"""The least time headway after a lane change towards the route."""
BY_TARGETS, BY_MODEL, BY_CONTROLS = range(3)
"""What drives the egos: target speeds and lanes, a driver model, or continuous actions."""


class RoadEngine:
    """B scenes of a road of highway-env as an `engine.Engine`; the ego is the first vehicle."""

    def __init__(
        self,
        settings: SceneSettings,
        scenes: int,
        models: Mapping[int, DriverModel],
        continuous: Collection[int] = (),
        memory: int = 0,
        prescribed: Collection[int] = (),
        own_steps: Mapping[int, tuple[float, ...]] = MappingProxyType({}),
    ) -> None:
        assert settings.network is not None
        rates = {"simulation_frequency": settings.simulation_hz}
        self.episodes = Episodes(settings.network, scenes, rates)
        """The scenes on the network."""
        parameters = max((len(model.parameters) for model in models.values()), default=0)
        self.scene = Scene.empty(settings, scenes, parameters, memory)
        self.drivers = np.zeros(self.scene.x.shape, dtype=np.int64)
        self.goals: Bools = np.zeros(scenes, dtype=np.bool_)
        self._ways = Ways.empty(scenes)
        self._models, self._continuous = models, continuous
        self._rule = command_rule(settings.profile)
        self._own_rules = {k: command_rule(settings.profile, own) for k, own in own_steps.items()}
        self._shown = self.scene.read_only()
        self._roads: dict[tuple[int, float], Scene] = {}

    def reset(
        self, rows: Ints, seeds: NDArray[np.uint64], agents: Ints, draws: Floats | None = None
    ) -> None:
        if draws is not None:
            raise InputError(f"{self.episodes.name}: vehicles are placed by seeds only")
        episodes, scene = self.episodes, self.scene
        episodes.seed(rows, seeds)
        episodes.start(rows)
        episodes.task.navigate(episodes.scenes, rows)
        scene.ego[rows], scene.active[rows], self.drivers[rows] = 0, True, agents
        self.goals[rows] = False
        self._ways.lanes[rows] = -1
        vehicles = episodes.scenes.vehicles
        scene.target_speed[rows, 0] = vehicles["speed"][rows, 0]
        scene.timer_s[rows, 0] = vehicles["timer_s"][rows, 0]
        scene.temperament[rows] = 0.5
        if self._kind == BY_CONTROLS:
            vehicles["kind"][rows, 0], vehicles["target_speed"][rows, 0] = CONTINUOUS, 0.0
            scene.target_speed[rows, 0] = 0.0
        elif self._rule.speeds.size and self._kind == BY_TARGETS and not self._own_rules:
            free = np.zeros(scene.x.shape, dtype=np.bool_)
            choose_target_speeds(scene, rows, free, self._rule.speeds)
        show(episodes.scenes, scene.unpacked, self._ways, rows)

    def restore(self, rows: Ints, seeds: NDArray[np.uint64]) -> None:
        raise InputError(f"{self.episodes.name}: scenes of this road cannot be restored")

    def command(self, vehicles: Vehicles, actions: Actions) -> None:
        if actions.ndim == 2:
            control = controls_of(actions)
            self.scene.acceleration[vehicles], self.scene.steering[vehicles] = control
            return
        rule = self._own_rules.get(self._driver, self._rule)
        command(self.scene, vehicles[0], vehicles[1], actions, rule)

    def advance(self, hold_egos: bool = False, put: Put | None = None) -> None:
        scene, ways = self.scene, self._ways
        rows = np.nonzero(scene.active)[0]
        if self._kind == BY_MODEL and not hold_egos:
            model = self._models[self._driver]
            kinds = np.stack((ways.open_lanes[rows], ways.speed_limits[rows]), axis=1)
            for lanes, limit in np.unique(kinds, axis=0).tolist():
                some = rows[(kinds == (lanes, limit)).all(axis=1)]
                egos = some, scene.ego[some]
                answers = model.drive(self._on_road(int(lanes), limit), egos)
                obey(scene, *egos, *answers)
        advance(self.episodes.scenes, scene.unpacked, ways, rows, self._kind)
        self.goals[rows] = self.episodes.task.has_reached_goal(self.episodes.scenes)[rows]

    def _on_road(self, lanes: int, speed_limit: float) -> Scene:
        """The scenes for driver models whose egos' road has so many lanes and that limit."""
        if (lanes, speed_limit) not in self._roads:
            road = self.scene.road._replace(lanes=lanes, speed_limit=speed_limit)
            self._roads[lanes, speed_limit] = self._shown._replace(road=road)
        return self._roads[lanes, speed_limit]

    @property
    def _driver(self) -> int:
        """The index of the egos' agent."""
        return int(self.drivers[0, 0])

    @property
    def _kind(self) -> int:
        if self._driver in self._models:
            return BY_MODEL
        return BY_CONTROLS if self._driver in self._continuous else BY_TARGETS


@compiled_of_scenes
def show(scenes: Scenes, shown: Any, ways: Ways, rows: Ints) -> None:
    """Straightens the scenes `rows`."""
    for b in rows:
        here = here_of(scenes, b)
        for i in range(here.places):
            forget(here, i)
        straighten(scenes, here, shown.scene, ways, b)


@compiled_of_scenes
def advance(
    scenes: Scenes,
    shown: Any,
    ways: Ways,
    rows: Ints,
    kind: int,
) -> None:
    """One simulation step of the scenes `rows`, after the egos' agents have answered.

    Args:
        scenes: The scenes.
        shown: The same, straightened: with the answers, and afterwards as they are then.
        ways: The ways of the egos.
        rows: (R,) the scenes to advance.
        kind: What drives the egos.
    """
    corners = np.empty((2, 4, 2))
    for b in rows:
        scene, here = shown.scene, here_of(scenes, b)
        for i in range(here.places):
            forget(here, i)
        ego = vehicle_of(here, 0)
        ego.target_speed = scene.target_speed[b, 0]
        if ego.route_step < ego.route_end and ego.route_numbers[ego.route_step] >= 0:
            change_to_route(here)
        elif scene.target_lane[b, 0] != ways.targets[b]:
            lane = lane_of(here, ego.lane).first + scene.target_lane[b, 0]
            if scene.target_lane[b, 0] < lane_of(here, ego.lane).lanes and is_reachable(
                here, 0, lane
            ):
                ego.target_lane = lane
        act(scenes.road, here)
        if kind != BY_TARGETS:
            ego.acceleration = scene.acceleration[b, 0]
        if kind == BY_CONTROLS:
            ego.steering, ego.target_lane = scene.steering[b, 0], ego.lane
        for i in range(here.places):
            if vehicle_of(here, i).kind >= CONTINUOUS:
                move(vehicle_of(here, i), here.constants.dt)
                locate(here, i)
        collide(here, corners)
        scene.timer_s[b, 0] += here.constants.dt
        straighten(scenes, here, scene, ways, b)


@compiled
def change_to_route(here: Here) -> None:
    """Has the ego change to the lane of its route, lane by lane, where `is_safe` says so."""
    ego = vehicle_of(here, 0)
    row = lane_of(here, ego.lane)
    if ego.crashed:
        return
    if ego.lane != ego.target_lane:
        if row.first == lane_of(here, ego.target_lane).first and not is_safe(here, ego.target_lane):
            ego.target_lane = ego.lane
        return
    wanted = row.first + ego.route_numbers[ego.route_step]
    side = row.right if wanted > ego.lane else row.left if wanted < ego.lane else -1
    if side >= 0 and is_reachable(here, 0, side) and is_safe(here, side):
        ego.target_lane = side


@compiled
def is_safe(here: Here, lane: int) -> bool:
    """Whether on a lane, neither the ego nor its follower has to brake hard to avoid a collision.

    The deceleration that just avoids one is at most `DRAC_LIMIT_MPS2`, and the time headway at
    least `HEADWAY_S`.
    """
    front, rear = neighbours(here, 0, lane)
    for behind, ahead in ((0, front), (rear, 0)):
        if behind < 0 or ahead < 0:
            continue
        own, other = vehicle_of(here, behind), vehicle_of(here, ahead)
        distance = coordinates_of(here, ahead, lane).s - coordinates_of(here, behind, lane).s
        gap, closing = gap_to(distance, own.length, other.length), own.speed - other.speed
        if gap < HEADWAY_S * own.speed:
            return False
        if closing > 0 and closing**2 > 2 * DRAC_LIMIT_MPS2 * gap:
            return False
    return True
