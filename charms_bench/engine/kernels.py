"""highway-env's road, vehicle and collision rules, compiled.

Each function names the highway-env function that it follows. Operations keep highway-env's order,
because floating-point sums depend on their order. Scenes are advanced in blocks that stay in the
processor's cache. Within a block, motion is computed in loops over the vehicles of all its scenes
that call one elementary function each, because such loops vectorise; order, collisions and
neighbours are found scene by scene.

A kernel takes its arrays out of the scene once and passes numbers to the functions that it calls
per vehicle: passing an array costs an atomic reference count, which takes longer than the physics.
Kernels are private to the harness; `tests/naive.py` holds plain versions of them.
"""

import math
from typing import NamedTuple

import numpy as np

from charms_bench.engine.draws import DISTANCE, LANE, SPEED, TEMPERAMENT
from charms_bench.world import maths
from charms_bench.world.actions import FASTER, LANE_LEFT, LANE_RIGHT, SLOWER, Actions
from charms_bench.world.compiled import clip, compiled, compiled_of_scenes, index, not_zero
from charms_bench.world.lanes import is_near_lane, is_on_lane, is_on_length, is_reachable
from charms_bench.world.profile import Constants
from charms_bench.world.scene import Bools, Floats, Ints, Scene

BLOCK_VEHICLES = 1024
"""Vehicles of a block, unless one scene has more."""
USUAL_SPEED_MPS = 50.0
"""Up to this speed, collisions are searched as if every vehicle had it; the result is the same."""


class SpawnRule(NamedTuple):
    """How `spawn` draws vehicles; SI units."""

    lanes: int
    ego_slots: int
    ego_speed: float
    ego_spacing: float
    spacing: float
    crowding: float
    """highway-env's factor for all distances; it falls with the number of lanes."""
    speed_low: float
    speed_high: float


class CommandRule(NamedTuple):
    """How meta-actions change target speeds and lanes; SI units."""

    speeds: Floats
    """The target speeds between which FASTER and SLOWER choose; empty if they add `step`."""
    step: float
    lowest: float
    highest: float
    from_target_lane: bool
    """Whether lane commands count from the target lane; otherwise from the current lane."""


@compiled
def wrap_to_pi(angle: float) -> float:
    """`utils.wrap_to_pi`."""
    shifted = angle + math.pi
    if not 0 <= shifted < 2 * math.pi:
        shifted %= 2 * math.pi
    return shifted - math.pi


class Turning(NamedTuple):
    """The vehicles of a block that turn, packed; each block uses the arrays (M,) again."""

    vehicle: Ints
    """The vehicle's index among all vehicles of the block."""
    is_steered: Bools
    """Whether the vehicle controls its steering; a crashed vehicle and a held one do not."""
    x: Floats
    """Position before the step, m."""
    lateral: Floats
    """Position beside the centre of the target lane, m."""
    heading: Floats
    speed: Floats
    angle: Floats
    """Intermediate results, rad."""
    steering: Floats
    ahead: Floats
    """Displacement along the road, m."""
    aside: Floats
    direction_x: Floats
    direction_y: Floats


@compiled
def room_to_turn(vehicles: int) -> Turning:
    """Arrays for a block of so many vehicles."""
    floats = np.empty((10, vehicles))
    return Turning(
        np.empty(vehicles, dtype=np.int64),
        np.empty(vehicles, dtype=np.bool_),
        floats[0],
        floats[1],
        floats[2],
        floats[3],
        floats[4],
        floats[5],
        floats[6],
        floats[7],
        floats[8],
        floats[9],
    )


@compiled
def steer(turning: Turning, count: int, c: Constants) -> None:
    """Computes the steering angles of `count` vehicles towards the centres of their target lanes.

    Vehicles that are not steered keep the angle that they have.

    [`ControlledVehicle.steering_control`]
    """
    lateral, heading, speed = turning.lateral, turning.heading, turning.speed
    angle, steering, is_steered = turning.angle, turning.steering, turning.is_steered
    for k in range(count):
        lateral_speed = -(1 / c.tau_lateral) * lateral[k]
        command = maths.asin(clip(lateral_speed / not_zero(speed[k]), -1.0, 1.0))
        angle[k] = clip(command, -math.pi / 4, math.pi / 4) - heading[k]
    for k in range(count):
        angle[k] = wrap_to_pi(angle[k])
    for k in range(count):
        heading_rate = (1 / c.tau_heading) * angle[k]
        angle[k] = maths.asin(clip(c.length / 2 / not_zero(speed[k]) * heading_rate, -1.0, 1.0))
    for k in range(count):
        angle[k] = 2 * maths.tan(angle[k])
    for k in range(count):
        limited = clip(maths.atan(angle[k]), -c.steering_limit, c.steering_limit)
        steering[k] = limited if is_steered[k] else steering[k]


@compiled
def turn(turning: Turning, count: int, c: Constants) -> None:
    """Computes the displacements and new headings of `count` vehicles [`Vehicle.step`]."""
    heading, speed, angle = turning.heading, turning.speed, turning.angle
    steering, ahead, aside = turning.steering, turning.ahead, turning.aside
    direction_x, direction_y = turning.direction_x, turning.direction_y
    for k in range(count):
        angle[k] = 1 / 2 * maths.tan(steering[k])
    for k in range(count):
        angle[k] = maths.atan(angle[k])
    for k in range(count):
        sine, cosine = maths.sin_cos(heading[k] + angle[k])
        ahead[k], aside[k] = speed[k] * cosine * c.dt, speed[k] * sine * c.dt
    for k in range(count):
        heading[k] += speed[k] * maths.sin(angle[k]) / (c.length / 2) * c.dt
    for k in range(count):
        direction_y[k], direction_x[k] = maths.sin_cos(heading[k])


@compiled
def closest_lane(y: float, lanes: int, lane_width: float) -> int:
    """`RoadNetwork.get_closest_lane_index` on parallel straight lanes: the first nearest."""
    best = 0
    distance = abs(y)
    for lane in range(1, lanes):
        other = abs(y - lane * lane_width)
        if other < distance:
            best = lane
            distance = other
    return best


@compiled
def follow_no_lane(scene: Scene, marked: Bools) -> None:
    """Makes the nearest lanes of the marked vehicles [B, N] their target lanes too.

    Near a border, `closest_lane` is corrected: highway-env rounds the distances of the lanes with
    what they have in common, the distance beyond the road's ends and the heading, so they can be
    equal [`AbstractLane.distance_with_heading`].
    """
    c = scene.constants
    for b in range(marked.shape[0]):
        for i in range(marked.shape[1]):
            if not marked[b, i]:
                continue
            x, y = scene.x[b, i], scene.y[b, i]
            lane = closest_lane(y, c.lanes, c.lane_width)
            own, left = abs(y - lane * c.lane_width), abs(y - (lane - 1) * c.lane_width)
            if lane > 0 and left - own < 1e-6:
                beyond, before = max(x - c.road_length, 0.0), max(0.0 - x, 0.0)
                angle = abs(wrap_to_pi(scene.heading[b, i]))
                lane -= left + beyond + before + angle <= own + beyond + before + angle
            scene.lane[b, i] = scene.target_lane[b, i] = lane


@compiled
def move(
    scene: Scene, first: int, after: int, modelled: Bools, held: Bools, turning: Turning
) -> None:
    """Steers and moves the scenes from `first` to before `after` by one step of the bicycle model.

    `modelled` [B, N] marks the vehicles whose acceleration a driver model has set; `held` marks
    those that keep their acceleration and steering; all others control their target speed
    [`ControlledVehicle.act`, `Vehicle.clip_actions`, `Vehicle.step`].
    """
    c = scene.constants
    x, y = scene.x[first:after].reshape(-1), scene.y[first:after].reshape(-1)
    heading, speed = scene.heading[first:after].reshape(-1), scene.speed[first:after].reshape(-1)
    acceleration = scene.acceleration[first:after].reshape(-1)
    steering = scene.steering[first:after].reshape(-1)
    target_speed = scene.target_speed[first:after].reshape(-1)
    target_lane = scene.target_lane[first:after].reshape(-1)
    timer_s, lane = scene.timer_s[first:after].reshape(-1), scene.lane[first:after].reshape(-1)
    crashed, impact = scene.crashed[first:after].reshape(-1), scene.impact[first:after].reshape(-1)
    is_modelled, is_held = modelled[first:after].reshape(-1), held[first:after].reshape(-1)
    turns = 0
    for i in range(x.size):
        turning.vehicle[turns] = i
        # The functions of a vehicle that goes straight would give 0 and 1.
        is_beside = (y[i] - target_lane[i] * c.lane_width != 0.0) & (not crashed[i])
        turns += (heading[i] != 0.0) | is_beside | (is_held[i] & (steering[i] != 0.0))
    for k in range(turns):
        i = index(turning.vehicle[k])
        turning.is_steered[k] = not (crashed[i] or is_held[i])
        turning.steering[k] = steering[i] if is_held[i] and not crashed[i] else 0.0
        turning.x[k] = x[i]
        turning.lateral[k] = y[i] - target_lane[i] * c.lane_width
        turning.heading[k] = heading[i]
        turning.speed[k] = speed[i]
    # Each loop has few arrays: LLVM does not vectorise a loop over many that might overlap.
    for i in range(x.size):
        v = speed[i]
        wanted = (1 / c.tau_acceleration) * (target_speed[i] - v)
        wanted = acceleration[i] if is_modelled[i] | is_held[i] else wanted
        wanted = -1.0 * v if crashed[i] else wanted
        wanted = min(wanted, 1.0 * (c.speed_max - v)) if v > c.speed_max else wanted
        wanted = max(wanted, 1.0 * (c.speed_min - v)) if v < c.speed_min else wanted
        acceleration[i] = wanted
    for i in range(x.size):
        timer_s[i] += c.dt
    for i in range(x.size):
        x[i] += speed[i] * c.dt
    for i in range(x.size):
        speed[i] += acceleration[i] * c.dt
    for i in range(x.size):
        steering[i] = 0.0
    steer(turning, turns, c)
    turn(turning, turns, c)
    direction_x = scene.direction_x[first:after].reshape(-1)
    direction_y = scene.direction_y[first:after].reshape(-1)
    for k in range(turns):
        i = index(turning.vehicle[k])
        x[i] = turning.x[k] + turning.ahead[k]
        y[i] += turning.aside[k]
        heading[i] = turning.heading[k]
        direction_x[i], direction_y[i] = turning.direction_x[k], turning.direction_y[k]
        steering[i] = turning.steering[k]
        lane[i] = closest_lane(y[i], c.lanes, c.lane_width)
    for i in range(x.size):
        if impact[i]:
            x[i] += scene.impact_x[first + i // scene.x.shape[1], i % scene.x.shape[1]]
            y[i] += scene.impact_y[first + i // scene.x.shape[1], i % scene.x.shape[1]]
            crashed[i] = True
            impact[i] = False
            lane[i] = closest_lane(y[i], c.lanes, c.lane_width)


@compiled
def sort_by_x(scene: Scene, first: int, after: int) -> None:
    """Restores `order` and `rank`: by x, and at equal x in reverse order of spawning.

    The vehicles are nearly sorted, so this is an insertion sort.
    """
    x, order, rank = scene.x, scene.order, scene.rank
    for b in range(first, after):
        last = order[b, 0]
        last_x = x[b, last]
        for k in range(1, order.shape[1]):
            i = order[b, k]
            own_x = x[b, i]
            if last_x < own_x or (last_x == own_x and last > i):
                last, last_x = i, own_x
                continue
            m = k
            while m > 0:
                j = order[b, m - 1]
                if x[b, j] < own_x or (x[b, j] == own_x and j > i):
                    break
                order[b, m] = j
                rank[b, j] = m
                m -= 1
            order[b, m] = i
            rank[b, i] = m


@compiled
def find_neighbours(scene: Scene, first: int, after: int) -> None:
    """Fills `leaders` and `followers` [`Road.neighbour_vehicles` for each lane].

    A vehicle is on a lane up to 1 m beside it, so it may be on two. Vehicles at equal x are each
    other's leaders, but not followers. Among several, the last spawned is the leader and the first
    spawned is the follower; the order of `sort_by_x` gives this.
    """
    c, vehicles = scene.constants, scene.x.shape[1]
    sorted_y = np.empty(vehicles)  # not a number, so on no lane, for a vehicle beyond the ends
    for b in range(first, after):
        x, y, order = scene.x[b], scene.y[b], scene.order[b]
        leaders, followers = scene.leaders[b], scene.followers[b]
        any_level = False
        last_x = -np.inf
        for k in range(vehicles):
            i = index(order[k])
            sorted_y[k] = y[i] if is_on_length(x[i], c) else np.nan
            any_level |= x[i] == last_x
            last_x = x[i]
        for lane in range(c.lanes):
            on = index(lane)
            nearest = np.int32(-1)
            for k in range(vehicles):
                followers[index(order[k]), on] = nearest
                nearest = order[k] if is_near_lane(sorted_y[k], lane, c) else nearest
            nearest = np.int32(-1)
            for k in range(vehicles - 1, -1, -1):
                at = index(k)
                leaders[index(order[at]), on] = nearest
                nearest = order[at] if is_near_lane(sorted_y[at], lane, c) else nearest
        if any_level:
            for k in range(1, vehicles):
                if x[order[k - 1]] == x[order[k]]:
                    find_level_neighbours(b, k, scene)


@compiled
def find_level_neighbours(b: int, k: int, scene: Scene) -> None:
    """Corrects the neighbours of the k-th vehicle, which has the same x as the one before it."""
    c, x, order = scene.constants, scene.x, scene.order
    i = order[b, k]
    for on in range(c.lanes):
        scene.followers[b, i, on] = scene.followers[b, order[b, k - 1], on]
    m = k - 1
    while m >= 0 and x[b, order[b, m]] == x[b, i]:
        j = order[b, m]
        for on in range(c.lanes):
            if is_on_lane(x[b, j], scene.y[b, j], on, c):
                scene.leaders[b, i, on] = j
        m -= 1


@compiled
def fill_polygon(x: float, y: float, cos: float, sin: float, c: Constants, corners: Floats) -> None:
    """Writes a vehicle's corners (4, 2) [`RoadObject.polygon` without the repeated corner]."""
    for corner in range(4):
        ahead = -c.length / 2 if corner < 2 else c.length / 2
        aside = -c.width / 2 if corner in (0, 3) else c.width / 2
        corners[corner, 0] = cos * ahead - sin * aside + x
        corners[corner, 1] = sin * ahead + cos * aside + y


@compiled
def project(corners: Floats, nx: float, ny: float) -> tuple[float, float]:
    """`utils.project_polygon`."""
    low = high = corners[0, 0] * nx + corners[0, 1] * ny
    for corner in range(1, 4):
        value = corners[corner, 0] * nx + corners[corner, 1] * ny
        low = min(low, value)
        high = max(high, value)
    return low, high


@compiled
def interval_distance(low_a: float, high_a: float, low_b: float, high_b: float) -> float:
    """`utils.interval_distance`: negative when the intervals overlap."""
    return low_b - high_a if low_a < low_b else low_a - high_b


@compiled
def polygons_intersect(
    a: Floats, b: Floats, displacement_x: float, displacement_y: float
) -> tuple[bool, bool, float, float]:
    """Tests two rectangles by their separating axes [`utils.are_polygons_intersecting`].

    `displacement` is the displacement of a relative to b within the step. Returns whether they
    intersect, whether they will intersect, and the translation that separates them.
    """
    intersecting = will_intersect = True
    smallest = np.inf
    axis_x = axis_y = 0.0
    centre_x = a[:, 0].sum() / 4 - b[:, 0].sum() / 4
    centre_y = a[:, 1].sum() / 4 - b[:, 1].sum() / 4
    for edge in range(8):
        polygon = a if edge < 4 else b
        start, end = edge % 4, (edge + 1) % 4
        nx = -polygon[end, 1] + polygon[start, 1]
        ny = polygon[end, 0] - polygon[start, 0]
        norm = math.sqrt(nx * nx + ny * ny)
        nx /= norm
        ny /= norm
        low_a, high_a = project(a, nx, ny)
        low_b, high_b = project(b, nx, ny)
        if interval_distance(low_a, high_a, low_b, high_b) > 0:
            intersecting = False
        along = nx * displacement_x + ny * displacement_y
        if along < 0:
            low_a += along
        else:
            high_a += along
        distance = interval_distance(low_a, high_a, low_b, high_b)
        if distance > 0:
            will_intersect = False
        if not intersecting and not will_intersect:
            break
        if abs(distance) < smallest:
            smallest = abs(distance)
            towards = centre_x * nx + centre_y * ny > 0
            axis_x = nx if towards else -nx
            axis_y = ny if towards else -ny
    return intersecting, will_intersect, smallest * axis_x, smallest * axis_y


@compiled
def collide(scene: Scene, first: int, after: int) -> None:
    """Finds the collisions of pairs [`Road.step`, `RoadObject.handle_collisions`].

    Pairs are found along `order`, but applied in highway-env's order, by their places, because a
    later impact replaces an earlier one.
    """
    c, vehicles = scene.constants, scene.x.shape[1]
    hits = np.empty((vehicles, 6))
    corners = np.empty((2, 4, 2))
    diagonal = math.sqrt(c.length**2 + c.width**2)
    beside = c.width + 1e-6  # where rounding does not decide whether they touch
    x, y, heading, speed = scene.x, scene.y, scene.heading, scene.speed
    direction_x, direction_y, order = scene.direction_x, scene.direction_y, scene.order
    for row in range(first, after):
        b = index(row)
        fastest = USUAL_SPEED_MPS
        is_faster = False
        for i in range(vehicles):
            is_faster |= abs(speed[b, i]) > fastest
        if is_faster:
            fastest = np.abs(speed[b]).max()
        reach = diagonal + fastest * c.dt
        found = 0
        for k in range(vehicles - 1):
            near = index(order[b, k])
            if x[b, index(order[b, k + 1])] - x[b, near] > reach:
                continue
            for m in range(k + 1, vehicles):
                far = index(order[b, m])
                dx, dy = x[b, far] - x[b, near], y[b, far] - y[b, near]
                if dx > reach:
                    break
                if heading[b, near] == 0.0 and heading[b, far] == 0.0 and abs(dy) > beside:
                    continue  # side by side and straight, so they are apart across the road
                i, j = min(order[b, k], order[b, m]), max(order[b, k], order[b, m])
                if math.sqrt(dx * dx + dy * dy) > diagonal + speed[b, i] * c.dt:
                    continue
                fill_polygon(x[b, i], y[b, i], direction_x[b, i], direction_y[b, i], c, corners[0])
                fill_polygon(x[b, j], y[b, j], direction_x[b, j], direction_y[b, j], c, corners[1])
                relative_x = speed[b, i] * direction_x[b, i] * c.dt
                relative_x -= speed[b, j] * direction_x[b, j] * c.dt
                relative_y = speed[b, i] * direction_y[b, i] * c.dt
                relative_y -= speed[b, j] * direction_y[b, j] * c.dt
                now, soon, part_x, part_y = polygons_intersect(
                    corners[0], corners[1], relative_x, relative_y
                )
                if now or soon:
                    if found == len(hits):
                        hits = np.concatenate((hits, np.empty_like(hits)))
                    hits[found, 0], hits[found, 1] = i, j
                    hits[found, 2], hits[found, 3] = now, soon
                    hits[found, 4], hits[found, 5] = part_x, part_y
                    found += 1
        if found:
            apply_hits(row, scene, hits[:found])


@compiled
def apply_hits(b: int, scene: Scene, hits: Floats) -> None:
    """Applies the collisions of scene b, pair by pair in the order of the vehicles' places.

    Each row of `hits` is (place, place, now, soon, translation), with the lower place first.
    """
    # There are few pairs, and NumPy's sorting would take longer to compile than this function.
    vehicles, last = scene.x.shape[1], -1.0
    for _ in range(len(hits)):
        hit, pair = 0, np.inf
        for each in range(len(hits)):
            of_each = hits[each, 0] * vehicles + hits[each, 1]
            if last < of_each < pair:
                hit, pair = each, of_each
        last = pair
        i, j = int(hits[hit, 0]), int(hits[hit, 1])
        if hits[hit, 3]:
            scene.impact[b, i] = scene.impact[b, j] = True
            scene.impact_x[b, i] = hits[hit, 4] / 2
            scene.impact_y[b, i] = hits[hit, 5] / 2
            scene.impact_x[b, j] = -hits[hit, 4] / 2
            scene.impact_y[b, j] = -hits[hit, 5] / 2
        if hits[hit, 2]:
            scene.crashed[b, i] = scene.crashed[b, j] = True


@compiled
def vehicles_of(agent: int, drivers: Ints, scenes: Bools) -> tuple[Ints, Ints]:
    """The vehicles (M,), by scene and place, that an agent drives in the scenes [B] marked."""
    rows = np.empty(drivers.size, dtype=np.int64)
    places = np.empty(drivers.size, dtype=np.int64)
    found = 0
    for b in range(drivers.shape[0]):
        if scenes[b]:
            for i in range(drivers.shape[1]):
                if drivers[b, i] == agent:
                    rows[found], places[found] = b, i
                    found += 1
    return rows[:found].copy(), places[:found].copy()


@compiled
def nearest_target_speed(speed: float, change: int, speeds: Floats) -> float:
    """[`MDPVehicle.speed_to_index` and `index_to_speed`], `change` indices further."""
    last = speeds.size - 1
    share = (speed - speeds[0]) / (speeds[-1] - speeds[0])
    nearest = min(max(round(share * last), 0), last)
    return float(speeds[min(max(nearest + change, 0), last)])


@compiled_of_scenes
def command(scene: Scene, rows: Ints, places: Ints, actions: Actions, rule: CommandRule) -> None:
    """Carries out the meta-actions (M,) of M vehicles [`ControlledVehicle.act`]."""
    c, target_speed, target_lane = scene.constants, scene.target_speed, scene.target_lane
    for m in range(rows.size):
        b, i, action = rows[m], places[m], actions[m]
        if action in (FASTER, SLOWER):
            change = 1 if action == FASTER else -1
            if rule.speeds.size:
                wanted = nearest_target_speed(scene.speed[b, i], change, rule.speeds)
            else:
                wanted = target_speed[b, i] + change * rule.step
                wanted = clip(wanted, rule.lowest, rule.highest)
            target_speed[b, i] = wanted
        elif action in (LANE_LEFT, LANE_RIGHT):
            lane = target_lane[b, i] if rule.from_target_lane else scene.lane[b, i]
            lane = min(max(lane + (1 if action == LANE_RIGHT else -1), 0), c.lanes - 1)
            if is_reachable(scene.x[b, i], scene.y[b, i], lane, c):
                target_lane[b, i] = lane


@compiled_of_scenes
def choose_target_speeds(scene: Scene, rows: Ints, modelled: Bools, speeds: Floats) -> None:
    """Gives the commanded vehicles of new scenes one of the target speeds."""
    for b in rows:
        for i in range(scene.x.shape[1]):
            if not modelled[b, i]:
                nearest = nearest_target_speed(scene.target_speed[b, i], 0, speeds)
                scene.target_speed[b, i] = nearest


@compiled
def is_on_own_lane(b: int, i: int, scene: Scene) -> bool:
    """Whether the centre of vehicle i of scene b is on its lane [`RoadObject.on_road`]."""
    x, y, lane = scene.x[b, i], scene.y[b, i], scene.lane[b, i]
    return bool(is_on_lane(x, y, lane, scene.constants, 0.0))


@compiled_of_scenes
def are_off_road(scene: Scene, rows: Ints, places: Ints) -> Bools:
    """(M,) whether the centres of M vehicles are outside their lanes."""
    off_road = np.empty(rows.size, dtype=np.bool_)
    for m in range(rows.size):
        off_road[m] = not is_on_own_lane(rows[m], places[m], scene)
    return off_road


@compiled_of_scenes
def obey(scene: Scene, rows: Ints, places: Ints, accelerations: Floats, lanes: Ints) -> None:
    """Sets what a driver model answered for its M vehicles.

    Crashed vehicles no longer obey [`IDMVehicle.act`].
    """
    is_wreck, wanted = scene.crashed.ravel(), scene.acceleration.ravel()
    target = scene.target_lane.ravel()
    for m in range(rows.size):
        i = index(rows[m] * scene.x.shape[1] + places[m])
        wanted[i] = wanted[i] if is_wreck[i] else accelerations[m]
        target[i] = target[i] if is_wreck[i] else lanes[m]


@compiled
def blocks_of(active: Bools, vehicles: int) -> list[tuple[int, int]]:
    """Splits the active scenes into blocks of neighbouring scenes: (first, first after)."""
    most = max(1, BLOCK_VEHICLES // vehicles)
    blocks = []
    first = 0
    while first < active.size:
        if not active[first]:
            first += 1
            continue
        after = first + 1
        while after < active.size and active[after] and after - first < most:
            after += 1
        blocks.append((first, after))
        first = after
    return blocks


@compiled_of_scenes
def advance(scene: Scene, modelled: Bools, held: Bools) -> None:
    """One simulation step of every active scene, after the driver models have acted; see `move`."""
    vehicles = scene.x.shape[1]
    turning = room_to_turn(max(BLOCK_VEHICLES, vehicles))
    for first, after in blocks_of(scene.active, vehicles):
        move(scene, first, after, modelled, held, turning)
        sort_by_x(scene, first, after)
        collide(scene, first, after)
        find_neighbours(scene, first, after)


@compiled
def locate(scene: Scene, rows: Ints) -> None:
    """Computes what follows from x, y and heading: directions, lanes, order and neighbours."""
    c = scene.constants
    for b in rows:
        for i in range(scene.x.shape[1]):
            scene.direction_y[b, i], scene.direction_x[b, i] = maths.sin_cos(scene.heading[b, i])
            scene.lane[b, i] = closest_lane(scene.y[b, i], c.lanes, c.lane_width)
        sort_by_x(scene, b, b + 1)
        find_neighbours(scene, b, b + 1)


@compiled
def seat(
    rows: Ints,
    ego: Ints,
    traffic: Ints,
    models: Bools,
    drivers: Ints,
    is_modelled: Bools,
    is_ego: Bools,
) -> None:
    """Gives the vehicles of the scenes `rows` (R,) their drivers; agent 0 drives the ego.

    `traffic` (R, N - 1) are the agents of the other vehicles. `models` marks the agents that are
    driver models; agents beyond its end are not.
    """
    for r in range(rows.size):
        b = rows[r]
        for i in range(drivers.shape[1]):
            drivers[b, i] = 0 if i == ego[b] else traffic[r, i - (i > ego[b])]
    mark_seats(rows, ego, models, drivers, is_modelled, is_ego)


@compiled
def mark_seats(
    rows: Ints, ego: Ints, models: Bools, drivers: Ints, is_modelled: Bools, is_ego: Bools
) -> None:
    """Marks the egos of the scenes `rows`, and the vehicles that driver models drive.

    Arguments are those of `seat`.
    """
    for b in rows:
        for i in range(drivers.shape[1]):
            agent = drivers[b, i]
            is_ego[b, i] = i == ego[b]
            is_modelled[b, i] = agent < models.size and models[agent]


@compiled_of_scenes
def spawn(scene: Scene, rows: Ints, draws: Floats, rule: SpawnRule) -> None:
    """Places new vehicles in the scenes `rows` (R,) by their draws (R, 4 N + 1); see `draws`.

    The rule is that of `Vehicle.create_random` in `HighwayEnv._create_vehicles`.
    """
    x, speed, lane, temperament = scene.x, scene.speed, scene.lane, scene.temperament
    for r in range(rows.size):
        b, drawn = rows[r], draws[r]
        ego = scene.ego[b] = int(drawn[0] * rule.ego_slots)
        furthest = 0.0
        for i in range(x.shape[1]):
            lane[b, i] = int(drawn[LANE + 4 * i] * rule.lanes)
            if i == ego:
                speed[b, i], spacing = rule.ego_speed, rule.ego_spacing
            else:
                span = rule.speed_high - rule.speed_low
                speed[b, i] = rule.speed_low + span * drawn[SPEED + 4 * i]
                spacing = rule.spacing
            offset = spacing * (12 + 1.0 * speed[b, i]) * rule.crowding
            x[b, i] = 3 * offset if i == 0 else furthest
            x[b, i] += offset * (0.9 + (1.1 - 0.9) * drawn[DISTANCE + 4 * i])
            furthest = max(furthest, x[b, i])
            temperament[b, i] = drawn[TEMPERAMENT + 4 * i]
            scene.order[b, i] = scene.rank[b, i] = i
        for i in range(x.shape[1]):
            scene.y[b, i] = lane[b, i] * scene.constants.lane_width
            scene.target_speed[b, i] = speed[b, i]
            scene.target_lane[b, i] = lane[b, i]
            phase = (x[b, i] + scene.y[b, i]) * math.pi  # as IDMVehicle.__init__
            scene.timer_s[b, i] = phase % scene.constants.idm_mobil.lane_change_period_s
            scene.heading[b, i] = scene.acceleration[b, i] = scene.steering[b, i] = 0.0
            scene.crashed[b, i] = scene.impact[b, i] = False
        scene.active[b] = True
    locate(scene, rows)
