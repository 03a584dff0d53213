"""An agent of the straight road drives the ego of one of highway-env's environments.

The agent sees each scene straightened along the ego's way (`straightened`); what it answers is
carried out on the network. The profile's controllers and target speeds are the ego's; the other
vehicles are highway-env's, as in the environment, and so are the limits of all speeds.
"""

from collections.abc import Collection, Mapping
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from charms_bench.engine.commands import choose_target_speeds, command, command_rule, obey
from charms_bench.engine.stepping import Put
from charms_bench.errors import InputError
from charms_bench.foundation.arrays import Bools, Floats, Ints
from charms_bench.foundation.compiled import Unpacked, compiled, compiled_of_scenes
from charms_bench.plugins.agent import DriverModel
from charms_bench.roads.driving import (
    act,
    free_acceleration,
    gap_is_taken,
    interaction,
    is_reachable,
    mobil,
    neighbours,
    steering,
)
from charms_bench.roads.episodes import Episodes
from charms_bench.roads.locating import forget, locate
from charms_bench.roads.scenes import (
    CONSTANTS,
    CONTINUOUS,
    Here,
    Scenes,
    here_of,
    lane_of,
    vehicle_of,
)
from charms_bench.roads.stepping import collide, move
from charms_bench.roads.straightened import Ways, straighten
from charms_bench.world.actions import Actions, controls_of
from charms_bench.world.road import Straight
from charms_bench.world.scene import Scene, SceneSettings, Vehicles

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
        constants = settings.constants
        self._profile = np.array([(*constants[:-1], *constants.idm_mobil)], CONSTANTS)
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
        if self._rule.speeds.size and self._kind == BY_TARGETS and not self._own_rules:
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
        kind = BY_CONTROLS if hold_egos else self._kind
        args = (scene.unpacked, ways, rows, kind, self._kind == BY_CONTROLS, self._profile)
        advance(self.episodes.scenes, *args)
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
def show(scenes: Scenes, shown: Unpacked, ways: Ways, rows: Ints) -> None:
    """Straightens the scenes `rows`."""
    for b in rows:
        here = here_of(scenes, b)
        for i in range(here.places):
            forget(here, i)
        straighten(scenes, here, shown.scene, ways, b)


@compiled_of_scenes
def advance(
    scenes: Scenes,
    shown: Unpacked,
    ways: Ways,
    rows: Ints,
    kind: int,
    is_free: bool,
    profile: NDArray[np.void],
) -> None:
    """One simulation step of the scenes `rows`, after the egos' agents have answered.

    Args:
        scenes: The scenes.
        shown: The same, straightened: with the answers, and afterwards as they are then.
        ways: The ways of the egos.
        rows: (R,) the scenes to advance.
        kind: What the egos' accelerations and steering angles come from.
        is_free: Whether the egos follow no lane.
        profile: [1] the constants of the egos.
    """
    corners = np.empty((2, 4, 2))
    for b in rows:
        scene, here = shown.scene, here_of(scenes, b)
        own = Here(
            here.vehicles,
            here.places,
            here.coordinates,
            here.lanes,
            here.lane_count,
            here.connected,
            here.searches,
            profile[0],
        )
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
        if is_free:
            ego.target_lane = ego.lane
        act(scenes.road, here)
        if kind == BY_TARGETS:
            gain = 1 / own.constants.tau_acceleration
            ego.acceleration = gain * (ego.target_speed - ego.speed)
        else:
            ego.acceleration = scene.acceleration[b, 0]
        ego.steering = scene.steering[b, 0] if kind == BY_CONTROLS else steering(own, 0)
        for i in range(here.places):
            if vehicle_of(here, i).kind >= CONTINUOUS:
                move(here, i)
                locate(here, i)
        collide(here, corners)
        scene.timer_s[b, 0] += here.constants.dt
        straighten(scenes, here, scene, ways, b)


@compiled
def change_to_route(here: Here) -> None:
    """Has the ego change lanes towards its route as soon as it is safe.

    [`IDMVehicle.change_lane_policy`, the part for vehicles with a lane on their route]
    """
    ego = vehicle_of(here, 0)
    if ego.crashed:
        return
    row = lane_of(here, ego.lane)
    if ego.lane != ego.target_lane:
        if row.first == lane_of(here, ego.target_lane).first and gap_is_taken(here, 0):
            ego.target_lane = ego.lane
        return
    front, rear = neighbours(here, 0, ego.lane)
    free = free_acceleration(here, 0, ego.exponent)
    own = free - interaction(here, 0, front)
    for side in (row.left, row.right):
        if side >= 0 and is_reachable(here, 0, side):
            if mobil(here, 0, side, free, own, front, rear):
                ego.target_lane = side
