"""The reference engine: highway-env's own road and vehicles, one scene after another.

The profile's constants are set on subclasses of highway-env's classes; a driver model that names
its highway-env class is that class here, and any other is shown each scene as arrays.
"""

from collections.abc import Sequence
from importlib import import_module
from typing import Any

import numpy as np
from highway_env.road.lane import StraightLane
from highway_env.road.road import Road, RoadNetwork
from highway_env.vehicle.behavior import IDMVehicle
from highway_env.vehicle.controller import ControlledVehicle, MDPVehicle
from highway_env.vehicle.kinematics import Vehicle
from numpy.typing import NDArray

from charms_bench.engine import kernels
from charms_bench.plugins.agent import DriverModel
from charms_bench.world.actions import ACTIONS, Actions
from charms_bench.world.profile import Profile
from charms_bench.world.scene import Ints, Scene, SceneSettings, Vehicles


class HighwayEnvEngine:
    """highway-env itself behind the interface of `charms_bench.engine`."""

    def __init__(self, settings: SceneSettings, scenes: int) -> None:
        self.scene = Scene.empty(settings, scenes)
        self.roads: list[Road] = [None] * scenes
        """highway-env's roads, for whoever wants to look at them or draw them."""
        self._settings = settings
        self._models: tuple[DriverModel, ...] = ()
        self._model_of = np.full(self.scene.x.shape, -1)
        self._commanded = _commanded_class(settings.profile)
        self._mover = _with_constants(_ModelledVehicle, settings.profile)

    def reset(
        self,
        rows: Ints,
        seeds: NDArray[np.uint64],
        models: Sequence[DriverModel],
        ego_model: int,
        traffic_models: Ints,
    ) -> None:
        self._models = tuple(models)
        classes = [self._vehicle_class(model) for model in self._models]
        for row, seed, traffic in zip(rows, seeds, traffic_models, strict=True):
            rng = np.random.default_rng(int(seed))
            ego = int(rng.integers(0, self._settings.ego_slots))
            self.scene.ego[row] = ego
            self.scene.active[row] = True
            self._model_of[row] = np.insert(traffic, ego, ego_model)
            self.roads[row] = self._spawn(row, ego, rng, classes)
            self._copy_state(int(row))
        kernels.locate(self.scene, rows)

    def command(self, vehicles: Vehicles, actions: Actions) -> None:
        for row, place, action in zip(*vehicles, actions, strict=True):
            vehicle = self.roads[row].vehicles[place]
            vehicle.act(ACTIONS[action])
            self.scene.target_lane[row, place] = vehicle.target_lane_index[2]
            self.scene.target_speed[row, place] = vehicle.target_speed

    def advance(self) -> None:
        active = np.nonzero(self.scene.active)[0]
        dt = 1 / self._settings.simulation_hz
        for row in map(int, active):
            road = self.roads[row]
            for index in range(-1, len(self._models)):
                self._act(row, road, index)
            road.step(dt)
            self.scene.timer_s[row] += dt  # where a vehicle keeps no timer of its own
            self._copy_state(row)
        kernels.locate(self.scene, active)

    def _act(self, row: int, road: Road, index: int) -> None:
        """Lets the vehicles of one driver model act; -1 are those that `command` drives."""
        places = np.nonzero(self._model_of[row] == index)[0]
        if index >= 0 and places.size and not self._models[index].highway_env_class:
            vehicles = (np.full(places.size, row), places)
            acceleration, target_lane = self._models[index].drive(self.scene, vehicles)
            for place, *answer in zip(places, acceleration, target_lane, strict=True):
                road.vehicles[place].obey(*answer)
                road.vehicles[place].timer = float(self.scene.timer_s[row, place])
        for place in places:
            vehicle = road.vehicles[place]
            vehicle.act()
            self.scene.target_lane[row, place] = vehicle.target_lane_index[2]

    def _vehicle_class(self, model: DriverModel) -> Any:
        if not model.highway_env_class:
            return self._mover
        module, name = model.highway_env_class.split(":")
        return _with_constants(getattr(import_module(module), name), self._settings.profile)

    def _spawn(self, row: int, ego: int, rng: np.random.Generator, classes: list[Any]) -> Road:
        """[`HighwayEnv._create_road` and `_create_vehicles`, with the ego at its place]."""
        settings, profile = self._settings, self._settings.profile
        network = RoadNetwork()
        for lane in range(settings.lanes):
            y = lane * profile.lane_width_m
            network.add_lane(
                "0",
                "1",
                StraightLane(
                    np.array([0.0, y]),
                    np.array([profile.road_length_m, y]),
                    width=profile.lane_width_m,
                    speed_limit=profile.speed_limit_mps,
                ),
            )
        road = Road(network=network, np_random=rng)
        spawner = _with_constants(_SpawningVehicle, profile)
        spacing = 1 / settings.density
        for place in range(settings.vehicles):
            is_ego = place == ego
            spawned = spawner.create_random(
                road,
                speed=profile.ego_speed_mps if is_ego else None,
                spacing=(profile.ego_spacing or spacing) if is_ego else spacing,
            )
            model = self._model_of[row, place]
            vehicle_class = classes[model] if model >= 0 else self._commanded
            vehicle = vehicle_class(road, spawned.position, spawned.heading, spawned.speed)
            road.vehicles.append(vehicle)
            if not is_ego:
                self._draw_temperament(row, place, vehicle, rng)
        self._draw_temperament(row, ego, road.vehicles[ego], rng)
        for place, vehicle in enumerate(road.vehicles):
            period = profile.idm_mobil.lane_change_period_s
            phase = (np.sum(vehicle.position) * np.pi) % period  # as IDMVehicle.__init__
            self.scene.timer_s[row, place] = phase
            if isinstance(vehicle, _ModelledVehicle):
                vehicle.timer = float(phase)
        return road

    def _draw_temperament(
        self, row: int, place: int, vehicle: ControlledVehicle, rng: np.random.Generator
    ) -> None:
        if isinstance(vehicle, IDMVehicle):
            vehicle.randomize_behavior()
            low, high = vehicle.DELTA_RANGE
            self.scene.temperament[row, place] = (vehicle.DELTA - low) / ((high - low) or 1.0)
        else:
            self.scene.temperament[row, place] = rng.random()

    def _copy_state(self, row: int) -> None:
        """Copies what highway-env's vehicles hold into the arrays."""
        scene = self.scene
        for place, vehicle in enumerate(self.roads[row].vehicles):
            scene.x[row, place], scene.y[row, place] = vehicle.position
            scene.heading[row, place] = vehicle.heading
            scene.speed[row, place] = vehicle.speed
            scene.acceleration[row, place] = vehicle.action["acceleration"]
            scene.steering[row, place] = vehicle.action["steering"]
            scene.target_speed[row, place] = vehicle.target_speed
            scene.target_lane[row, place] = vehicle.target_lane_index[2]
            scene.crashed[row, place] = vehicle.crashed
            scene.impact[row, place] = vehicle.impact is not None
            if vehicle.impact is not None:
                scene.impact_x[row, place], scene.impact_y[row, place] = vehicle.impact
            if hasattr(vehicle, "timer"):
                scene.timer_s[row, place] = vehicle.timer


class _SpawningVehicle(Vehicle):  # type: ignore[misc]  # highway-env is untyped
    """Only draws an initial state."""


class _RelativeMetaVehicle(ControlledVehicle):  # type: ignore[misc]  # untyped too
    """Meta-actions whose lane commands count from the current lane, within a speed range."""

    target_lane_index: tuple[str, str, int]
    target_speed: float
    LOWEST_TARGET = HIGHEST_TARGET = 0.0
    FROM_CURRENT_LANE = True

    def act(self, action: str | None = None) -> None:
        if action in ("LANE_LEFT", "LANE_RIGHT") and self.FROM_CURRENT_LANE:
            start = self.target_lane_index
            self.target_lane_index = self.lane_index
            super().act(action)
            if self.target_lane_index == self.lane_index and not self._is_edge(action):
                self.target_lane_index = start  # out of reach: the command has no effect
            return
        super().act(action)
        if action in ("FASTER", "SLOWER"):
            bounds = (self.LOWEST_TARGET, self.HIGHEST_TARGET)
            self.target_speed = float(np.clip(self.target_speed, *bounds))

    def _is_edge(self, action: str) -> bool:
        lanes = len(self.road.network.all_side_lanes(self.lane_index))
        return bool(self.lane_index[2] == (0 if action == "LANE_LEFT" else lanes - 1))


class _ModelledVehicle(ControlledVehicle):  # type: ignore[misc]  # untyped too
    """Carries out what a driver model answered."""

    target_lane_index: tuple[str, str, int]

    def __init__(self, *args: Any, **kwargs: Any) -> None:
        super().__init__(*args, **kwargs)
        self.timer = 0.0
        self._acceleration = 0.0

    def obey(self, acceleration: float, target_lane: int) -> None:
        if not self.crashed:
            self.target_lane_index = (*self.target_lane_index[:2], int(target_lane))
            self._acceleration = float(acceleration)

    def act(self, action: str | None = None) -> None:
        if not self.crashed:
            steering = self.steering_control(self.target_lane_index)
            Vehicle.act(self, {"steering": steering, "acceleration": self._acceleration})

    def step(self, dt: float) -> None:
        self.timer += dt
        super().step(dt)


def _commanded_class(profile: Profile) -> Any:
    if not profile.target_speeds_mps:
        return _with_constants(_RelativeMetaVehicle, profile)
    stock = _with_constants(MDPVehicle, profile)
    stock.DEFAULT_TARGET_SPEEDS = np.array(profile.target_speeds_mps)
    return stock


def _with_constants(vehicle_class: Any, profile: Profile) -> Any:
    """A subclass of a highway-env vehicle class with the profile's constants."""
    idm = profile.idm_mobil
    values = {
        "LENGTH": profile.vehicle_length_m,
        "WIDTH": profile.vehicle_width_m,
        "MIN_SPEED": profile.speed_min_mps,
        "MAX_SPEED": profile.speed_max_mps,
        "KP_A": 1 / profile.tau_acceleration_s,
        "KP_HEADING": 1 / profile.tau_heading_s,
        "KP_LATERAL": 1 / profile.tau_lateral_s,
        "MAX_STEERING_ANGLE": profile.steering_limit_rad,
        "DELTA_SPEED": profile.target_speed_step_mps,
        "LOWEST_TARGET": profile.target_speed_min_mps,
        "HIGHEST_TARGET": profile.target_speed_max_mps,
        "FROM_CURRENT_LANE": profile.lane_command_from == "current_lane",
        "ACC_MAX": idm.acceleration_limit_mps2,
        "COMFORT_ACC_MAX": idm.acceleration_mps2,
        "COMFORT_ACC_MIN": -idm.deceleration_mps2,
        "DISTANCE_WANTED": idm.jam_distance_m,
        "TIME_WANTED": idm.time_headway_s,
        "DELTA_RANGE": [idm.exponent_low, idm.exponent_high],
        "POLITENESS": idm.politeness,
        "LANE_CHANGE_MIN_ACC_GAIN": idm.lane_change_gain_mps2,
        "LANE_CHANGE_MAX_BRAKING_IMPOSED": idm.imposed_braking_mps2,
        "LANE_CHANGE_DELAY": idm.lane_change_period_s,
    }
    held = {name: value for name, value in values.items() if hasattr(vehicle_class, name)}
    return type(vehicle_class.__name__, (vehicle_class,), held)
