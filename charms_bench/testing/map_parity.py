"""Episodes of IDM vehicles on a road in a file and of highway-env's own on the same lanes."""

from dataclasses import dataclass, fields
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np

from charms_bench.foundation.generator import seeded
from charms_bench.roads.defaults import DEFAULTS
from charms_bench.roads.map_lanes import driven_lanes, map_of
from charms_bench.roads.road_from_file import FileRoad
from charms_bench.roads.scenes import OBSTACLE, Scenes
from charms_bench.roads.stepping import decide
from charms_bench.testing.parity import Values
from charms_bench.testing.road_parity import route_of, values_of
from charms_bench.world.named_road import FILE_ROAD, NamedRoad
from charms_bench.world.profile import HIGHWAY_ENV
from charms_bench.world.road_network import Lane, PolyLane

HZ = 15


@dataclass(frozen=True)
class MapCase:
    """A road in a file, on which IDM vehicles drive their routes.

    They start as the road's own vehicles do, with their routes, and see vehicles on connected
    lanes. What `road_from_file` adds to highway-env is off: it looks ahead along the lanes that
    follow, gives way, and has levels.
    """

    path: Path
    vehicles: int = 10
    seconds: int = 10
    label: str = ""

    @property
    def title(self) -> str:
        """The label, or the name of the file."""
        return self.label or self.path.name

    def episode(self) -> "MapEpisode":
        """One on this road and on the same lanes as highway-env's classes."""
        return MapEpisode(self)


class MapEpisode:
    """The same vehicles on a road in a file and on highway-env's own."""

    step_name = "second"

    def __init__(self, case: MapCase) -> None:
        self._ours, self._seconds, self._second = OwnRoad(case.path, case.vehicles), case.seconds, 0
        self._ours.start(0)
        self._ours.advance(1)  # compiles
        road = NamedRoad.model_validate({"file": case.path})
        self._network = stock_network(driven_lanes(map_of(case.path, str(road.sha256))))
        self._names = [*self._network.lanes_dict()]

    def start(self, seed: int) -> None:
        self._second = 0
        self._ours.start(seed)
        self._stock = stock_road(self._ours, self._network, self._names)

    def advance(self) -> None:
        self._ours.advance(1)
        self._second += 1

    def advance_stock(self) -> None:
        for _ in range(HZ):
            self._stock.act()
            self._stock.step(1 / HZ)

    def values(self) -> Values:
        return values_of(self._ours.present, self._stock.vehicles, self._names)

    def is_over(self) -> bool:
        return self._second >= self._seconds

    def has_crashed(self) -> bool:
        return bool(self._stock.vehicles[0].crashed)


class OwnRoad:
    """About `vehicles` vehicles on the road of a file, by highway-env's rules alone."""

    def __init__(self, path: Path, vehicles: int) -> None:
        road = NamedRoad.model_validate({"file": path})
        known = map_of(path, str(road.sha256))
        lane_km = sum(lane.length for lane in known.lanes) / 1000
        config = {"file": str(path), "sha256": road.sha256, "density": (vehicles - 1) / lane_km}
        self.task = FileRoad({**DEFAULTS[FILE_ROAD], **config})
        lanes = self.task.layout.network.lanes
        lanes["level"] = 0
        constants, speeds = HIGHWAY_ENV.constants(1 / HZ), np.linspace(20, 30, 3)
        network = self.task.layout.network
        self.scenes = Scenes.empty(1, self.task.vehicles, network, True, speeds, constants)

    def start(self, seed: int) -> None:
        """Starts an episode in which the ego is an IDM vehicle, too."""
        rows = np.arange(1)
        self.scenes.generator[rows] = seeded(np.array([seed], dtype=np.uint64))
        self.task.start(self.scenes, rows)
        table = self.scenes.vehicles
        table["target_speed"], table["stop_lane"] = table["speed"], -1
        self.task.release_egos(self.scenes)

    def advance(self, seconds: int) -> None:
        """Advances without vehicles that come and go."""
        nobody = np.zeros((1, 0), dtype=np.int64)
        decide(self.scenes, np.arange(1), nobody, HZ * seconds, float(seconds))

    @property
    def present(self) -> list[Any]:
        """The vehicles in highway-env's order."""
        order = self.scenes.order["place"][0]
        return [each for each in self.scenes.vehicles[0, order] if each["kind"] > OBSTACLE]


def stock_network(edges: Any) -> Any:
    """highway-env's network of the same lanes."""
    network: Any = import_module("highway_env.road.road").RoadNetwork()
    for start_node, end_node, lane in edges:
        network.add_lane(start_node, end_node, _stock_lane(lane))
    return network


def _stock_lane(lane: Lane) -> Any:
    module: Any = import_module("highway_env.road.lane")
    values = {each.name: getattr(lane, each.name) for each in fields(lane)}
    values["line_types"] = None
    if not isinstance(lane, PolyLane):
        for name in ("start", "end", "center"):
            if name in values:
                values[name] = np.array(values[name], dtype=np.float64)
        return getattr(module, type(lane).__name__)(**values)
    points, widths = values.pop("points"), values.pop("widths")
    found = module.PolyLaneFixedWidth(lane_points=list(points), **values)
    if widths:
        # `PolyLane` would measure them between boundaries.
        found.__class__, found.width_samples = module.PolyLane, list(widths)
    return found


def stock_road(ours: OwnRoad, network: Any, names: list[Any]) -> Any:
    """highway-env's road with the same vehicles."""
    kind: Any = import_module("highway_env.vehicle.behavior").IDMVehicle
    module: Any = import_module("highway_env.road.road")
    road = module.Road(
        network, np_random=np.random.RandomState(0), neighbour_vehicles_connected_lanes=True
    )
    forwards = type("ForwardIDMVehicle", (kind,), {"MIN_SPEED": 0.0})
    for row in ours.present:
        vehicle = forwards(
            road,
            [float(row["x"]), float(row["y"])],
            float(row["heading"]),
            float(row["speed"]),
            target_speed=float(row["target_speed"]),
            route=route_of(row, names) or None,
            timer=float(row["timer_s"]),
        )
        vehicle.DELTA = float(row["exponent"])
        road.vehicles.append(vehicle)
    return road
