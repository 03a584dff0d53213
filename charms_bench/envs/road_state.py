"""What scripts for highway-env read of its objects: vehicles, as they are now."""

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from charms_bench.foundation.arrays import Floats
from charms_bench.roads.episodes import Episodes
from charms_bench.roads.layout import LaneName
from charms_bench.roads.scenes import OBSTACLE
from charms_bench.world.road import is_on_lane

INSTEAD = {
    "observation_type": "observation_space, and config['observation']",
    "viewer": "render_mode and render()",
    "automatic_rendering_callback": "render() after each step",
    "simplify": "road.vehicles",
    "change_vehicles": "config['other_vehicles_type']",
    "to_finite_mdp": "highway-env itself",
    # of roads
    "neighbour_vehicles": "lane_index, position and speed of road.vehicles",
    "close_vehicles_to": "position of road.vehicles",
    "close_objects_to": "position of road.vehicles",
    "network": "highway-env itself for the lanes, and lane_index of vehicles for their names",
    "objects": "an observation with include_obstacles",
    "np_random": "reset(seed=...)",
    # of vehicles
    "lane": "lane_index, and on_road",
    "lane_offset": "position, and lane_index",
    "lane_distance_to": "position, and lane_index",
    "front_distance_to": "position",
    "target_speeds": "config['action']['target_speeds']",
    "speed_index": "target_speed",
    "destination": "highway-env itself",
    "route": "highway-env itself",
    "goal": "desired_goal of the observation",
    "to_dict": "position, velocity, heading and the other attributes of a vehicle",
    "act": "step of the environment",
    "plan_route_to": "highway-env itself",
}
"""Attributes of highway-env's environments, roads and vehicles that are not here, and what to use
instead."""


def missing(thing: object, name: str) -> AttributeError:
    """The error for a missing attribute; it says what to use instead."""
    instead = f"; use {INSTEAD[name]}" if name in INSTEAD else ""
    return AttributeError(f"'{type(thing).__name__}' has no attribute '{name}'{instead}")


@dataclass(frozen=True, eq=False)
class RoadVehicle:
    """A vehicle at one moment; a change of it would not change the scene [`Vehicle`]."""

    position: Floats
    """(2,) m."""
    heading: float
    speed: float
    target_speed: float
    crashed: bool
    on_road: bool
    """Whether its centre is on its lane."""
    lane_index: LaneName
    target_lane_index: LaneName
    action: dict[str, float]
    """Its `acceleration` and its `steering`."""
    LENGTH: float
    WIDTH: float

    def __getattr__(self, name: str) -> Any:
        raise missing(self, name)

    @property
    def direction(self) -> Floats:
        """(2,) the unit vector along the vehicle."""
        return np.array([np.cos(self.heading), np.sin(self.heading)])

    @property
    def velocity(self) -> Floats:
        """(2,) m/s."""
        return self.speed * self.direction


class RoadState(NamedTuple):
    """What is on the road now."""

    vehicles: list[RoadVehicle]
    """In highway-env's order."""

    def __getattr__(self, name: str) -> Any:
        raise missing(self, name)


def vehicles_of(episodes: Episodes, b: int) -> dict[int, RoadVehicle]:
    """The vehicles of scene b by their places, in highway-env's order."""
    scenes, names = episodes.scenes, [*episodes.task.lanes]
    found: dict[int, RoadVehicle] = {}
    for place in scenes.order["place"][b]:
        row: Any = scenes.vehicles[b, place]
        if row["kind"] > OBSTACLE:
            lane, x, y = int(row["lane"]), float(row["x"]), float(row["y"])
            position = np.array([x, y])
            position.flags.writeable = False
            found[int(place)] = RoadVehicle(
                position=position,
                heading=float(row["heading"]),
                speed=float(row["speed"]),
                target_speed=float(row["target_speed"]),
                crashed=bool(row["crashed"]),
                on_road=bool(is_on_lane(scenes.road, lane, x, y, 0.0)),
                lane_index=names[lane],
                target_lane_index=names[row["target_lane"]],
                action={each: float(row[each]) for each in ("acceleration", "steering")},
                LENGTH=float(row["length"]),
                WIDTH=float(row["width"]),
            )
    return found
