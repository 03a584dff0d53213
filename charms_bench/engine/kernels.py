"""highway-env's road, vehicle and collision rules, compiled.

Each function names the highway-env function it follows. Operations keep highway-env's order, for
a sum in another order is another number. Private to the engines; `tests/naive.py` holds plain
versions. Plugins may call `find_neighbours`-filled tables through `Scene` instead.
"""

import math

import numpy as np

from charms_bench.compiled import compiled
from charms_bench.scene import Bools, Constants, Floats, Ints, Scene


@compiled
def clip(value: float, low: float, high: float) -> float:
    return min(max(value, low), high)


@compiled
def not_zero(value: float) -> float:
    """`utils.not_zero`: keeps a divisor away from zero."""
    if abs(value) > 1e-2:
        return value
    return 1e-2 if value >= 0 else -1e-2


@compiled
def wrap_to_pi(angle: float) -> float:
    """`utils.wrap_to_pi`."""
    return (angle + math.pi) % (2 * math.pi) - math.pi


@compiled
def steering_control(
    y: float, heading: float, speed: float, target_lane: int, c: Constants
) -> float:
    """Steering angle towards a lane's centre [`ControlledVehicle.steering_control`]."""
    lateral = y - target_lane * c.lane_width
    if lateral == 0.0 and heading == 0.0:
        return 0.0  # exactly what the rest gives, and where most vehicles are
    lateral_speed = -(1 / c.tau_lateral) * lateral
    heading_command = math.asin(clip(lateral_speed / not_zero(speed), -1.0, 1.0))
    heading_reference = clip(heading_command, -math.pi / 4, math.pi / 4)
    heading_rate = (1 / c.tau_heading) * wrap_to_pi(heading_reference - heading)
    slip = math.asin(clip(c.length / 2 / not_zero(speed) * heading_rate, -1.0, 1.0))
    return clip(math.atan(2 * math.tan(slip)), -c.steering_limit, c.steering_limit)


@compiled
def closest_lane(y: float, c: Constants) -> int:
    """`RoadNetwork.get_closest_lane_index` on parallel straight lanes: the first nearest."""
    best = 0
    distance = abs(y)
    for lane in range(1, c.lanes):
        other = abs(y - lane * c.lane_width)
        if other < distance:
            best = lane
            distance = other
    return best


@compiled
def move(
    x: Floats,
    y: Floats,
    heading: Floats,
    speed: Floats,
    acceleration: Floats,
    steering: Floats,
    lane: Ints,
    crashed: Bools,
    impact: Bools,
    impact_x: Floats,
    impact_y: Floats,
    c: Constants,
) -> None:
    """An Euler step of the bicycle model for a scene [`Vehicle.clip_actions`, `Vehicle.step`]."""
    for i in range(x.size):
        v, psi = speed[i], heading[i]
        if crashed[i]:
            steering[i] = 0.0
            acceleration[i] = -1.0 * v
        if v > c.speed_max:
            acceleration[i] = min(acceleration[i], 1.0 * (c.speed_max - v))
        elif v < c.speed_min:
            acceleration[i] = max(acceleration[i], 1.0 * (c.speed_min - v))
        if steering[i] == 0.0 and psi == 0.0:
            x[i] += v * c.dt
        else:
            beta = math.atan(1 / 2 * math.tan(steering[i]))
            x[i] += v * math.cos(psi + beta) * c.dt
            y[i] += v * math.sin(psi + beta) * c.dt
            heading[i] = psi + v * math.sin(beta) / (c.length / 2) * c.dt
            lane[i] = closest_lane(y[i], c)
        if impact[i]:
            x[i] += impact_x[i]
            y[i] += impact_y[i]
            crashed[i] = True
            impact[i] = False
            lane[i] = closest_lane(y[i], c)
        speed[i] = v + acceleration[i] * c.dt


@compiled
def sort_by_x(x: Floats, order: Ints, rank: Ints) -> None:
    """Restores `order` and `rank`: by x, then by place. Nearly sorted already, so by insertion."""
    for k in range(1, order.size):
        i = order[k]
        m = k
        while m > 0:
            j = order[m - 1]
            if x[j] < x[i] or (x[j] == x[i] and j < i):
                break
            order[m] = j
            m -= 1
        order[m] = i
    for k in range(order.size):
        rank[order[k]] = k


@compiled
def is_on_lane(x: float, y: float, lane: int, margin: float, c: Constants) -> bool:
    """`AbstractLane.on_lane`."""
    return (
        abs(y - lane * c.lane_width) <= c.lane_width / 2 + margin
        and -c.length <= x < c.road_length + c.length
    )


@compiled
def lanes_of(x: float, y: float, lane: int, c: Constants) -> tuple[int, int]:
    """First and last lane on which a vehicle whose closest is `lane` counts as a neighbour.

    A vehicle is on a lane up to 1 m beside it [`Road.neighbour_vehicles`], so it may be on two;
    beside or beyond the road it is on none, and the first returned exceeds the last.
    """
    if y == lane * c.lane_width and -c.length <= x < c.road_length + c.length:
        return lane, lane
    first, last = c.lanes, -1
    for other in range(max(lane - 1, 0), min(lane + 2, c.lanes)):
        if is_on_lane(x, y, other, 1.0, c):
            first, last = min(first, other), other
    return first, last


@compiled
def find_neighbours(
    x: Floats,
    y: Floats,
    lane: Ints,
    order: Ints,
    leaders: Ints,
    followers: Ints,
    nearest: Ints,
    c: Constants,
) -> None:
    """Fills a scene's `leaders` and `followers` [`Road.neighbour_vehicles` for each lane].

    `nearest` (L,) is working memory. Vehicles at the same x are each other's leader and nobody's
    follower; among several the last spawned leads and the first spawned follows.
    """
    vehicles = order.size
    nearest[:] = -1
    k = vehicles - 1
    while k >= 0:
        first = k
        while first > 0 and x[order[first - 1]] == x[order[k]]:
            first -= 1
        for m in range(first, k + 1):
            i = order[m]
            for on in range(c.lanes):
                leaders[i, on] = nearest[on]
            for other in range(first, k + 1):
                j = order[other]
                if j != i:
                    low, high = lanes_of(x[j], y[j], lane[j], c)
                    leaders[i, low : high + 1] = j
        for m in range(first, k + 1):
            i = order[m]
            low, high = lanes_of(x[i], y[i], lane[i], c)
            for on in range(low, high + 1):
                nearest[on] = i
        k = first - 1
    nearest[:] = -1
    k = 0
    while k < vehicles:
        last = k
        while last < vehicles - 1 and x[order[last + 1]] == x[order[k]]:
            last += 1
        for m in range(k, last + 1):
            for on in range(c.lanes):
                followers[order[m], on] = nearest[on]
        for m in range(last, k - 1, -1):
            i = order[m]
            low, high = lanes_of(x[i], y[i], lane[i], c)
            for on in range(low, high + 1):
                nearest[on] = i
        k = last + 1


@compiled
def fill_polygon(x: float, y: float, heading: float, c: Constants, corners: Floats) -> None:
    """A vehicle's corners (4, 2) [`RoadObject.polygon` without the repeated first one]."""
    cos, sin = math.cos(heading), math.sin(heading)
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
    """Separating axes of two rectangles [`utils.are_polygons_intersecting`].

    `displacement` is that of a relative to b within the step. Returns whether they intersect,
    whether they will, and the translation that parts them.
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
def collide(
    x: Floats,
    y: Floats,
    heading: Floats,
    speed: Floats,
    order: Ints,
    crashed: Bools,
    impact: Bools,
    impact_x: Floats,
    impact_y: Floats,
    hits: Floats,
    corners: Floats,
    c: Constants,
) -> None:
    """Collisions of a scene's pairs [`Road.step`, `RoadObject.handle_collisions`].

    Pairs are found along `order` and then applied in highway-env's order, place by place, because
    a later impact replaces an earlier one. Working memory: `hits` (pairs, 6), `corners` (2, 4, 2).
    """
    diagonal = math.sqrt(c.length**2 + c.width**2)
    fastest = 0.0
    for i in range(x.size):
        fastest = max(fastest, abs(speed[i]))
    reach = diagonal + fastest * c.dt
    found = 0
    for k in range(x.size):
        near = order[k]
        for m in range(k + 1, x.size):
            far = order[m]
            dx, dy = x[far] - x[near], y[far] - y[near]
            if dx > reach:
                break
            if heading[near] == 0.0 and heading[far] == 0.0 and abs(dy) > c.width:
                continue  # side by side and straight: no axis across the road lets them touch
            i, j = min(near, far), max(near, far)
            if math.sqrt(dx * dx + dy * dy) > diagonal + speed[i] * c.dt:
                continue
            fill_polygon(x[i], y[i], heading[i], c, corners[0])
            fill_polygon(x[j], y[j], heading[j], c, corners[1])
            relative_x = speed[i] * math.cos(heading[i]) * c.dt
            relative_x -= speed[j] * math.cos(heading[j]) * c.dt
            relative_y = speed[i] * math.sin(heading[i]) * c.dt
            relative_y -= speed[j] * math.sin(heading[j]) * c.dt
            now, soon, part_x, part_y = polygons_intersect(
                corners[0], corners[1], relative_x, relative_y
            )
            if now or soon:
                hits[found, 0] = i
                hits[found, 1] = j
                hits[found, 2] = now
                hits[found, 3] = soon
                hits[found, 4] = part_x
                hits[found, 5] = part_y
                found += 1
    for first in range(1, found):  # into the order of places; rarely more than one
        m = first
        while m > 0 and (
            hits[m - 1, 0] > hits[m, 0]
            or (hits[m - 1, 0] == hits[m, 0] and hits[m - 1, 1] > hits[m, 1])
        ):
            for column in range(6):
                hits[m, column], hits[m - 1, column] = hits[m - 1, column], hits[m, column]
            m -= 1
    for hit in range(found):
        i, j = int(hits[hit, 0]), int(hits[hit, 1])
        if hits[hit, 3]:
            impact[i] = impact[j] = True
            impact_x[i] = hits[hit, 4] / 2
            impact_y[i] = hits[hit, 5] / 2
            impact_x[j] = -hits[hit, 4] / 2
            impact_y[j] = -hits[hit, 5] / 2
        if hits[hit, 2]:
            crashed[i] = crashed[j] = True


@compiled
def obey(scene: Scene, rows: Ints, places: Ints, acceleration: Floats, target_lane: Ints) -> None:
    """Sets what a driver model answered; crashed vehicles no longer obey [`IDMVehicle.act`]."""
    for m in range(rows.size):
        if not scene.crashed[rows[m], places[m]]:
            scene.acceleration[rows[m], places[m]] = acceleration[m]
            scene.target_lane[rows[m], places[m]] = target_lane[m]


@compiled
def advance(scene: Scene, modelled: Bools) -> None:
    """One simulation step of every active scene, after the driver models have acted.

    `modelled` [B, N] marks vehicles whose acceleration a driver model has set; the others follow
    their target speed [`ControlledVehicle.speed_control`]. All act before any moves.
    """
    c = scene.constants
    vehicles = scene.x.shape[1]
    nearest = np.empty(c.lanes, dtype=np.int64)
    hits = np.empty((vehicles * (vehicles - 1) // 2, 6))
    corners = np.empty((2, 4, 2))
    for b in range(scene.x.shape[0]):
        if not scene.active[b]:
            continue
        # One scene's rows: taking arrays out of `scene` for every vehicle would cost more than
        # the physics.
        x, y, heading, speed = scene.x[b], scene.y[b], scene.heading[b], scene.speed[b]
        acceleration, steering = scene.acceleration[b], scene.steering[b]
        target_speed, target_lane = scene.target_speed[b], scene.target_lane[b]
        crashed, timer_s, obeying = scene.crashed[b], scene.timer_s[b], modelled[b]
        impact, impact_x, impact_y = scene.impact[b], scene.impact_x[b], scene.impact_y[b]
        lane, order = scene.lane[b], scene.order[b]
        for i in range(vehicles):
            if not obeying[i]:
                acceleration[i] = (1 / c.tau_acceleration) * (target_speed[i] - speed[i])
            steering[i] = steering_control(y[i], heading[i], speed[i], target_lane[i], c)
            timer_s[i] += c.dt
        move(
            x,
            y,
            heading,
            speed,
            acceleration,
            steering,
            lane,
            crashed,
            impact,
            impact_x,
            impact_y,
            c,
        )
        sort_by_x(x, order, scene.rank[b])
        collide(
            x,
            y,
            heading,
            speed,
            order,
            crashed,
            impact,
            impact_x,
            impact_y,
            hits,
            corners,
            c,
        )
        find_neighbours(
            x, y, lane, order, scene.leaders[b], scene.followers[b], nearest, c
        )


@compiled
def locate(scene: Scene, rows: Ints) -> None:
    """Refreshes `lane`, `order`, `rank` and the neighbour tables of some scenes from x and y."""
    c = scene.constants
    nearest = np.empty(c.lanes, dtype=np.int64)
    for b in rows:
        x, y, lane, order = scene.x[b], scene.y[b], scene.lane[b], scene.order[b]
        for i in range(x.size):
            lane[i] = closest_lane(y[i], c)
        sort_by_x(x, order, scene.rank[b])
        find_neighbours(
            x, y, lane, order, scene.leaders[b], scene.followers[b], nearest, c
        )


@compiled
def spawn(
    b: int,
    scene: Scene,
    rng: np.random.Generator,
    ego_slots: int,
    ego_speed: float,
    ego_spacing: float,
    traffic_spacing: float,
    crowding: float,
    speed_low: float,
    speed_high: float,
) -> None:
    """Draws a scene [the chain of `Vehicle.create_random` in `HighwayEnv._create_vehicles`].

    The ego's temperament is drawn last, so that with one slot the draws are `highway-v0`'s. `crowding` is its factor for the number of lanes.
    """
    c = scene.constants
    vehicles = scene.x.shape[1]
    period = c.idm_mobil.lane_change_period
    ego = rng.integers(0, ego_slots)
    scene.ego[b] = ego
    furthest = 0.0
    for i in range(vehicles):
        lane = rng.integers(0, c.lanes)
        if i == ego:
            speed, spacing = ego_speed, ego_spacing
        else:
            speed = rng.uniform(speed_low * c.speed_limit, speed_high * c.speed_limit)
            spacing = traffic_spacing
        offset = spacing * (12 + 1.0 * speed) * crowding
        x = 3 * offset if i == 0 else furthest
        x += offset * rng.uniform(0.9, 1.1)
        furthest = max(furthest, x)
        if i != ego:
            scene.temperament[b, i] = rng.random()
        scene.x[b, i] = x
        scene.y[b, i] = lane * c.lane_width
        scene.speed[b, i] = scene.target_speed[b, i] = speed
        scene.lane[b, i] = scene.target_lane[b, i] = lane
        scene.timer_s[b, i] = (x + lane * c.lane_width) * math.pi % period
    scene.temperament[b, ego] = rng.random()
    scene.heading[b] = 0.0
    scene.acceleration[b] = 0.0
    scene.steering[b] = 0.0
    scene.crashed[b] = False
    scene.impact[b] = False
    scene.active[b] = True
