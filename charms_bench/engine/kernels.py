"""highway-env's road, vehicle and collision rules, compiled.

Each function names the highway-env function that it follows. Operations keep highway-env's order,
because floating-point sums depend on their order. A kernel takes its arrays out of the scene once
and passes numbers to the functions that it calls per vehicle: passing an array costs an atomic
reference count, which takes longer than the physics. Kernels are private to the harness;
`tests/naive.py` holds plain versions of them.
"""

import math
from typing import NamedTuple

import numpy as np

from charms_bench.world import maths
from charms_bench.world.compiled import clip, compiled, not_zero
from charms_bench.world.lanes import is_near_lane, is_on_lane, is_on_length
from charms_bench.world.profile import Constants
from charms_bench.world.scene import Bools, Floats, Ints, Scene


class SpawnRule(NamedTuple):
    """How `draw_scene` spawns; SI units."""

    lanes: int
    ego_slots: int
    ego_speed: float
    ego_spacing: float
    spacing: float
    crowding: float
    """highway-env's factor for all distances; it falls with the number of lanes."""
    speed_low: float
    speed_high: float


@compiled
def wrap_to_pi(angle: float) -> float:
    """`utils.wrap_to_pi`."""
    shifted = angle + math.pi
    if not 0 <= shifted < 2 * math.pi:
        shifted %= 2 * math.pi
    return shifted - math.pi


@compiled
def steering_control(lateral: float, heading: float, speed: float, c: Constants) -> float:
    """Steering angle towards a lane's centre, `lateral` m beside it.

    [`ControlledVehicle.steering_control`]
    """
    lateral_speed = -(1 / c.tau_lateral) * lateral
    heading_command = maths.asin(clip(lateral_speed / not_zero(speed), -1.0, 1.0))
    heading_reference = clip(heading_command, -math.pi / 4, math.pi / 4)
    heading_rate = (1 / c.tau_heading) * wrap_to_pi(heading_reference - heading)
    slip = maths.asin(clip(c.length / 2 / not_zero(speed) * heading_rate, -1.0, 1.0))
    return clip(maths.atan(2 * maths.tan(slip)), -c.steering_limit, c.steering_limit)


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
def move(scene: Scene, rows: Ints, modelled: Bools) -> None:
    """Steers and moves all vehicles of some scenes by one step of the bicycle model.

    `modelled` [B, N] marks the vehicles whose acceleration a driver model has set; all others
    control their target speed [`ControlledVehicle.act`, `Vehicle.clip_actions`, `Vehicle.step`].
    """
    c = scene.constants
    x, y, heading, speed = scene.x, scene.y, scene.heading, scene.speed
    direction_x, direction_y, lane = scene.direction_x, scene.direction_y, scene.lane
    acceleration, steering = scene.acceleration, scene.steering
    target_speed, target_lane, timer_s = scene.target_speed, scene.target_lane, scene.timer_s
    crashed, impact = scene.crashed, scene.impact
    impact_x, impact_y = scene.impact_x, scene.impact_y
    for b in rows:
        for i in range(x.shape[1]):
            v, psi = speed[b, i], heading[b, i]
            timer_s[b, i] += c.dt
            wanted = acceleration[b, i]
            if not modelled[b, i]:
                wanted = (1 / c.tau_acceleration) * (target_speed[b, i] - v)
            lateral = y[b, i] - target_lane[b, i] * c.lane_width
            angle = 0.0
            if crashed[b, i]:
                wanted = -1.0 * v
            elif lateral != 0.0 or psi != 0.0:
                angle = steering_control(lateral, psi, v, c)
            if v > c.speed_max:
                wanted = min(wanted, 1.0 * (c.speed_max - v))
            elif v < c.speed_min:
                wanted = max(wanted, 1.0 * (c.speed_min - v))
            acceleration[b, i] = wanted
            steering[b, i] = angle
            if angle == 0.0 and psi == 0.0:  # the result is the same, bit for bit
                x[b, i] += v * c.dt
            else:
                beta = maths.atan(1 / 2 * maths.tan(angle))
                x[b, i] += v * maths.cos(psi + beta) * c.dt
                y[b, i] += v * maths.sin(psi + beta) * c.dt
                psi += v * maths.sin(beta) / (c.length / 2) * c.dt
                heading[b, i] = psi
                direction_x[b, i], direction_y[b, i] = maths.cos(psi), maths.sin(psi)
                lane[b, i] = closest_lane(y[b, i], c.lanes, c.lane_width)
            if impact[b, i]:
                x[b, i] += impact_x[b, i]
                y[b, i] += impact_y[b, i]
                crashed[b, i] = True
                impact[b, i] = False
                lane[b, i] = closest_lane(y[b, i], c.lanes, c.lane_width)
            speed[b, i] = v + wanted * c.dt


@compiled
def sort_by_x(scene: Scene, rows: Ints) -> None:
    """Restores `order` and `rank`: by x, and at equal x in reverse order of spawning.

    The vehicles are nearly sorted, so this is an insertion sort.
    """
    x, order, rank = scene.x, scene.order, scene.rank
    for b in rows:
        for k in range(1, order.shape[1]):
            i = order[b, k]
            m = k
            while m > 0:
                j = order[b, m - 1]
                if x[b, j] < x[b, i] or (x[b, j] == x[b, i] and j > i):
                    break
                order[b, m] = j
                rank[b, j] = m
                m -= 1
            order[b, m] = i
            rank[b, i] = m


@compiled
def find_neighbours(scene: Scene, rows: Ints) -> None:
    """Fills `leaders` and `followers` of some scenes [`Road.neighbour_vehicles` for each lane].

    A vehicle is on a lane up to 1 m beside it, so it may be on two. Vehicles at equal x are each
    other's leaders, but not followers. Among several, the last spawned is the leader and the first
    spawned is the follower; the order of `sort_by_x` gives this.
    """
    c = scene.constants
    x, y, order = scene.x, scene.y, scene.order
    leaders, followers = scene.leaders, scene.followers
    vehicles = order.shape[1]
    nearest = np.empty(c.lanes, dtype=np.int64)
    for b in rows:
        nearest[:] = -1
        for k in range(vehicles - 1, -1, -1):
            i = order[b, k]
            on_length = is_on_length(x[b, i], c)
            for on in range(c.lanes):
                leaders[b, i, on] = nearest[on]
                is_on = on_length & is_near_lane(y[b, i], on, c)
                nearest[on] = i if is_on else nearest[on]
        nearest[:] = -1
        for k in range(vehicles):
            i = order[b, k]
            on_length = is_on_length(x[b, i], c)
            for on in range(c.lanes):
                followers[b, i, on] = nearest[on]
                is_on = on_length & is_near_lane(y[b, i], on, c)
                nearest[on] = i if is_on else nearest[on]
            if k > 0 and x[b, order[b, k - 1]] == x[b, i]:
                find_level_neighbours(b, k, scene)


@compiled
def find_level_neighbours(b: int, k: int, scene: Scene) -> None:
    """Corrects the neighbours of the k-th vehicle, which has the same x as the one before it."""
    c, x, order = scene.constants, scene.x, scene.order
    i = order[b, k]
    scene.followers[b, i] = scene.followers[b, order[b, k - 1]]
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
def collide(scene: Scene, rows: Ints) -> None:
    """Finds the collisions of pairs [`Road.step`, `RoadObject.handle_collisions`].

    Pairs are found along `order`, but applied in highway-env's order, by their places, because a
    later impact replaces an earlier one.
    """
    c = scene.constants
    x, y, heading, speed, order = scene.x, scene.y, scene.heading, scene.speed, scene.order
    direction_x, direction_y = scene.direction_x, scene.direction_y
    vehicles = x.shape[1]
    hits = np.empty((vehicles * (vehicles - 1) // 2, 6))
    corners = np.empty((2, 4, 2))
    diagonal = math.sqrt(c.length**2 + c.width**2)
    for b in rows:
        fastest = 0.0
        for i in range(vehicles):
            if abs(speed[b, i]) > fastest:
                fastest = abs(speed[b, i])
        reach = diagonal + fastest * c.dt
        found = 0
        for k in range(vehicles):
            near = order[b, k]
            for m in range(k + 1, vehicles):
                far = order[b, m]
                dx, dy = x[b, far] - x[b, near], y[b, far] - y[b, near]
                if dx > reach:
                    break
                if heading[b, near] == 0.0 and heading[b, far] == 0.0 and abs(dy) > c.width:
                    continue  # side by side and straight, so they are apart across the road
                i, j = min(near, far), max(near, far)
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
                    hits[found, :4] = (i, j, int(now), int(soon))
                    hits[found, 4:] = (part_x, part_y)
                    found += 1
        if found:
            in_turn = np.argsort(hits[:found, 0] * vehicles + hits[:found, 1])
            apply_hits(b, scene, hits[in_turn])


@compiled
def apply_hits(b: int, scene: Scene, hits: Floats) -> None:
    """Applies the collisions of scene b; each row is (place, place, now, soon, translation)."""
    for hit in range(len(hits)):
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
def obey(
    scene: Scene, rows: Ints, places: Ints, wanted: Floats, target_lane: Ints, modelled: Bools
) -> None:
    """Sets what a driver model returned and marks its vehicles in `modelled` [B, N].

    Crashed vehicles no longer obey [`IDMVehicle.act`].
    """
    crashed, acceleration, target_lanes = scene.crashed, scene.acceleration, scene.target_lane
    for m in range(rows.size):
        b, i = rows[m], places[m]
        modelled[b, i] = True
        if not crashed[b, i]:
            acceleration[b, i] = wanted[m]
            target_lanes[b, i] = target_lane[m]


@compiled
def advance(scene: Scene, modelled: Bools) -> None:
    """One simulation step of every active scene, after the driver models have acted."""
    rows = np.nonzero(scene.active)[0]
    move(scene, rows, modelled)
    sort_by_x(scene, rows)
    collide(scene, rows)
    find_neighbours(scene, rows)


@compiled
def locate(scene: Scene, rows: Ints) -> None:
    """Computes what follows from x, y and heading: directions, lanes, order and neighbours."""
    c = scene.constants
    for b in rows:
        for i in range(scene.x.shape[1]):
            scene.direction_x[b, i] = maths.cos(scene.heading[b, i])
            scene.direction_y[b, i] = maths.sin(scene.heading[b, i])
            scene.lane[b, i] = closest_lane(scene.y[b, i], c.lanes, c.lane_width)
    sort_by_x(scene, rows)
    find_neighbours(scene, rows)


@compiled
def draw_scene(rng: np.random.Generator, rule: SpawnRule, scene: Scene, b: int) -> None:
    """Draws the ego's place and the vehicles of scene b.

    The draws are those of `Vehicle.create_random` in `HighwayEnv._create_vehicles`. The ego's
    temperament is drawn last, so that with one slot the draws are the same as in `highway-v0`.
    """
    x, lane, speed, temperament = scene.x[b], scene.lane[b], scene.speed[b], scene.temperament[b]
    ego = scene.ego[b] = rng.integers(0, rule.ego_slots)
    furthest = 0.0
    for i in range(x.size):
        lane[i] = rng.integers(0, rule.lanes)
        if i == ego:
            speed[i], spacing = rule.ego_speed, rule.ego_spacing
        else:
            speed[i] = rng.uniform(rule.speed_low, rule.speed_high)
            spacing = rule.spacing
        offset = spacing * (12 + 1.0 * speed[i]) * rule.crowding
        x[i] = 3 * offset if i == 0 else furthest
        x[i] += offset * rng.uniform(0.9, 1.1)
        furthest = max(furthest, x[i])
        if i != ego:
            temperament[i] = rng.random()
    temperament[ego] = rng.random()
