"""Traffic that drives for a long time on a road in a file, and what happens in it."""

import math
from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from charms_bench.errors import InputError
from charms_bench.foundation.arrays import Bools
from charms_bench.foundation.compiled import compiled_of_scenes
from charms_bench.roads.episodes import Episodes
from charms_bench.roads.fault import REAR_END_COS, SIDE_COS
from charms_bench.roads.map_lanes import map_of
from charms_bench.roads.road_from_file import FileRoad
from charms_bench.roads.scenes import IDM, OBSTACLE, Scenes
from charms_bench.roads.stepping import decide
from charms_bench.roads.traffic_renewal import CLEARED, ENTERED, FREED, LEFT, STATIONARY_MPS
from charms_bench.world.named_road import FILE_ROAD, hash_of
from charms_bench.world.road import is_on_lane

SIMULATION_HZ = 15
OFF_ROAD_M = 1.0
"""A vehicle whose centre is further beside its lane's edge is off the road."""


@dataclass
class Drive:
    """What happened to the traffic."""

    vehicles: int
    """How many there are at the end."""
    hours: float
    km: float = 0.0
    """What they have driven together."""
    crashes: dict[str, int] = field(default_factory=dict)
    """How many collisions there were, by their kinds."""
    off_road: int = 0
    """How often a vehicle left the road without a collision."""
    freed: int = 0
    """How many vehicles were taken out because they had stood too long; see `road_from_file`."""
    left: int = 0
    """How many left at an end of the road."""
    stationary: float = 0.0
    """The proportion of the time in which vehicles stood."""

    @property
    def crashes_per_1000_km(self) -> float:
        """Collisions in 1,000 km of all vehicles."""
        return 1000 * sum(self.crashes.values()) / max(self.km, 1e-9)


def long_drive(path: Path, vehicles: int, hours: float, seed: int = 0) -> Drive:
    """Lets highway-env's IDM vehicles drive from goal to goal; see `road_from_file`.

    Args:
        path: A road file or a map.
        vehicles: How many drive; if there is no space for all at the start, the others come later.
        hours: For how long.
        seed: Decides where they start and where they go.

    Raises:
        InputError: There are too many vehicles, or the road is too large.
        MapError: The road cannot be read.
    """
    sha256 = hash_of(path)
    lane_km = sum(each.length for each in map_of(path, sha256).lanes) / 1000
    if vehicles < 2:
        raise InputError(f"vehicles: {vehicles}; expected at least 2")
    given = {"file": str(path), "sha256": sha256, "density": (vehicles - 1) / lane_km}
    episodes = Episodes(FILE_ROAD, 1, given | {"simulation_frequency": SIMULATION_HZ})
    task, scenes = episodes.task, episodes.scenes
    assert isinstance(task, FileRoad)
    rows, nobody = episodes.everyone, np.zeros((1, 0), dtype=np.int64)
    episodes.seed(rows, np.array([seed], dtype=np.uint64))
    episodes.start(rows)
    task.release_egos(scenes)
    hz = episodes.config["policy_frequency"]
    table, found, crashes = scenes.vehicles[0], Drive(0, hours), Counter[str]()
    was_off = was_wreck = np.zeros(table.size, dtype=np.bool_)
    for _ in range(round(hours * 3600 * hz)):
        decide(scenes, rows, nobody, SIMULATION_HZ // hz, 1 / hz)
        is_there = table["kind"] > OBSTACLE
        found.km += float(np.abs(table["speed"][is_there]).sum()) / hz / 1000
        found.stationary += float((np.abs(table["speed"][is_there]) < STATIONARY_MPS).mean())
        crashes.update(_new_crashes(scenes, was_wreck))
        is_off = _off_road(scenes, 0) & ~table["crashed"]
        found.off_road += int((is_off & ~was_off).sum())
        task.follow(scenes, rows)
        happened = task.happened[0]
        found.freed += int((happened == FREED).sum())
        found.left += int((happened == LEFT).sum())
        is_new = np.isin(happened, (LEFT, CLEARED, FREED, ENTERED))
        was_off, was_wreck = is_off & ~is_new, table["crashed"] & ~is_new
    found.vehicles = int((table["kind"] > OBSTACLE).sum())
    found.stationary /= max(round(hours * 3600 * hz), 1)
    found.crashes = dict(crashes.most_common())
    return found


def _new_crashes(scenes: Scenes, was_wreck: Bools) -> list[str]:
    """The kinds of the collisions since the last look: one for each pair, by their angle."""
    table = scenes.vehicles[0]
    new = np.nonzero(table["crashed"] & (table["kind"] > OBSTACLE) & ~was_wreck)[0].tolist()
    found, seen = [], set[int]()
    for i in new:
        if i in seen:
            continue
        away = np.hypot(table["x"] - table["x"][i], table["y"] - table["y"][i])
        away[~table["crashed"] | (table["kind"] <= OBSTACLE)] = np.inf
        away[i] = np.inf
        j = int(np.argmin(away))
        seen |= {i, j}
        cosine = math.cos(table["heading"][i] - table["heading"][j])
        if was_wreck[j]:
            found.append("into a wreck")
        elif cosine >= REAR_END_COS:
            found.append("same direction")
        else:
            found.append("oncoming" if cosine <= -SIDE_COS else "crossing or merging")
    return found


@compiled_of_scenes
def _off_road(scenes: Scenes, b: int) -> Bools:
    """(N,) whether each vehicle of scene b is beside its nearest lane."""
    found = np.zeros(scenes.vehicles.shape[1], dtype=np.bool_)
    for i in range(found.size):
        vehicle = scenes.vehicles[b, i]
        if vehicle.kind == IDM:
            where = vehicle.lane, vehicle.x, vehicle.y
            found[i] = not is_on_lane(scenes.road, *where, OFF_ROAD_M)
    return found
