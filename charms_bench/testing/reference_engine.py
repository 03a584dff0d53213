"""The reference engine: highway-env's own road and vehicles, one scene after another.

The profile's constants are set on subclasses of highway-env's classes. Where a driver model names
its highway-env class, this engine uses that class; any other model gets each scene as arrays.
"""

from collections.abc import Mapping, Sequence
from importlib import import_module
from typing import Any

import numpy as np
from highway_env.envs.common.action import ContinuousAction
from highway_env.road.lane import StraightLane
from highway_env.road.road import Road, RoadNetwork
from highway_env.vehicle.behavior import IDMVehicle
from highway_env.vehicle.controller import ControlledVehicle, MDPVehicle
from highway_env.vehicle.kinematics import Vehicle
from numpy.typing import NDArray

from charms_bench.engine import Cast, Engine, MakeEngine
from charms_bench.engine.batched import BatchedEngine
from charms_bench.engine.draws import ReplayedDraws
from charms_bench.engine.neighbours import locate
from charms_bench.engine.stepping import BeforeMove, Put
from charms_bench.engine.type_draws import set_types
from charms_bench.foundation.generator import from_numpy, seeded, to_numpy
from charms_bench.plugins.agent import DriverModel
from charms_bench.world.actions import DEFAULT_ACTIONS, Actions, MetaAction, follows_profile
from charms_bench.world.gaps import following_distance, overhang
from charms_bench.world.profile import Profile
from charms_bench.world.road import Straight
from charms_bench.world.scene import Floats, Ints, Scene, SceneSettings, Vehicles

_NOBODY = -1
"""Stands for the agent of a vehicle that keeps its last control."""
RandomSource = np.random.Generator | ReplayedDraws


class HighwayEnvEngine(Engine):
    """highway-env itself, behind the interface of `charms_bench.engine`."""

    def __init__(self, settings: SceneSettings, scenes: int, cast: Cast) -> None:
        super().__init__(settings, scenes, cast)
        self.state = self.scene = Scene.empty(settings, scenes, cast.parameters, cast.memory)
        self.roads: list[Road] = [None] * scenes
        """highway-env's roads, for inspection or drawing."""
        self._vehicles: list[list[Any]] = [[] for _ in range(scenes)]
        """highway-env's vehicles of each scene by place, None at an empty one."""
        self._classes = {
            agent: _reference_class(model, settings.profile) for agent, model in cast.models.items()
        }
        self._own_actions = cast.own_actions
        for agent, actions in cast.own_actions.items():
            self._classes[agent] = _with_actions(settings.profile, actions)
        speeds = settings.profile.target_speeds_mps
        if speeds:
            self._commanded = _with_constants(MDPVehicle, settings.profile)
            self._commanded.DEFAULT_TARGET_SPEEDS = np.array(speeds)
        else:
            self._commanded = _with_actions(settings.profile, DEFAULT_ACTIONS)
        self._plain = _with_constants(Vehicle, settings.profile)
        """Spawns vehicles, and is the class of those with continuous actions."""
        self._actions = ContinuousAction(None)
        self._network = highway_env_network(settings.road)

    def reset(
        self, rows: Ints, seeds: NDArray[np.uint64], agents: Ints, draws: Floats | None = None
    ) -> None:
        self.scene.generator[rows] = seeded(seeds)
        rngs: Sequence[RandomSource] = (
            [to_numpy(state) for state in self.scene.generator[rows]]
            if draws is None
            else [ReplayedDraws(each, self._settings) for each in draws]
        )
        self.scene.ego[rows] = [int(rng.integers(0, self._settings.ego_slots)) for rng in rngs]
        desired = set_types(self.scene, self._settings, rows, seeds)
        for row, rng, (own, *others), speeds in zip(rows, rngs, agents, desired, strict=True):
            ego = int(self.scene.ego[row])
            self.scene.active[row] = True
            self.drivers[row] = np.insert(others, ego, own)
            self.roads[row] = self._spawn(row, ego, rng, speeds)
            if isinstance(rng, np.random.Generator):
                self.scene.generator[row] = from_numpy(rng)
            self._vehicles[row] = [*self.roads[row].vehicles]
            self._copy_state(int(row))
        locate(self.scene, rows)

    def restore(
        self, rows: Ints, seeds: NDArray[np.uint64], saved: NDArray[np.uint8] | None = None
    ) -> None:
        locate(self.scene, rows)
        is_continuous = np.isin(self.drivers[rows], self._continuous)
        self.scene.target_speed[rows] *= ~is_continuous
        target_lane, lane = self.scene.target_lane[rows], self.scene.lane[rows]
        self.scene.target_lane[rows] = np.where(is_continuous, lane, target_lane)
        locate(self.scene, rows)
        for row in map(int, rows):
            self.roads[row] = self._road(row)

    def command(self, vehicles: Vehicles, actions: Actions) -> None:
        for row, place, action in zip(*vehicles, actions, strict=True):
            vehicle = self._vehicles[row][place]
            if actions.ndim == 2:
                vehicle.act(self._actions.get_action(action))
                for name, value in vehicle.action.items():
                    getattr(self.scene, name)[row, place] = value
                continue
            own = self._own_actions.get(int(self.drivers[row, place]), DEFAULT_ACTIONS)
            if isinstance(vehicle, _MetaVehicle):
                vehicle.carry_out(own[action])
            else:
                vehicle.act(own[action].name)
            self.scene.target_lane[row, place] = vehicle.target_lane_index[2]
            self.scene.target_speed[row, place] = vehicle.target_speed
            if hasattr(vehicle, "repeats"):
                self.scene.repeats[row, place] = vehicle.repeats

    def advance(self, hold_egos: bool = False, before_move: BeforeMove | None = None) -> None:
        active = np.nonzero(self.scene.active)[0]
        dt = 1 / self._settings.simulation_hz
        for row in map(int, active):
            drivers = np.where(self.scene.present[row], self.drivers[row], _NOBODY)
            drivers[np.isin(drivers, [*self._continuous, *self._prescribed])] = _NOBODY
            if hold_egos:
                drivers[self.scene.ego[row]] = _NOBODY
            in_order = np.argsort(self.scene.entry[row])
            drivers = drivers[in_order]
            self._act(row, in_order[~np.isin(drivers, [*self._models, _NOBODY])])
            for agent, model in self._models.items():
                places = in_order[drivers == agent]
                if places.size and not model.highway_env_class:
                    self._ask(model, row, places)
                self._act(row, places, tuple(model.parameters))
        put = None if before_move is None else before_move()
        for row in map(int, active):
            self._prescribe(row)
            if put is not None:
                self._put(row, put)
            self.roads[row].step(dt)
            self.scene.timer_s[row] += dt  # for vehicles that keep no timer of their own
            self._copy_state(row)
        locate(self.scene, active)

    def _ask(self, model: DriverModel, row: int, places: Ints) -> None:
        """Asks a driver model, and passes its answers to its vehicles."""
        answers = model.drive(self._shown, (np.full(places.size, row), places))
        for place, *answer in zip(places, *answers, strict=True):
            vehicle = self._vehicles[row][place]
            vehicle.obey(*answer)
            vehicle.timer = float(self.scene.timer_s[row, place])

    def _act(self, row: int, places: Ints, parameters: tuple[str, ...] = ()) -> None:
        """Has vehicles act whose drivers have parameters with these names."""
        for place in places:
            vehicle = self._vehicles[row][place]
            own = dict(zip(parameters, self.scene.parameters[row, place].tolist(), strict=False))
            vars(vehicle).update(_idm_attributes(own))
            vehicle.act()
            self.scene.target_lane[row, place] = vehicle.target_lane_index[2]

    def _prescribe(self, row: int) -> None:
        """Gives the prescribed vehicles of a scene their control."""
        scene, is_prescribed = self.scene, np.isin(self.drivers[row], self._prescribed)
        for place in np.nonzero(is_prescribed & ~scene.crashed[row])[0]:
            vehicle = self._vehicles[row][place]
            control = {"steering": scene.steering, "acceleration": scene.acceleration}
            vehicle.action = {name: values[row, place] for name, values in control.items()}
            lane = int(scene.target_lane[row, place])
            vehicle.target_lane_index = (*vehicle.target_lane_index[:2], lane)

    def _put(self, row: int, put: Put) -> None:
        """Tells the vehicles of a scene that are put somewhere where their next step ends."""
        for place in np.nonzero(put.moves[row])[0]:
            vehicle = self._vehicles[row][place]
            vehicle.put = {name: getattr(put, name)[row, place] for name in Put._fields}

    def _road(self, row: int) -> Road:
        """The road of a scene with its vehicles, as the arrays describe them."""
        scene = self.scene
        # On a road without junctions, highway-env draws no random number after the spawn.
        road = Road(network=self._network, np_random=to_numpy(scene.generator[row]))
        self._vehicles[row] = [self._vehicle(road, row, k) for k in range(scene.x.shape[1])]
        for place in np.argsort(scene.entry[row]):
            if scene.present[row, place]:
                road.vehicles.append(self._vehicles[row][place])
        return road

    def _vehicle(self, road: Road, row: int, place: int) -> Any:
        """A vehicle of a scene."""
        scene, at = self.scene, (row, place)
        vehicle_class = self._class_of(int(self.drivers[at]))
        position = np.array([scene.x[at], scene.y[at]])
        vehicle = vehicle_class(road, position, float(scene.heading[at]), float(scene.speed[at]))
        _set_size(vehicle, scene.length[at], scene.width[at])
        vehicle.target_speed, vehicle.crashed = (
            float(scene.target_speed[at]),
            bool(scene.crashed[at]),
        )
        vehicle.target_lane_index = (*vehicle.lane_index[:2], int(scene.target_lane[at]))
        names = ("steering", "acceleration")
        vehicle.action = {name: float(getattr(scene, name)[at]) for name in names}
        if scene.impact[at]:
            vehicle.impact = np.array([scene.impact_x[at], scene.impact_y[at]])
        if hasattr(vehicle, "timer"):
            vehicle.timer = float(scene.timer_s[at])
        if hasattr(vehicle, "repeats"):
            vehicle.repeats = int(scene.repeats[at])
        model = self._models.get(int(self.drivers[at]))
        follows = model is not None and model.follows_recording
        vehicle.check_collisions = self._settings.recording is None or not follows
        self._set_temperament(vehicle, scene.temperament[at])
        return vehicle

    def _spawn(self, row: int, ego: int, rng: RandomSource, desired: Floats) -> Road:
        """[`HighwayEnv._create_vehicles`, with the ego at its place]

        `desired` (N,) are the vehicles' desired speeds, not a number for those at which they start.
        """
        settings, profile = self._settings, self._settings.profile
        road = Road(network=self._network, np_random=rng)
        spacing = 1 / settings.density
        for place in range(settings.vehicles):
            is_ego = place == ego
            spawned = self._plain.create_random(
                road,
                speed=profile.ego_speed_mps if is_ego else None,
                spacing=(profile.ego_spacing or spacing) if is_ego else spacing,
            )
            if place > 0:  # as far apart as vehicles of the profile's length, bumper to bumper
                last = int(np.argmax([vehicle.position[0] for vehicle in road.vehicles]))
                lengths = self.scene.length[row, [place, last]]
                spawned.position[0] += overhang(lengths, profile.vehicle_length_m).sum()
            vehicle_class = self._class_of(int(self.drivers[row, place]))
            state = spawned.position, spawned.heading, spawned.speed
            wants_own = issubclass(vehicle_class, ControlledVehicle) and desired[place] > 0
            own = {"target_speed": float(desired[place])} if wants_own else {}
            vehicle = vehicle_class(road, *state, **own)
            _set_size(vehicle, self.scene.length[row, place], self.scene.width[row, place])
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

    def _class_of(self, agent: int) -> Any:
        """highway-env's class of the vehicles that an agent drives."""
        if agent in self._continuous:
            return self._plain
        return self._classes.get(agent, self._commanded)

    def _draw_temperament(
        self, row: int, place: int, vehicle: ControlledVehicle, rng: RandomSource
    ) -> None:
        """[`IDMVehicle.randomize_behavior`]"""
        temperament = self.scene.temperament[row, place] = rng.random()
        self._set_temperament(vehicle, temperament)

    def _set_temperament(self, vehicle: Any, temperament: float) -> None:
        if isinstance(vehicle, IDMVehicle):
            low, high = vehicle.DELTA_RANGE
            vehicle.DELTA = low + (high - low) * temperament

    def _copy_state(self, row: int) -> None:
        """Copies the state of highway-env's vehicles into the arrays."""
        scene = self.scene
        for place, vehicle in enumerate(self._vehicles[row]):
            if not scene.present[row, place]:
                continue
            scene.x[row, place], scene.y[row, place] = vehicle.position
            for name in ("heading", "speed", "crashed"):
                getattr(scene, name)[row, place] = getattr(vehicle, name)
            for name in ("acceleration", "steering"):
                getattr(scene, name)[row, place] = vehicle.action[name]
            has_targets = isinstance(vehicle, ControlledVehicle)
            scene.target_speed[row, place] = vehicle.target_speed if has_targets else 0.0
            target_lane = vehicle.target_lane_index if has_targets else vehicle.lane_index
            scene.target_lane[row, place] = target_lane[2]
            scene.impact[row, place] = vehicle.impact is not None
            if vehicle.impact is not None:
                scene.impact_x[row, place], scene.impact_y[row, place] = vehicle.impact
            if hasattr(vehicle, "timer"):
                scene.timer_s[row, place] = vehicle.timer


class _MetaVehicle(ControlledVehicle):  # type: ignore[misc]  # highway-env is untyped
    """Obeys meta-actions; lane commands count from the current lane, speeds have a range."""

    target_lane_index: tuple[str, str, int]
    target_speed: float
    speed: float
    LOWEST_TARGET = HIGHEST_TARGET = 0.0
    FROM_CURRENT_LANE = True
    PROFILE: Profile
    MOST = 1
    """Steps up to which repetitions are counted."""
    SPEEDS: NDArray[np.float64]
    """The profile's target speeds; empty if no action chooses between them."""

    def __init__(self, *args: Any, **kwargs: Any) -> None:
        super().__init__(*args, **kwargs)
        self.repeats = 0
        if self.SPEEDS.size:
            self.target_speed = self._nearest(self.target_speed, 0)

    def act(self, action: str | None = None) -> None:
        start = self.target_lane_index
        if action in ("LANE_LEFT", "LANE_RIGHT") and self.FROM_CURRENT_LANE:
            self.target_lane_index = self.lane_index
            super().act(action)
            lanes = len(self.road.network.all_side_lanes(self.lane_index))
            is_edge = self.lane_index[2] == (0 if action == "LANE_LEFT" else lanes - 1)
            if self.target_lane_index == self.lane_index and not is_edge:
                self.target_lane_index = start  # out of reach, so the command has no effect
        else:
            super().act(action)

    def carry_out(self, action: MetaAction) -> None:
        """Changes the targets as a meta-action says."""
        steps, direction = action.speed_steps_mps, action.profile_step
        if direction and not self.SPEEDS.size:
            steps = tuple(direction * step for step in _steps_of(self.PROFILE))
        sign = int(np.sign(steps[0])) if steps else direction
        again = abs(self.repeats) if sign * self.repeats > 0 else 0
        again = min(again + 1, self.MOST)
        if self.MOST > 1:
            self.repeats = sign * again
        wanted = self.target_speed
        if direction and self.SPEEDS.size:
            wanted = self._nearest(self.speed, direction)
        elif action.changes_speed:
            if steps:
                wanted += steps[min(again, len(steps)) - 1]
            else:
                wanted = self.speed + (action.speed_from_present_mps or 0.0)
            wanted = float(np.clip(wanted, self.LOWEST_TARGET, self.HIGHEST_TARGET))
        self.target_speed = wanted
        self.act(("LANE_LEFT", "IDLE", "LANE_RIGHT")[action.lanes + 1])

    def _nearest(self, speed: float, change: int) -> float:
        """[`MDPVehicle.speed_to_index` and `index_to_speed`], `change` indices further."""
        first, last = self.SPEEDS[0], self.SPEEDS.size - 1
        nearest = np.clip(np.round((speed - first) / (self.SPEEDS[-1] - first) * last), 0, last)
        return float(self.SPEEDS[int(np.clip(nearest + change, 0, last))])


class _ModelledVehicle(ControlledVehicle):  # type: ignore[misc]  # untyped too
    """Carries out the answers of a driver model, or is put somewhere; see `stepping.Put`."""

    target_lane_index: tuple[str, str, int]
    put: Mapping[str, Any] | None = None

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
        if self.put is not None:
            self.position = np.array([self.put["x"], self.put["y"]])
            self.heading, self.speed = float(self.put["heading"]), float(self.put["speed"])
            self.action = {"steering": 0.0, "acceleration": float(self.put["acceleration"])}
            self.on_state_update()
            self.target_lane_index = self.lane_index
            self.put = None


def highway_env_network(road: Straight) -> RoadNetwork:
    """highway-env's network of a straight road [`HighwayEnv._create_road`]."""
    network, width = RoadNetwork(), road.lane_width
    for lane in range(road.lanes):
        ends = np.array([[0.0, lane * width], [road.road_length, lane * width]])
        straight = StraightLane(*ends, width=width, speed_limit=road.speed_limit)
        network.add_lane("0", "1", straight)
    return network


def _set_size(vehicle: Any, length: float, width: float) -> None:
    """Gives a vehicle a size of its own [`RoadObject.__init__`]."""
    vehicle.LENGTH, vehicle.WIDTH = length, width
    vehicle.diagonal = np.sqrt(length**2 + width**2)


def _reference_class(model: DriverModel, profile: Profile) -> Any:
    """The class that a driver model names as its reference, or the class that obeys its answers."""
    if not model.highway_env_class:
        return _with_constants(_ModelledVehicle, profile)
    module, name = model.highway_env_class.split(":")
    return _with_constants(getattr(import_module(module), name), profile)


def _with_actions(profile: Profile, actions: tuple[MetaAction, ...]) -> Any:
    """The class that obeys these meta-actions."""
    commanded = _with_constants(_MetaVehicle, profile)
    speeds = profile.target_speeds_mps if follows_profile(actions) else ()
    commanded.PROFILE, commanded.SPEEDS = profile, np.array(speeds)
    of_profile = _steps_of(profile) if follows_profile(actions) and not speeds else ()
    commanded.MOST = max(1, len(of_profile), *(len(each.speed_steps_mps) for each in actions))
    return commanded


def _steps_of(profile: Profile) -> tuple[float, ...]:
    return profile.target_speed_steps_mps or (profile.target_speed_step_mps,)


def _with_constants(vehicle_class: Any, profile: Profile) -> Any:
    """A subclass of a highway-env vehicle class with the profile's constants."""
    idm, standard_length = profile.idm_mobil, profile.vehicle_length_m

    def lane_distance_to(self: Any, other: Any, lane: Any = None) -> Any:
        """[`RoadObject.lane_distance_to`] for lengths that differ; see `following_distance`."""
        distance = vehicle_class.lane_distance_to(self, other, lane)
        lengths = self.LENGTH, (other or self).LENGTH
        return following_distance(distance, *(overhang(k, standard_length) for k in lengths))

    def step(self: Any, dt: float) -> None:
        """[`Vehicle.step`] without reversing, unless a recording says so."""
        is_put = getattr(self, "put", None) is not None
        vehicle_class.step(self, dt)
        if self.speed < 0.0 and not is_put:
            self.action["acceleration"] -= self.speed / dt
            self.speed = 0.0

    def desired_gap(self: Any, *others: Any, **options: Any) -> Any:
        """[`IDMVehicle.desired_gap`], but at least the profile's."""
        return max(vehicle_class.desired_gap(self, *others, **options), idm.least_gap_m)

    values = {
        "LENGTH": standard_length,
        "WIDTH": profile.vehicle_width_m,
        "MIN_SPEED": profile.speed_min_mps,
        "MAX_SPEED": profile.speed_max_mps,
        "KP_A": 1 / profile.tau_acceleration_s,
        "KP_HEADING": 1 / profile.tau_heading_s,
        "KP_LATERAL": 1 / profile.tau_lateral_s,
        "MAX_STEERING_ANGLE": profile.steering_limit_rad,
        "LOWEST_TARGET": profile.target_speed_min_mps,
        "HIGHEST_TARGET": profile.target_speed_max_mps,
        "FROM_CURRENT_LANE": profile.lane_command_from == "current_lane",
        "DELTA_RANGE": [idm.exponent_low, idm.exponent_high],
        **_idm_attributes(idm.model_dump()),
    }
    held = {name: value for name, value in values.items() if hasattr(vehicle_class, name)}
    held["lane_distance_to"] = lane_distance_to
    if not profile.can_reverse:
        held["step"] = step
    if idm.least_gap_m is not None and hasattr(vehicle_class, "desired_gap"):
        held["desired_gap"] = desired_gap
    return type(vehicle_class.__name__, (vehicle_class,), held)


def _idm_attributes(constants: Mapping[str, float]) -> dict[str, float]:
    """The attributes of `IDMVehicle` for fields of `IdmMobilConstants`; others have none."""
    return {
        _IDM_ATTRIBUTES[name]: -value if name == "deceleration_mps2" else value
        for name, value in constants.items()
        if name in _IDM_ATTRIBUTES
    }


_IDM_ATTRIBUTES = {
    "acceleration_mps2": "COMFORT_ACC_MAX",
    "deceleration_mps2": "COMFORT_ACC_MIN",
    "jam_distance_m": "DISTANCE_WANTED",
    "time_headway_s": "TIME_WANTED",
    "acceleration_limit_mps2": "ACC_MAX",
    "politeness": "POLITENESS",
    "lane_change_gain_mps2": "LANE_CHANGE_MIN_ACC_GAIN",
    "imposed_braking_mps2": "LANE_CHANGE_MAX_BRAKING_IMPOSED",
    "lane_change_period_s": "LANE_CHANGE_DELAY",
}

ENGINES: tuple[MakeEngine, ...] = (BatchedEngine, HighwayEnvEngine)
"""The compiled engine of the straight road, and its reference."""
