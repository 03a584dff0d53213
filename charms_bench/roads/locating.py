"""Where vehicles are on the lanes of a network: coordinates, and the nearest lane."""

import math

from charms_bench.foundation.compiled import compiled, inlined, row_after, woven, wrap_to_pi
from charms_bench.roads.scenes import KNOWN_LANES, Here, Row, lane_of, vehicle_of
from charms_bench.world.gaps import following_distance, overhang
from charms_bench.world.lane_geometry import (
    CIRCULAR,
    POLYLINE,
    SINE,
    STRAIGHT,
    curve_coordinates,
    curve_heading,
    curve_width,
    line_coordinates,
    line_heading,
)


@woven
def coordinates_of(here: Here, i: int, lane: int) -> Row:
    """The coordinates of vehicle i on a lane, which are computed when they are first asked for.

    They are valid until those on another lane are asked for.
    """
    at, key = kept_of(here, i, lane), row_after(here.visited, i).moved + lane
    if at.key != key:
        at.key = key
        row, vehicle = lane_of(here, lane), vehicle_of(here, i)
        if row.kind == STRAIGHT:  # as in `line_coordinates`, without a call
            x, y = vehicle.x - row.x, vehicle.y - row.y
            at.s = x * row.direction_x + y * row.direction_y
            at.r = x * -row.direction_y + y * row.direction_x
        else:
            compute(at, row, vehicle, here.curves)
    return at


@woven
def kept_of(here: Here, i: int, lane: int) -> Row:
    """Where the coordinates of vehicle i on a lane are kept."""
    return row_after(here.coordinates, i * KNOWN_LANES + (lane & (KNOWN_LANES - 1)))


@inlined
def is_known(here: Here, i: int, lane: int) -> bool:
    """Whether the coordinates of vehicle i on a lane have been computed."""
    return bool(kept_of(here, i, lane).key == row_after(here.visited, i).moved + lane)


@inlined
def as_followed(here: Here, i: int, j: int, distance: float) -> float:
    """The distance to vehicle j ahead of vehicle i as IDM measures it; see `following_distance`."""
    c = here.constants
    if not c.mixed_sizes:
        return distance
    own, other = vehicle_of(here, i).length, vehicle_of(here, j).length
    return float(following_distance(distance, overhang(own, c.length), overhang(other, c.length)))


@inlined
def distance_to(here: Here, i: int, j: int) -> float:
    """How far vehicle j is ahead on the lane of vehicle i [`RoadObject.lane_distance_to`]."""
    lane = vehicle_of(here, i).lane
    distance = coordinates_of(here, j, lane).s - coordinates_of(here, i, lane).s
    return as_followed(here, i, j, distance)


@compiled
def compute(at: Row, lane: Row, vehicle: Row, curves: Row) -> None:
    """[`AbstractLane.local_coordinates`]"""
    if lane.kind == POLYLINE:
        at.s, at.r = curve_coordinates(lane, curves, vehicle.x, vehicle.y)
    else:
        at.s, at.r = line_coordinates(lane, vehicle.x, vehicle.y)


@inlined
def heading_on(here: Here, lane: Row, s: float) -> float:
    """The heading of a lane so far along it [`AbstractLane.heading_at`]."""
    if lane.kind == STRAIGHT:
        return float(lane.heading)
    if lane.kind == POLYLINE:
        return curve_heading(lane, here.curves, s)
    return line_heading(lane, s)


@inlined
def width_on(here: Here, lane: Row, s: float) -> float:
    """The width of a lane so far along it [`AbstractLane.width_at`]."""
    return curve_width(lane, here.curves, s) if lane.kind == POLYLINE else float(lane.width)


@inlined
def are_above(here: Here, one: int, other: int) -> bool:
    """Whether a lane crosses above or below another one."""
    level, other_level = lane_of(here, one).level, lane_of(here, other).level
    return bool(level != other_level and level > 0 and other_level > 0)


@inlined
def forget(here: Here, i: int) -> None:
    """Forgets the coordinates of a vehicle that has moved."""
    here.clock.moves += 1
    row_after(here.visited, i).moved = here.clock.moves * here.lane_count


@compiled
def locate(here: Here, i: int) -> None:
    """Finds the nearest lane of a vehicle that has moved [`RoadNetwork.get_closest_lane_index`].

    Only lanes that can be the nearest one are asked; see `nearby`. Those that are further away than
    the lane before, whatever their heading, are left out.
    """
    forget(here, i)
    vehicle = vehicle_of(here, i)
    shortest = distance_with_heading(here, i, vehicle.lane, math.inf)
    before = best = vehicle.lane
    k = square_of(here, vehicle).first
    while True:
        lane = row_after(here.near, k).lane
        k += 1
        if lane < 0:
            break
        if lane == before or is_further(lane_of(here, lane), vehicle, shortest):
            continue
        distance = distance_with_heading(here, i, lane, shortest)
        if distance < shortest or (distance == shortest and lane < best):
            best, shortest = lane, distance
    vehicle.lane = best


@woven
def square_of(here: Here, vehicle: Row) -> Row:
    """The square of the map where a vehicle is; see `nearby`."""
    return row_after(here.nearest, number_of_square(here, vehicle))


@inlined
def number_of_square(here: Here, vehicle: Row) -> int:
    """The number of the square where a vehicle is; the first one is outside of the map."""
    squares = here.squares
    column = (vehicle.x - squares.x) * squares.per_metre
    row = (vehicle.y - squares.y) * squares.per_metre
    if 0 <= column < squares.columns and 0 <= row < squares.rows:
        return 1 + int(row) * int(squares.columns) + int(column)
    return 0


@inlined
def distance_with_heading(here: Here, i: int, lane: int, bound: float) -> float:
    """[`AbstractLane.distance_with_heading`], or infinity if it is certainly above a bound."""
    at, row, vehicle = coordinates_of(here, i, lane), lane_of(here, lane), vehicle_of(here, i)
    distance = abs(at.r) + max(at.s - row.length, 0.0) + max(0.0 - at.s, 0.0)
    if distance > bound:
        return math.inf
    heading = heading_on(here, row, at.s)
    return float(distance + abs(wrap_to_pi(vehicle.heading - heading)))


@inlined
def is_further(lane: Row, vehicle: Row, bound: float) -> bool:
    """Whether a lane is certainly further away than a bound, without its elementary functions."""
    if lane.kind == CIRCULAR or lane.kind == POLYLINE:
        return is_further_beside(lane, vehicle, bound)
    x, y = vehicle.x - lane.x, vehicle.y - lane.y
    s = x * lane.direction_x + y * lane.direction_y
    beyond = max(s - lane.length, 0.0) + max(0.0 - s, 0.0)
    if lane.kind == STRAIGHT:  # as in `distance_with_heading`, which keeps the coordinates
        return bool(abs(x * -lane.direction_y + y * lane.direction_x) + beyond > bound)
    return beyond > bound or is_further_beside(lane, vehicle, bound)


@inlined
def is_further_beside(lane: Row, vehicle: Row, bound: float) -> bool:
    """Whether a vehicle is certainly further beside a lane than a bound, in the same way."""
    x, y = vehicle.x - lane.x, vehicle.y - lane.y
    if lane.kind == CIRCULAR:
        return bool(abs(lane.radius - math.sqrt(x * x + y * y)) > bound)
    if lane.kind == SINE:
        r = x * -lane.direction_y + y * lane.direction_x
        return bool(abs(r) - abs(lane.amplitude) - 1e-6 > bound)
    return False
