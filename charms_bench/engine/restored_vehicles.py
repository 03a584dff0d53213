"""Sets highway-env's vehicles to a scene's arrays.

A constructor of highway-env searches the nearest lane, which takes longer than all the rest; here
it runs once per class. Vehicles of the right class are kept.
"""

from collections import deque
from typing import Any

import numpy as np
from highway_env.road.road import Road, RoadNetwork
from highway_env.vehicle.behavior import IDMVehicle

from charms_bench.world.scene import Scene


def set_size(vehicle: Any, length: float, width: float) -> None:
    """Gives a vehicle a size of its own [`RoadObject.__init__`]."""
    vehicle.LENGTH, vehicle.WIDTH = length, width
    vehicle.diagonal = np.sqrt(length**2 + width**2)


class RestoredVehicles:
    """Places vehicles on a road network of parallel lanes."""

    def __init__(self, network: RoadNetwork) -> None:
        self._network = network
        self._lanes = list(network.lanes_dict().items())
        # On a road without junctions, highway-env draws no random number after the spawn.
        self._rng = np.random.default_rng(0)
        self._patterns: dict[Any, dict[str, Any]] = {}
        """The attributes of a new vehicle of each class."""

    def place(self, road: Road | None, scene: Scene, row: int, classes: list[Any]) -> Road:
        """Puts the vehicles of one scene, of these N classes, on its road, or on a new one."""
        if road is None:
            road = Road(network=self._network, np_random=self._rng)
            road.vehicles = [None] * len(classes)
        positions = np.stack([scene.x[row], scene.y[row]], axis=-1)
        impacts = np.stack([scene.impact_x[row], scene.impact_y[row]], axis=-1)
        columns = [getattr(scene, name)[row].tolist() for name in _COLUMNS]
        for place, values in enumerate(zip(*columns, strict=True)):
            vehicle = road.vehicles[place]
            if type(vehicle) is not classes[place]:
                vehicle = road.vehicles[place] = self._new(classes[place], road)
            (
                vehicle.heading,
                vehicle.speed,
                vehicle.target_speed,
                vehicle.crashed,
                has_impact,
                lane,
                target_lane,
                steering,
                acceleration,
                timer_s,
                temperament,
                *size,
            ) = values
            set_size(vehicle, *size)
            vehicle.position = positions[place]
            vehicle.impact = impacts[place] if has_impact else None
            vehicle.lane_index, vehicle.lane = self._lanes[lane]
            vehicle.target_lane_index = self._lanes[target_lane][0]
            vehicle.action = {"steering": steering, "acceleration": acceleration}
            if hasattr(vehicle, "timer"):
                vehicle.timer = timer_s
            if isinstance(vehicle, IDMVehicle):
                low, high = vehicle.DELTA_RANGE
                vehicle.DELTA = low + (high - low) * temperament
        return road

    def _new(self, vehicle_class: Any, road: Road) -> Any:
        if vehicle_class not in self._patterns:
            vehicle = vehicle_class(road, (0.0, 0.0), 0.0, 1.0)
            self._patterns[vehicle_class] = vehicle.__dict__
        vehicle = object.__new__(vehicle_class)
        own = {"road": road, "log": [], "history": deque(maxlen=vehicle.HISTORY_SIZE)}
        vehicle.__dict__.update(self._patterns[vehicle_class] | own)
        return vehicle


_COLUMNS = (
    "heading", "speed", "target_speed", "crashed", "impact", "lane", "target_lane", "steering",
    "acceleration", "timer_s", "temperament", "length", "width",
)  # fmt: skip
