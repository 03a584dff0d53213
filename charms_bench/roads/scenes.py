"""The state of B scenes of N vehicles and obstacles on a network of lanes."""

import math
from collections.abc import Iterable, Iterator, Sequence
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from charms_bench.engine.meta_actions import index_of
from charms_bench.foundation import maths
from charms_bench.foundation.arrays import Floats, Ints
from charms_bench.foundation.compiled import (
    Unpacked,
    borrowed,
    compiled,
    compiled_of_scenes,
    inlined,
    row_after,
    unpack_with,
    woven,
)
from charms_bench.foundation.generator import State
from charms_bench.roads.nearby import map_of
from charms_bench.world.profile import Constants, IdmMobilParameters
from charms_bench.world.road import closest_lane, heading_at, position
from charms_bench.world.road_network import Network, roads_after

KINDS = ("nothing", "landmark", "obstacle", "dynamical", "continuous", "commanded", "idm")
"""What is at a place; a vehicle's `kind` is an index into this tuple.

Nothing collides with a landmark. A continuous vehicle keeps the acceleration and the steering angle
that it was given [`Vehicle`]; a dynamical one also slips [`BicycleVehicle`]."""
NOTHING, LANDMARK, OBSTACLE, DYNAMICAL, CONTINUOUS, COMMANDED, IDM = range(len(KINDS))
ROUTE_STEPS = 12
"""The most steps of a route."""
BATCH = 8
"""For so many vehicles at once, elementary functions are computed; see `BATCHES`."""
FEW_VEHICLES, FEW_CONNECTED = 32, 6
"""Of so few, neighbours on single lanes and collisions, or neighbours on connected lanes, are found
by looking at all of them, which is faster."""
LISTS = 8
"""In so many lists on average, a vehicle can be at once; with more, the first ones are dropped."""
AHEAD_M = 60.0
"""So far beyond the end of a lane with links, neighbours are sought."""
OBSTACLE_SIZE_M = 2.0
"""The length and the width of an obstacle [`RoadObject`]."""
GAINS = 5
"""How many a linear vehicle has: three of its acceleration and two of its steering angle."""
ANY_SPEED_MPS = 1e6
"""The desired speed of a vehicle whose type has none: lanes limit its speed."""
IDM_EXPONENT = 4.0
"""That of a driver for whom none is drawn [`IDMVehicle.DELTA`]."""
WAY_LANES, BEHIND = 10, 3
"""How many lanes a way has; the vehicle's own is the lane `BEHIND`."""
Row = Any
"""A row of a table, which compiled code passes as a pointer."""


def _table(**names: str) -> "np.dtype[Any]":
    """The type of a row with fields of these names, which are separated by spaces."""
    kinds = {"floats": "f8", "integers": "i8", "booleans": "?"}
    kinds |= {"routes": f"{ROUTE_STEPS}i8", "gains": f"{GAINS}f8"}
    kinds |= {"lanes": f"{WAY_LANES}i8", "along": f"{WAY_LANES}f8"}
    fields = [(name, kinds[kind]) for kind, each in names.items() for name in each.split()]
    return np.dtype((np.record, np.dtype(fields, align=True)))


VEHICLE = _table(
    floats="x y heading direction_x direction_y speed acceleration steering length width "
    "target_speed desired_speed timer_s exponent impact_x impact_y speed_min speed_max "
    "lateral_speed yaw_rate "
    "free_acceleration goal_s stood_s stop_s",
    integers="kind lane target_lane speed_index route_step route_end goal stop_lane",
    booleans="crashed has_impact changes_lanes checks_collisions is_yielding",
    routes="route_roads route_numbers",
    gains="gains",
)
"""A row of the table of vehicles; SI units, and names as in `world.scene.Scene`.

`desired_speed` is that of the vehicle's type, `ANY_SPEED_MPS` if it has none. `exponent` is that of
IDM, and the `gains` are those of a linear vehicle; see `linear_vehicles`.
`speed_index` is the place of the target speed of a commanded vehicle. `changes_lanes`
says whether MOBIL is asked [`IDMVehicle.enable_lane_change`]. Two vehicles collide if one of them
`checks_collisions`. A vehicle that `is_yielding` stops for another one; see
`regulated_road`. Outside of `speed_min` to `speed_max`, a vehicle brakes or accelerates. Only a
dynamical vehicle has a `lateral_speed` and a `yaw_rate`. `free_acceleration` is the first part of
IDM, of an IDM vehicle in the present step. A route is a list of steps: the first lane
of a road between two nodes, and the number of the lane on it, -1 if it is open. The vehicle's next
step is `route_step`, and before `route_end` is the last. On a road of a file, its `goal` is one of
`Routes.goals`, -1 for none, so far along its road; so long it has stood, s; and it stops so far
along `stop_lane`, -1 for none."""
WAY = _table(
    lanes="lanes numbers", along="starts", integers="step target open_lanes", floats="speed_limit"
)
"""The way of a vehicle: its `lanes`, -1 for none, their `numbers` across the vehicle's road, and x
at their `starts`, m. It was found when the vehicle was at the step `step` of its route. A view
along it shows the lane `target` as the vehicle's target; so many lanes of its road, from the left,
are open; and its lane has that speed limit, m/s."""
COORDINATES = _table(floats="s r", integers="key")
"""How far a vehicle is along and beside a lane, m. The key is that of the lane and of the vehicle's
last move, for which it was computed."""
KNOWN_LANES = 32
"""Of so many lanes, the coordinates of a vehicle can be kept at once; a power of two."""
CONNECTED = _table(integers="lane ascending", floats="offset")
"""A lane on which neighbours are sought, and how far its start is along the lane in question.
`ascending` lists the same rows of a lane by their offsets."""
ORDER = _table(integers="place")
"""The place of a vehicle or an obstacle in the table of a scene."""
SEARCH = _table(integers="first after listed start count sorted first_on count_on")
"""Of a lane: the rows of `Scenes.connected`, that of the lane itself, then of those that start at
its end or end at its start [`Road.neighbour_vehicles`]. Where `listed` is the clock's `lists`, the
vehicles on them are in `Scenes.listed`, so many; and where `sorted` is its `moves`, those on the
lane alone, from `first_on` on."""
LISTED = _table(integers="place", floats="s")
"""A vehicle or an obstacle on a lane or on one connected with it, and how far along it."""
VISITED = _table(integers="moved lanes mark of rank at along changing batched by_x touched")
"""What is noted about a vehicle: the key of its last move, on how many lanes it is, whether and for
which lane it has been seen, its number in highway-env's order, and its number by x. And lists of
places, each in a column of its own: lane after lane as the vehicles stood on them last, those that
change lanes, those in the batches, all by x as they stood last, and those that may collide with
one. They share a table because every call of compiled code copies the rows of `Here`."""
SQUARES = _table(floats="x y per_metre", integers="columns rows")
"""The map of `nearby`: its corner, squares per metre, and their number."""
NEAREST = _table(integers="first on")
"""Where the lists begin of the lanes that can be the nearest ones of a vehicle in a square of the
map, and of those on which it can be. The first row is for a vehicle outside of the map."""
NEAR = _table(integers="lane")
"""A lane of such a list, -1 at its end. The first list is that of all lanes."""
BODY = _table(floats="x y reach", integers="place checks")
"""A vehicle or an obstacle as the search for collisions sees it: how far its corners reach, at
most, and whether it checks collisions."""
CLOCK = _table(integers="moves sorted lists used room marks changing most few", floats="gap")
"""How often vehicles have moved, so that what was found before is known to be obsolete; after which
move the vehicles on lanes were `sorted`; the number of the valid lists, how much of `Scenes.listed`
they use and how much there is; the last mark; how many vehicles change lanes; on how many lanes
one can be; whether a list is made by looking at all vehicles; and how far along the lanes the last
neighbour ahead was found, m."""
NUMBER = _table(floats="value")
"""A number of a vehicle in a batch."""
COLUMNS = tuple(range(13))
SPEED, LENGTH, HEADING, STEERING, LATERAL, AHEAD, SPEED_RATIO, EXPONENT, FREE, *_WAY = COLUMNS
X, Y, COSINE, SINE = _WAY
"""The numbers of a batch, each of them for `BATCH` vehicles side by side, so that a loop computes
all of them at once."""
CONSTANTS = _table(
    floats=" ".join((*Constants._fields[:-1], *IdmMobilParameters._fields)),
    integers="regulation_steps is_linear looks_ahead",
)
"""`Constants` and `IdmMobilParameters`, one after the other. After so many simulation steps,
vehicles look who has the right of way; 0 if they never do. `is_linear` says whether the vehicles
that decide by IDM elsewhere are linear. Where a road `looks_ahead`, they brake before slower
lanes of their routes."""


@compiled
def _unpack(scenes: Any) -> Unpacked:
    """Unpacks scenes; one function for each kind, because numba's cache imports what it unpacks."""
    return Unpacked(borrowed(scenes))  # type: ignore[no-untyped-call]


class _Fields(NamedTuple):
    """The fields of `Scenes`."""

    vehicles: NDArray[np.void]
    """[B, N] rows of `VEHICLE`: the egos, then the other vehicles, then obstacles."""
    ways: NDArray[np.void]
    """[B, N] rows of `WAY`: the ways of those that agents drive; see `straightened`."""
    order: NDArray[np.void]
    """[B, N] rows of `ORDER`, in highway-env's order of vehicles. Where vehicles come and go,
    places with nothing are last."""
    generator: State
    """[B, 6] the state of the scene's random generator."""
    time: Floats
    """[B] sum of the decision intervals, s, as highway-env rounds it."""
    steps: Ints
    """[B] the simulation steps of a road on which vehicles yield [`RegulatedRoad.steps`]."""
    target_speeds: Floats
    """[S] between which FASTER and SLOWER choose, m/s."""
    road: Network
    connected: NDArray[np.void]
    """Rows of `CONNECTED`."""
    searches: NDArray[np.void]
    """[L] rows of `SEARCH`."""
    squares: NDArray[np.void]
    """[1] the row of `SQUARES`."""
    nearest: NDArray[np.void]
    """Rows of `NEAREST`, for each square."""
    near: NDArray[np.void]
    """Rows of `NEAR`, list after list."""
    constants: NDArray[np.void]
    """[1] the row of `CONSTANTS`."""
    gains: Floats
    """[3, GAINS] of a linear vehicle for which none are drawn, the least, and how much larger the
    largest are."""
    coordinates: NDArray[np.void]
    """[N, KNOWN_LANES] rows of `COORDINATES`, for the scene that is being advanced, as are all
    below."""
    listed: NDArray[np.void]
    """[`clock.room`] rows of `LISTED`: the lanes of each vehicle, `clock.most` at most, then the
    vehicles on each lane, then those of each list."""
    visited: NDArray[np.void]
    """[N] rows of `VISITED`."""
    batches: NDArray[np.void]
    """[N / BATCH, COLUMNS, BATCH] rows of `NUMBER`."""
    bodies: NDArray[np.void]
    """[N] rows of `BODY`, by x."""
    clock: NDArray[np.void]
    """[1] the row of `CLOCK`."""


class Scenes(_Fields):
    """B scenes. The first vehicles of each are the egos, mostly one."""

    @cached_property
    def unpacked(self) -> Unpacked:
        """The scenes for compiled code, which unpacks them once."""
        return unpack_with(_unpack, self)

    def __getstate__(self) -> None:
        """A copy of the scenes is unpacked anew."""

    @classmethod
    def empty(
        cls,
        scenes: int,
        places: int,
        road: Network,
        connects: bool,
        target_speeds: Floats,
        constants: Constants,
        regulation_steps: int = 0,
        gains: Floats | None = None,
        links: Sequence[Sequence[int]] | None = None,
    ) -> "Scenes":
        """Scenes without vehicles.

        `connects` says whether neighbours are also sought on connected lanes
        [`neighbour_vehicles_connected_lanes`]. With `gains`, vehicles are linear.
        With `links`, the lanes that follow each lane, vehicles look ahead along them.
        """
        squares, begins, near, most = map_of(road)
        nearest = np.zeros(len(begins), NEAREST)
        nearest["first"], nearest["on"] = begins.T
        room = (LISTS + 2 * most) * places
        in_order = np.zeros(places, ORDER)
        in_order["place"] = np.arange(places)
        of_all = *constants[:-1], *constants.idm_mobil
        numbers = *of_all, regulation_steps, gains is not None, links is not None
        visited = np.zeros(places, VISITED)
        visited["along"] = visited["by_x"] = np.arange(places)
        clock = np.zeros(1, CLOCK)
        clock["sorted"], clock["room"], clock["most"] = -1, room, most
        clock["few"] = places <= (FEW_CONNECTED if connects else FEW_VEHICLES)
        return cls(
            vehicles=np.zeros((scenes, places), VEHICLE),
            ways=no_ways(scenes, places),
            order=np.tile(in_order, (scenes, 1)),
            generator=np.zeros((scenes, 6), np.uint64),
            time=np.zeros(scenes),
            steps=np.zeros(scenes, dtype=np.int64),
            target_speeds=target_speeds,
            road=road,
            **_searches(road, _linked(road, links) if links else _connected(road, connects)),
            squares=np.array([tuple(squares)], SQUARES),
            nearest=nearest,
            near=near.astype(NEAR),
            constants=np.array([numbers], CONSTANTS),
            gains=np.zeros((3, GAINS)) if gains is None else gains,
            coordinates=np.full(places * KNOWN_LANES, np.array((0, 0, -1), COORDINATES)),
            listed=np.zeros(room, LISTED),
            visited=visited,
            batches=np.zeros((-(-places // BATCH), len(COLUMNS), BATCH), NUMBER),
            bodies=np.zeros(places, BODY),
            clock=clock,
        )


def no_ways(scenes: int, places: int) -> NDArray[np.void]:
    """[B, N] rows of `WAY` that have not been found."""
    ways = np.zeros((scenes, places), WAY)
    ways["lanes"] = -1
    return ways


Found = list[tuple[int, float]]
"""Lanes, and how far their starts are along the lane in question, m."""


def _searches(road: Network, found: Iterable[Found]) -> dict[str, NDArray[np.void]]:
    """The tables of the lanes on which neighbours are sought."""
    connected: list[tuple[int, int, float]] = []
    searches = []
    for each in found:
        first = len(connected)
        by_offset = sorted(range(len(each)), key=[offset for _, offset in each].__getitem__)
        connected += [
            (lane, first + k, offset) for (lane, offset), k in zip(each, by_offset, strict=True)
        ]
        searches.append((first, len(connected), -1, 0, 0, -1, 0, 0))
    return {"connected": np.array(connected, CONNECTED), "searches": np.array(searches, SEARCH)}


def _connected(road: Network, connects: bool) -> Iterator[Found]:
    """For each lane, it and the lanes of `Road.neighbour_vehicles`, in its order."""
    table, roads = road.lanes, np.unique(road.lanes["first"]).tolist()
    before: dict[int, list[int]] = {first: [] for first in roads}
    for first in roads if connects else ():
        for following in roads_after(road, first):
            before[following].append(first)
    for lane, row in enumerate(table):
        number = lane - row["first"]
        found = [(lane, 0.0)]
        for following in roads_after(road, lane) if connects else ():
            found.append((_same_number(table, following, number), row["length"]))
        for each in before[int(row["first"])]:
            previous = _same_number(table, each, number)
            found.append((previous, -table["length"][previous]))
        yield found


def _linked(road: Network, links: Sequence[Sequence[int]]) -> Iterator[Found]:
    """For each lane, it and the lanes that follow it, lead to it, or follow such a lane alone.

    The last go on for `AHEAD_M`.
    """
    lengths = road.lanes["length"]
    before: list[list[int]] = [[] for _ in links]
    for lane, each in enumerate(links):
        for after in each:
            before[after].append(lane)
    for lane, each in enumerate(links):
        found = [(lane, 0.0)]
        for after in each:
            start = float(lengths[lane])
            while start - lengths[lane] < AHEAD_M and after not in [known for known, _ in found]:
                found.append((after, start))
                start += float(lengths[after])
                if len(links[after]) != 1:
                    break
                (after,) = links[after]
        known = {known for known, _ in found}
        yield found + [(one, -float(lengths[one])) for one in before[lane] if one not in known]


def _same_number(table: NDArray[np.void], first: int, number: int) -> int:
    """The lane with a number on the road with that first lane, or its first lane without one."""
    return int(first + number if number < table["lanes"][first] else first)


class Here(NamedTuple):
    """The scene that is being advanced, as the first rows of its tables."""

    vehicles: Row
    ways: Row
    order: Row
    places: int
    coordinates: Row
    lanes: Row
    curves: Row
    lane_count: int
    connected: Row
    searches: Row
    listed: Row
    visited: Row
    batches: Row
    bodies: Row
    clock: Row
    squares: Row
    nearest: Row
    near: Row
    constants: Row


@woven
def here_of(scenes: Scenes, b: int) -> Here:
    """Scene b."""
    return Here(
        scenes.vehicles[b, 0],
        scenes.ways[b, 0],
        scenes.order[b, 0],
        scenes.vehicles.shape[1],
        scenes.coordinates[0],
        scenes.road.lanes[0],
        scenes.road.curves[0],
        scenes.road.lanes.size,
        scenes.connected[0],
        scenes.searches[0],
        scenes.listed[0],
        scenes.visited[0],
        scenes.batches[0, 0, 0],
        scenes.bodies[0],
        scenes.clock[0],
        scenes.squares[0],
        scenes.nearest[0],
        scenes.near[0],
        scenes.constants[0],
    )


@woven
def vehicle_of(here: Here, i: int) -> Row:
    """The row of vehicle i."""
    return row_after(here.vehicles, i)


@woven
def way_of(here: Here, i: int) -> Row:
    """The row of the way of vehicle i."""
    return row_after(here.ways, i)


@inlined
def place_of(here: Here, k: int) -> int:
    """The place of the k-th vehicle or obstacle in highway-env's order."""
    return int(row_after(here.order, k).place)


@woven
def batch_of(here: Here, n: int) -> Row:
    """The batch of the n-th of some vehicles, in which its place is `n % BATCH`."""
    return row_after(here.batches, n // BATCH * (len(COLUMNS) * BATCH))


@inlined
def number_of(batch: Row, column: int, k: int) -> float:
    """A number of the k-th vehicle of a batch."""
    return float(row_after(batch, column * BATCH + k).value)


@inlined
def put(batch: Row, column: int, k: int, value: float) -> None:
    """Writes a number of the k-th vehicle of a batch."""
    row_after(batch, column * BATCH + k).value = value


@inlined
def batched(here: Here, n: int) -> int:
    """The place of the n-th vehicle in the batches."""
    return int(row_after(here.visited, n).batched)


@woven
def lane_of(here: Here, lane: int) -> Row:
    """The row of a lane."""
    return row_after(here.lanes, lane)


@compiled
def place(
    scenes: Scenes, b: int, i: int, kind: int, x: float, y: float, heading: float, speed: float
) -> None:
    """Puts a vehicle or an obstacle at a place of scene b [`IDMVehicle.__init__`, `MDPVehicle`]."""
    lane = closest_lane(scenes.road, x, y, heading)
    place_near(scenes, b, i, kind, lane, x, y, heading, speed)


@compiled
def place_near(
    scenes: Scenes,
    b: int,
    i: int,
    kind: int,
    lane: int,
    x: float,
    y: float,
    heading: float,
    speed: float,
) -> None:
    """As `place`, where the nearest lane is known."""
    vehicle, c = scenes.vehicles[b, i], scenes.constants[0]
    vehicle.kind = kind
    vehicle.x, vehicle.y, vehicle.heading, vehicle.speed = x, y, heading, speed
    vehicle.direction_y, vehicle.direction_x = maths.sin_cos(heading)
    vehicle.acceleration = vehicle.steering = 0.0
    vehicle.length = OBSTACLE_SIZE_M if kind <= OBSTACLE else c.length
    vehicle.width = OBSTACLE_SIZE_M if kind <= OBSTACLE else c.width
    vehicle.target_speed = 0.0 if kind <= CONTINUOUS else speed
    vehicle.desired_speed = ANY_SPEED_MPS
    vehicle.speed_min, vehicle.speed_max = c.speed_min, c.speed_max
    vehicle.lateral_speed = vehicle.yaw_rate = 0.0
    vehicle.timer_s = (x + y) * math.pi % c.lane_change_period_s
    vehicle.exponent = IDM_EXPONENT
    for k in range(GAINS):
        vehicle.gains[k] = scenes.gains[0, k]
    vehicle.lane = vehicle.target_lane = lane
    vehicle.route_step = vehicle.route_end = 0
    vehicle.goal, vehicle.goal_s, vehicle.stood_s = -1, 0.0, 0.0
    vehicle.stop_lane, vehicle.stop_s = -1, 0.0
    vehicle.crashed = vehicle.has_impact = vehicle.is_yielding = False
    vehicle.changes_lanes = vehicle.checks_collisions = True
    if kind == COMMANDED:
        vehicle.speed_index = index_of(speed, scenes.target_speeds)
        vehicle.target_speed = scenes.target_speeds[vehicle.speed_index]


@compiled
def put_on_lane(
    scenes: Scenes, b: int, i: int, kind: int, lane: int, s: float, speed: float
) -> None:
    """Puts a vehicle at a place of scene b, in the middle of a lane and along it."""
    x, y = position(scenes.road, lane, s, 0.0)
    place(scenes, b, i, kind, x, y, heading_at(scenes.road, lane, s), speed)


@compiled
def list_by_place(scenes: Scenes, b: int) -> None:
    """Lists what is in a scene by its places, and then the places with nothing."""
    for i in range(scenes.vehicles.shape[1]):
        scenes.order[b, i].place = i
    tidy(scenes, b)


@compiled
def tidy(scenes: Scenes, b: int) -> None:
    """Puts the places with nothing to the end of the order of a scene."""
    places, kept = scenes.vehicles.shape[1], 0
    before = np.empty(places, dtype=np.int64)
    for k in range(places):
        before[k] = scenes.order[b, k].place
    for is_nothing in (False, True):
        for i in before:
            if (scenes.vehicles[b, i].kind == NOTHING) == is_nothing:
                scenes.order[b, kept].place = i
                kept += 1


@compiled_of_scenes
def tidy_all(scenes: Scenes, rows: Ints) -> None:
    """Puts the places with nothing to the end of the order of the scenes `rows` (R,)."""
    for b in rows:
        tidy(scenes, b)


@compiled_of_scenes
def list_all_by_place(scenes: Scenes, rows: Ints) -> None:
    """Lists what is in the scenes `rows` (R,) by its places; see `list_by_place`."""
    for b in rows:
        list_by_place(scenes, b)
