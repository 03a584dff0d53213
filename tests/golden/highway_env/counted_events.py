"""Counts what happens while highway-env simulates, so that no case of its code stays unrecorded."""

from collections import Counter
from collections.abc import Callable
from typing import Any

import numpy as np
from highway_env.envs.intersection_env import IntersectionEnv
from highway_env.road.regulation import RegulatedRoad
from highway_env.road.road import RoadNetwork
from highway_env.vehicle.behavior import IDMVehicle
from highway_env.vehicle.controller import ControlledVehicle, MDPVehicle
from highway_env.vehicle.dynamics import BicycleVehicle
from highway_env.vehicle.kinematics import Vehicle
from highway_env.vehicle.objects import Obstacle

EVENTS = {
    "impact": "two vehicles overlap, or will in the next step",
    "impact among three": "an impact replaces that of another vehicle in the same step",
    "obstacle hit": "a vehicle overlaps an obstacle",
    "yielding by priority": "a vehicle stops for one on a lane of a higher priority",
    "yielding by position": "a vehicle stops for one ahead on a lane of the same priority",
    "entry blocked": "a vehicle does not enter an intersection, because another one is near",
    "leaves": "a vehicle is removed from an intersection",
    "aborted lane change": "a vehicle gives up a lane change, because another one takes the gap",
    "lane forbidden": "a vehicle does not change to a forbidden lane",
    "obstacle ahead": "a vehicle brakes for an obstacle, such as that at the end of a ramp",
    "step of a route": "a vehicle drops the first step of its route",
    "road without a route": "a vehicle chooses the next road without a route",
    "slip at low speed": "a dynamical vehicle slips slower than 1 m/s",
    "slip": "a dynamical vehicle slips faster",
    "reversing": "a vehicle has a negative speed after a decision",
    "off-road": "a vehicle is beside its lane after a decision",
    "two lanes": "a vehicle is a neighbour on two lanes of a road after a decision",
    "tie": "two neighbours on a lane are exactly as far along it after a decision",
}
counts: Counter[str] = Counter(dict.fromkeys(EVENTS, 0))


def count_events() -> None:
    """Has highway-env's classes count from now on."""
    _wrap(Vehicle, "handle_collisions", _impacts)
    _wrap(IntersectionEnv, "_spawn_vehicle", _entries)
    _wrap(IntersectionEnv, "_clear_vehicles", _exits)
    _wrap(IDMVehicle, "change_lane_policy", _aborted)
    _wrap(IDMVehicle, "acceleration", _obstacles)
    _wrap(RoadNetwork, "next_lane", _steps)
    _wrap(BicycleVehicle, "derivative_func", _slips)
    respects = RegulatedRoad.respect_priorities

    def respect(one: Any, other: Any) -> Any:
        found = respects(one, other)
        if isinstance(found, ControlledVehicle) and not isinstance(found, MDPVehicle):
            is_level = one.lane.priority == other.lane.priority
            counts[f"yielding by {'position' if is_level else 'priority'}"] += 1
        return found

    RegulatedRoad.respect_priorities = staticmethod(respect)


def note(road: Any) -> None:
    """Counts what can be seen of a road after a decision."""
    for k, vehicle in enumerate(road.vehicles):
        counts["reversing"] += vehicle.speed < 0
        counts["off-road"] += not vehicle.on_road
        sides = [vehicle.lane_index, *road.network.side_lanes(vehicle.lane_index)]
        lanes = [road.network.get_lane(index) for index in sides]
        counts["two lanes"] += sum(_is_near(vehicle, lane) for lane in lanes) > 1
        for other in road.vehicles[k + 1 :]:
            if (vehicle.position == other.position).any() and any(
                _is_near(vehicle, lane)
                and _is_near(other, lane)
                and lane.local_coordinates(vehicle.position)[0]
                == lane.local_coordinates(other.position)[0]
                for lane in lanes
            ):
                counts["tie"] += 1


def _is_near(vehicle: Any, lane: Any) -> bool:
    """Whether a vehicle is a neighbour on a lane [`Road.neighbour_vehicles`]."""
    return bool(lane.on_lane(vehicle.position, *lane.local_coordinates(vehicle.position), margin=1))


def _wrap(owner: Any, name: str, replacement: Callable[..., Any]) -> None:
    original = getattr(owner, name)
    setattr(owner, name, lambda *of, **options: replacement(original, *of, **options))


def _impacts(original: Any, own: Any, other: Any, dt: float = 0) -> None:
    before, others = own.impact, other.impact
    original(own, other, dt)
    if own.impact is before:
        return
    if isinstance(other, Obstacle):
        counts["obstacle hit"] += own.crashed
        others = None
    counts["impact"] += 1
    counts["impact among three"] += before is not None or others is not None


def _entries(original: Any, env: Any, *of: Any, **options: Any) -> Any:
    state = env.np_random.bit_generator.state
    found = original(env, *of, **options)
    if found is None:
        drawn = np.random.Generator(np.random.PCG64(0))
        drawn.bit_generator.state = state
        counts["entry blocked"] += drawn.uniform() <= options.get("spawn_probability", 0.6)
    return found


def _exits(original: Any, env: Any) -> None:
    before = len(env.road.vehicles)
    original(env)
    counts["leaves"] += before - len(env.road.vehicles)


def _aborted(original: Any, own: Any) -> None:
    is_changing = own.lane_index != own.target_lane_index
    original(own)
    counts["aborted lane change"] += is_changing and own.lane_index == own.target_lane_index
    if not is_changing and own.timer == 0:
        network = own.road.network
        sides = map(network.get_lane, network.side_lanes(own.lane_index))
        counts["lane forbidden"] += any(lane.forbidden for lane in sides)


def _obstacles(original: Any, own: Any, ego_vehicle: Any, *others: Any, **named: Any) -> Any:
    front = named.get("front_vehicle", others[0] if others else None)
    counts["obstacle ahead"] += ego_vehicle is own and isinstance(front, Obstacle)
    return original(own, ego_vehicle, *others, **named)


def _steps(original: Any, network: Any, *of: Any, route: Any = None, **named: Any) -> Any:
    before = len(route or ())
    found = original(network, *of, route=route, **named)
    counts["step of a route" if len(route or ()) < before else "road without a route"] += 1
    return found


def _slips(original: Any, own: Any, time: Any, state: Any, **options: Any) -> Any:
    speed, lateral_speed, yaw_rate = state[3:, 0]
    if lateral_speed or yaw_rate:
        counts["slip at low speed" if abs(speed) < 1 else "slip"] += 1
    return original(own, time, state, **options)
