"""Compares the vehicles of a road in a file with highway-env's own classes on the same lanes."""

from dataclasses import fields
from functools import partial
from importlib import import_module
from pathlib import Path
from time import process_time
from typing import Any

import numpy as np

from charms_bench.foundation.generator import seeded
from charms_bench.roads.defaults import DEFAULTS
from charms_bench.roads.file_road import FileRoad
from charms_bench.roads.map_lanes import driven_lanes, map_of
from charms_bench.roads.scenes import OBSTACLE, Scenes
from charms_bench.roads.stepping import decide
from charms_bench.testing.chunks import in_chunks
from charms_bench.testing.road_parity import Comparison, largest, pairs_of, route_of
from charms_bench.world.named_road import FILE_ROAD, NamedRoad
from charms_bench.world.profile import HIGHWAY_ENV
from charms_bench.world.road_network import Lane, PolyLane

HZ = 15
_CHUNK = 5


def verify_map(
    path: Path,
    episodes: int,
    vehicles: int = 10,
    seconds: int = 10,
    workers: int | None = None,
) -> Comparison:
    """Compares episodes in which IDM vehicles drive their routes, second by second.

    They start as the road's own vehicles do, with their routes, and see vehicles on connected
    lanes. What `file_road` adds to highway-env is off: it looks ahead along the lanes that follow,
    gives way, and has levels.
    """
    some, seeds = partial(_compare, vehicles=vehicles, seconds=seconds), range(episodes)
    (found,) = in_chunks(some, [path], seeds, _CHUNK, str, workers, lambda episodes: None)
    return sum(found, Comparison(path.name))


def _compare(path: Path, seeds: range, vehicles: int, seconds: int) -> Comparison:
    """Compares episodes with highway-env as it computes in this process."""
    ours = OwnRoad(path, vehicles)
    ours.start(0)
    ours.advance(1)  # compiles
    road = NamedRoad.model_validate({"file": path})
    network = stock_network(driven_lanes(map_of(path, str(road.sha256))))
    names = [*network.lanes_dict()]
    found = Comparison(path.name)
    for seed in seeds:
        ours.start(seed)
        stock = stock_road(ours, network, names)
        found.episodes += 1
        for second in range(seconds):
            began = process_time()
            ours.advance(1)
            between = process_time()
            advance_stock(stock, HZ)
            found.own_s += between - began
            found.stock_s += process_time() - between
            found.decisions += 1
            apart, what = largest(pairs_of(ours.present, stock.vehicles, names))
            found.largest = max(found.largest, apart)
            if apart:
                found.differing.append(f"episode {seed}, second {second}: {what}")
                break
        found.crashed += any(each.crashed for each in stock.vehicles)
    return found


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


def advance_stock(road: Any, steps: int) -> None:
    """Advances highway-env's road by `steps` simulation steps."""
    for _ in range(steps):
        road.act()
        road.step(1 / HZ)
