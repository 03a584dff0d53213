"""Which vehicles are on each lane of a network, in order, and the neighbours of a vehicle there.

After vehicles have moved, it is found which of them are on each lane. Then those of a lane and of
the lanes connected with it are put in one list, when its neighbours are first asked for. On a lane
and in a list, vehicles stand by their position along the lane, and at equal positions by their
places. So a question about a vehicle costs the same, however many vehicles there are.
"""

from charms_bench.foundation import maths
from charms_bench.foundation.compiled import compiled, inlined, row_after
from charms_bench.roads.locating import (
    are_above,
    coordinates_of,
    heading_on,
    is_further_beside,
    is_known,
    square_of,
    width_on,
)
from charms_bench.roads.scenes import OBSTACLE, Here, Row, lane_of, vehicle_of
from charms_bench.world.lane_geometry import END_MARGIN_M, POLYLINE
from charms_bench.world.road import NEIGHBOUR_MARGIN_M

ROOM_M = 0.2
"""Beside a vehicle in the middle of a lane, there is room for one that comes against it from so
much further beside."""
FEW_LISTED = 8
"""So few are asked one after the other."""


@compiled
def neighbours(here: Here, i: int, lane: int) -> tuple[int, int]:
    """The nearest vehicles or obstacles ahead and behind on a lane, -1 for none.

    Of several at one position, that ahead is the last one in the table of vehicles, and that behind
    the first one [`Road.neighbour_vehicles`]. How far the one ahead is along the lanes is noted.
    """
    clock, search, s = here.clock, row_after(here.searches, lane), coordinates_of(here, i, lane).s
    if clock.sorted != clock.moves or search.listed != clock.lists:
        list_vehicles(here, search)
    end = search.start + search.count
    low, high = search.start, end
    while high - low > FEW_LISTED:
        middle = (low + high) // 2
        if row_after(here.listed, middle).s < s:
            low = middle + 1
        else:
            high = middle
    while low < high and row_after(here.listed, low).s < s:
        low += 1
    front = rear = -1
    s_front = s_rear = 0.0
    for k in range(low, end):
        listed = row_after(here.listed, k)
        if front >= 0 and listed.s != s_front:
            break
        if listed.place != i:
            front, s_front = listed.place, listed.s
    clock.gap = s_front - s
    for k in range(low - 1, search.start - 1, -1):
        listed = row_after(here.listed, k)
        if rear >= 0 and listed.s != s_rear:
            break
        if listed.place != i:
            rear, s_rear = listed.place, listed.s
    return front, rear


@compiled
def list_vehicles(here: Here, search: Row) -> None:
    """Lists the vehicles on a lane and those connected with it, each on the first that has it."""
    clock = here.clock
    if clock.sorted != clock.moves:
        clock.sorted = clock.moves
        clock.lists, clock.used = clock.lists + 1, 2 * clock.most * here.places
        if not clock.few:
            sort_vehicles(here)
    if clock.used + here.places > clock.room:
        clock.lists, clock.used = clock.lists + 1, 2 * clock.most * here.places
    search.listed, search.start, search.count = clock.lists, clock.used, 0
    if clock.few:
        list_any_order(here, search)
    elif search.after - search.first == 1:
        on = row_after(here.searches, row_after(here.connected, search.first).lane)
        search.start, search.count = on.first_on, number_on(here, on)
        return
    else:
        list_in_order(here, search)
    clock.used += search.count


@inlined
def list_any_order(here: Here, search: Row) -> None:
    """Lists a few vehicles, by looking at all of them."""
    for j in range(here.places):
        if vehicle_of(here, j).kind < OBSTACLE:
            continue
        for k in range(search.first, search.after):
            connected = row_after(here.connected, k)
            if is_on(here, j, connected.lane):
                s = coordinates_of(here, j, connected.lane).s + connected.offset
                insert(here, search.start, search.count, j, s)
                search.count += 1
                break


@compiled
def list_in_order(here: Here, search: Row) -> None:
    """Lists the vehicles on connected lanes, which are in order on each of them."""
    here.clock.marks += 1
    for k in range(search.first, search.after):
        on = row_after(here.searches, row_after(here.connected, k).lane)
        for n in range(on.first_on, on.first_on + number_on(here, on)):
            visited = row_after(here.visited, row_after(here.listed, n).place)
            if visited.mark != here.clock.marks:
                visited.mark, visited.of = here.clock.marks, k
    for m in range(search.first, search.after):
        k = row_after(here.connected, m).ascending
        connected = row_after(here.connected, k)
        on = row_after(here.searches, connected.lane)
        for n in range(on.first_on, on.first_on + number_on(here, on)):
            there = row_after(here.listed, n)
            if row_after(here.visited, there.place).of == k:
                s = there.s + connected.offset
                insert(here, search.start, search.count, there.place, s)
                search.count += 1


@inlined
def number_on(here: Here, on: Row) -> int:
    """How many vehicles are on a lane."""
    return int(on.count_on) if on.sorted == here.clock.moves else 0


@inlined
def insert(here: Here, start: int, count: int, place: int, s: float) -> None:
    """Puts a vehicle into a list of so many, which are in order."""
    n = start + count
    while n > start:
        before, after = row_after(here.listed, n - 1), row_after(here.listed, n)
        if before.s < s or (before.s == s and before.place < place):
            break
        after.place, after.s = before.place, before.s
        n -= 1
    there = row_after(here.listed, n)
    there.place, there.s = place, s


@compiled
def sort_vehicles(here: Here) -> None:
    """Finds the vehicles and obstacles on each lane."""
    clock, count = here.clock, 0
    start = clock.most * here.places
    for j in range(here.places):
        find_lanes(here, j)
        count += row_after(here.visited, j).lanes
    for n in range(here.places):
        j = row_after(here.visited, n).along
        for k in range(row_after(here.visited, j).lanes):
            found = row_after(here.listed, j * clock.most + k)
            on = row_after(here.searches, found.place)
            if on.first_on < 0:
                on.first_on = start
                start += on.count_on
                on.count_on = 0
            insert(here, on.first_on, on.count_on, j, found.s)
            on.count_on += 1
    keep_order(here, count)


@inlined
def find_lanes(here: Here, j: int) -> None:
    """Finds the lanes that vehicle j is on."""
    clock, vehicle, visited = here.clock, vehicle_of(here, j), row_after(here.visited, j)
    visited.lanes = 0
    if vehicle.kind < OBSTACLE:
        return
    near = square_of(here, vehicle).on
    while True:
        lane = row_after(here.near, near).lane
        near += 1
        if lane < 0:
            break
        if not is_on(here, j, lane):
            continue
        found = row_after(here.listed, j * clock.most + visited.lanes)
        on = row_after(here.searches, lane)
        found.place, found.s = lane, coordinates_of(here, j, lane).s
        visited.lanes += 1
        if on.sorted != clock.moves:
            on.sorted, on.first_on, on.count_on = clock.moves, -1, 0
        on.count_on += 1


@inlined
def is_on(here: Here, j: int, lane: int) -> bool:
    """Whether vehicle j is on a lane [`AbstractLane.on_lane`, with `NEIGHBOUR_MARGIN_M`]."""
    row = lane_of(here, lane)
    beside = row.width / 2 + NEIGHBOUR_MARGIN_M
    if not is_known(here, j, lane) and is_further_beside(row, vehicle_of(here, j), beside):
        return False
    at = coordinates_of(here, j, lane)
    if row.kind == POLYLINE:
        beside = width_on(here, row, at.s) / 2 + NEIGHBOUR_MARGIN_M
    if not (abs(at.r) <= beside and -END_MARGIN_M <= at.s < row.length + END_MARGIN_M):
        return False
    if here.constants.looks_ahead and comes_past(here, j, row, at):
        return False
    return not are_above(here, vehicle_of(here, j).lane, lane)


@compiled
def comes_past(here: Here, j: int, lane: Row, at: Row) -> bool:
    """Whether vehicle j comes against the direction of a lane, and leaves room on it.

    Beyond the ends of the lane, the lanes that follow say whether there is room. highway-env takes
    any vehicle up to `NEIGHBOUR_MARGIN_M` beside a lane for one on it. On maps, opposite lanes can
    be so close that two oncoming vehicles would stop before each other.
    """
    vehicle, heading = vehicle_of(here, j), heading_on(here, lane, at.s)
    x, y = maths.cos(heading), maths.sin(heading)
    along = x * vehicle.direction_x + y * vehicle.direction_y
    across = abs(x * vehicle.direction_y - y * vehicle.direction_x)
    reach = (across * vehicle.length - along * vehicle.width) / 2
    has_room = abs(at.r) - reach > vehicle.width / 2 + ROOM_M
    return bool(along < 0.0 and (has_room or at.s < 0.0 or at.s > lane.length))


@compiled
def keep_order(here: Here, count: int) -> None:
    """Notes the order of the vehicles on lanes: it will be almost the same after the next move."""
    clock, noted = here.clock, 0
    clock.marks += 1
    for n in range(count):
        place = row_after(here.listed, clock.most * here.places + n).place
        visited = row_after(here.visited, place)
        if visited.mark != clock.marks:
            visited.mark = clock.marks
            row_after(here.visited, noted).along = place
            noted += 1
    for place in range(here.places):
        if row_after(here.visited, place).mark != clock.marks:
            row_after(here.visited, noted).along = place
            noted += 1
