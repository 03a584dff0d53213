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
def move(b: int, i: int, scene: Scene) -> None:
    """One Euler step of the bicycle model [`Vehicle.clip_actions`, `Vehicle.step`]."""
    c = scene.constants
    speed = scene.speed[b, i]
    heading = scene.heading[b, i]
    steering = scene.steering[b, i]
    acceleration = scene.acceleration[b, i]
    if scene.crashed[b, i]:
        steering = 0.0
        acceleration = -1.0 * speed
    if speed > c.speed_max:
        acceleration = min(acceleration, 1.0 * (c.speed_max - speed))
    elif speed < c.speed_min:
        acceleration = max(acceleration, 1.0 * (c.speed_min - speed))
    scene.steering[b, i] = steering
    scene.acceleration[b, i] = acceleration

    if steering == 0.0 and heading == 0.0:
        scene.x[b, i] += speed * c.dt
    else:
        beta = math.atan(1 / 2 * math.tan(steering))
        scene.x[b, i] += speed * math.cos(heading + beta) * c.dt
        scene.y[b, i] += speed * math.sin(heading + beta) * c.dt
        scene.heading[b, i] = heading + speed * math.sin(beta) / (c.length / 2) * c.dt
        scene.lane[b, i] = closest_lane(scene.y[b, i], c)
    if scene.impact[b, i]:
        scene.x[b, i] += scene.impact_x[b, i]
        scene.y[b, i] += scene.impact_y[b, i]
        scene.crashed[b, i] = True
        scene.impact[b, i] = False
        scene.lane[b, i] = closest_lane(scene.y[b, i], c)
    scene.speed[b, i] = speed + acceleration * c.dt
    scene.timer_s[b, i] += c.dt


@compiled
def sort_by_x(b: int, scene: Scene) -> None:
    """Restores `order` and `rank`: by x, then by place. Nearly sorted already, so by insertion."""
    order, x = scene.order, scene.x
    for k in range(1, order.shape[1]):
        i = order[b, k]
        m = k
        while m > 0:
            j = order[b, m - 1]
            if x[b, j] < x[b, i] or (x[b, j] == x[b, i] and j < i):
                break
            order[b, m] = j
            m -= 1
        order[b, m] = i
    for k in range(order.shape[1]):
        scene.rank[b, order[b, k]] = k


@compiled
def is_on_lane(x: float, y: float, lane: int, margin: float, c: Constants) -> bool:
    """`AbstractLane.on_lane`."""
    return (
        abs(y - lane * c.lane_width) <= c.lane_width / 2 + margin
        and -c.length <= x < c.road_length + c.length
    )


@compiled
def find_neighbours(b: int, scene: Scene, nearest: Ints) -> None:
    """Fills `leaders` and `followers` from `order` [`Road.neighbour_vehicles` for each lane].

    `nearest` (L,) is working memory. Vehicles at the same x are each other's leader and nobody's
    follower, and among several the last spawned leads and the first spawned follows.
    """
    c = scene.constants
    order, x, y = scene.order, scene.x, scene.y
    vehicles = order.shape[1]
    nearest[:] = -1
    k = vehicles - 1
    while k >= 0:
        first = k
        while first > 0 and x[b, order[b, first - 1]] == x[b, order[b, k]]:
            first -= 1
        for m in range(first, k + 1):
            i = order[b, m]
            for lane in range(c.lanes):
                leader = nearest[lane]
                for other in range(k, first - 1, -1):
                    j = order[b, other]
                    if j != i and is_on_lane(x[b, j], y[b, j], lane, 1.0, c):
                        leader = j
                        break
                scene.leaders[b, i, lane] = leader
        for m in range(first, k + 1):
            i = order[b, m]
            for lane in range(c.lanes):
                if is_on_lane(x[b, i], y[b, i], lane, 1.0, c):
                    nearest[lane] = i
        k = first - 1
    nearest[:] = -1
    k = 0
    while k < vehicles:
        last = k
        while last < vehicles - 1 and x[b, order[b, last + 1]] == x[b, order[b, k]]:
            last += 1
        for m in range(k, last + 1):
            i = order[b, m]
            for lane in range(c.lanes):
                scene.followers[b, i, lane] = nearest[lane]
        for m in range(last, k - 1, -1):
            i = order[b, m]
            for lane in range(c.lanes):
                if is_on_lane(x[b, i], y[b, i], lane, 1.0, c):
                    nearest[lane] = i
        k = last + 1


@compiled
def fill_polygon(b: int, i: int, scene: Scene, corners: Floats) -> None:
    """The vehicle's corners (4, 2) [`RoadObject.polygon` without the repeated first one]."""
    c = scene.constants
    cos, sin = math.cos(scene.heading[b, i]), math.sin(scene.heading[b, i])
    for corner in range(4):
        ahead = -c.length / 2 if corner < 2 else c.length / 2
        aside = -c.width / 2 if corner in (0, 3) else c.width / 2
        corners[corner, 0] = cos * ahead - sin * aside + scene.x[b, i]
        corners[corner, 1] = sin * ahead + cos * aside + scene.y[b, i]


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
def collide(b: int, scene: Scene, hits: Floats, corners: Floats) -> None:
    """Collisions between all pairs [`Road.step`, `RoadObject.handle_collisions`].

    Pairs are found along `order` and then applied in highway-env's order, place by place, because
    a later impact replaces an earlier one. Working memory: `hits` (pairs, 6), `corners` (2, 4, 2).
    """
    c = scene.constants
    x, y, heading, speed = scene.x, scene.y, scene.heading, scene.speed
    vehicles = x.shape[1]
    diagonal = math.sqrt(c.length**2 + c.width**2)
    fastest = 0.0
    for i in range(vehicles):
        fastest = max(fastest, abs(speed[b, i]))
    reach = diagonal + fastest * c.dt
    found = 0
    for k in range(vehicles):
        near = scene.order[b, k]
        for m in range(k + 1, vehicles):
            far = scene.order[b, m]
            if x[b, far] - x[b, near] > reach:
                break
            dy = y[b, far] - y[b, near]
            if heading[b, near] == 0.0 and heading[b, far] == 0.0 and abs(dy) > c.width:
                continue  # side by side and straight: no axis across the road lets them touch
            i, j = min(near, far), max(near, far)
            dx = x[b, far] - x[b, near]
            if math.sqrt(dx * dx + dy * dy) > diagonal + speed[b, i] * c.dt:
                continue
            fill_polygon(b, i, scene, corners[0])
            fill_polygon(b, j, scene, corners[1])
            relative_x = speed[b, i] * math.cos(heading[b, i]) * c.dt
            relative_x -= speed[b, j] * math.cos(heading[b, j]) * c.dt
            relative_y = speed[b, i] * math.sin(heading[b, i]) * c.dt
            relative_y -= speed[b, j] * math.sin(heading[b, j]) * c.dt
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
            scene.impact[b, i] = scene.impact[b, j] = True
            scene.impact_x[b, i] = hits[hit, 4] / 2
            scene.impact_y[b, i] = hits[hit, 5] / 2
            scene.impact_x[b, j] = -hits[hit, 4] / 2
            scene.impact_y[b, j] = -hits[hit, 5] / 2
        if hits[hit, 2]:
            scene.crashed[b, i] = scene.crashed[b, j] = True


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
        for i in range(vehicles):
            if not modelled[b, i]:
                scene.acceleration[b, i] = (1 / c.tau_acceleration) * (
                    scene.target_speed[b, i] - scene.speed[b, i]
                )
            scene.steering[b, i] = steering_control(
                scene.y[b, i],
                scene.heading[b, i],
                scene.speed[b, i],
                scene.target_lane[b, i],
                c,
            )
            move(b, i, scene)
        sort_by_x(b, scene)
        collide(b, scene, hits, corners)
        find_neighbours(b, scene, nearest)


@compiled
def locate(scene: Scene, rows: Ints) -> None:
    """Refreshes `lane`, `order`, `rank` and the neighbour tables of some scenes from x and y."""
    c = scene.constants
    nearest = np.empty(c.lanes, dtype=np.int64)
    for b in rows:
        for i in range(scene.x.shape[1]):
            scene.lane[b, i] = closest_lane(scene.y[b, i], c)
        sort_by_x(b, scene)
        find_neighbours(b, scene, nearest)


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
