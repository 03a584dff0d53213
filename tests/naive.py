"""Plain versions of the compiled functions, for a single scene; slow and obvious."""

import math

import numpy as np
from scipy.spatial import ConvexHull

from charms_bench.world.profile import IdmMobilParameters
from charms_bench.world.road import Straight
from charms_bench.world.scene import Scene

Driver = tuple[Scene, IdmMobilParameters, float]
"""A scene, and the IDM constants and exponent by which its driver reckons."""


def closest_lane(y: float, lanes: int, width: float) -> int:
    return min(range(lanes), key=lambda lane: abs(y - lane * width))


def is_on_lane(x: float, y: float, lane: int, road: Straight) -> bool:
    """`AbstractLane.on_lane` with a margin of 1 m."""
    beside = abs(y - lane * road.lane_width)
    return beside <= road.lane_width / 2 + 1 and -5.0 <= x < road.road_length + 5.0


def neighbours(scene: Scene, i: int, lane: int) -> tuple[int, int]:
    """Leader and follower of vehicle i on a lane, -1 for nobody [`Road.neighbour_vehicles`]."""
    x, y = scene.x[0], scene.y[0]
    leader = follower = -1
    for j in range(x.size):
        if j == i or not is_on_lane(x[j], y[j], lane, scene.road):
            continue
        if x[i] <= x[j] and (leader < 0 or x[j] <= x[leader]):
            leader = j
        if x[j] < x[i] and (follower < 0 or x[j] > x[follower]):
            follower = j
    return leader, follower


def velocity(scene: Scene, i: int) -> np.ndarray:
    heading = scene.heading[0, i]
    return scene.speed[0, i] * np.array([math.cos(heading), math.sin(heading)])


def planar_ttc(scene: Scene, i: int) -> float:
    """When vehicle i would touch another vehicle, within 10 s; infinite if it would not.

    Two rectangles overlap while the way between their centres lies in the convex hull of the
    differences of their corners (their Minkowski difference).
    """
    times = [math.inf]
    signs = np.array([(x, y) for x in (-1, 1) for y in (-1, 1)])

    def turned(j: int) -> np.ndarray:
        angle = scene.heading[0, j]
        matrix = [[math.cos(angle), -math.sin(angle)], [math.sin(angle), math.cos(angle)]]
        corners = signs * [scene.length[0, j] / 2, scene.width[0, j] / 2]
        return corners @ np.transpose(matrix)

    for j in range(scene.x.shape[1]):
        if j == i:
            continue
        differences = (turned(i)[:, None] - turned(j)[None]).reshape(-1, 2)
        sides = ConvexHull(differences).equations  # outside if normal . point + offset > 0
        way = np.array([scene.x[0, j] - scene.x[0, i], scene.y[0, j] - scene.y[0, i]])
        begin, end = 0.0, math.inf
        for *normal, offset in sides:
            distance = normal @ way + offset
            speed = normal @ (velocity(scene, j) - velocity(scene, i))
            if speed < 0:
                begin = max(begin, distance / -speed)
            elif speed > 0:
                end = min(end, -distance / speed)
            elif distance > 0:
                end = -math.inf
        times.append(begin if begin <= end and begin <= 10 else math.inf)
    return min(times)


def neighbours_observation(scene: Scene, i: int) -> np.ndarray:
    """The observation `neighbours` of vehicle i, (7, 5)."""
    rows = np.zeros((7, 5))
    rows[0] = [1, 1, scene.y[0, i] / 12, *velocity(scene, i) / 66]
    row = 1
    for lane in (scene.lane[0, i] - 1, scene.lane[0, i], scene.lane[0, i] + 1):
        found = neighbours(scene, i, lane) if 0 <= lane < scene.road.lanes else (-1, -1)
        for j in found:
            dx = scene.x[0, j] - scene.x[0, i]
            if j >= 0 and abs(dx) <= 99:
                dy = scene.y[0, j] - scene.y[0, i]
                dv = velocity(scene, j) - velocity(scene, i)
                rows[row] = [1, *np.clip([dx / 165, dy / 12, *dv / 66], -1, 1)]
            row += 1
    return rows


def paper_observation(scene: Scene, i: int) -> np.ndarray:
    """The observation `paper_neighbours` of vehicle i, (7, 5)."""
    x, y, lane = scene.x[0], scene.y[0], scene.lane[0]
    rows = np.zeros((7, 5))
    rows[0] = [1, min(x[i] / 165, 1), y[i] / 12, *velocity(scene, i) / 66]
    in_range = [j for j in range(x.size) if j != i and math.hypot(x[j] - x[i], y[j] - y[i]) < 99]
    for side in (-1, 0, 1):
        beside = [j for j in in_range if lane[j] - lane[i] == side]
        ahead = [j for j in beside if x[j] > x[i]]
        behind = [j for j in beside if x[j] <= x[i]]
        for row, found in ((3 + 2 * side, ahead), (4 + 2 * side, behind)):
            if found:
                j = min(found, key=lambda j: abs(x[j] - x[i]))
                dv = velocity(scene, j) - velocity(scene, i)
                place = [(x[j] - x[i]) / 165, (y[j] - y[i]) / 12]
                rows[row] = [1, *np.clip([*place, *dv / 66], -1, 1)]
    return rows


def distance(scene: Scene, i: int, j: int) -> float:
    """The bumper gap from vehicle i to vehicle j ahead, and one of the profile's lengths.

    The lengths come last and together, so that tiny distances survive.
    """
    lengths = (scene.length[0, i] + scene.length[0, j]) / 2 - scene.constants.length
    return scene.x[0, j] - scene.x[0, i] - lengths


def desired_gap(driver: Driver, i: int, j: int) -> float:
    """[`IDMVehicle.desired_gap`]"""
    scene, p, _ = driver
    direction = np.array([math.cos(scene.heading[0, i]), math.sin(scene.heading[0, i])])
    closing = (velocity(scene, i) - velocity(scene, j)) @ direction
    speed = scene.speed[0, i]
    dynamic = speed * closing / (2 * math.sqrt(p.acceleration_mps2 * p.deceleration_mps2))
    gap = p.jam_distance_m + speed * p.time_headway_s + dynamic
    return gap if p.least_gap_m is None else max(gap, p.least_gap_m)


def idm_acceleration(driver: Driver, i: int, leader: int) -> float:
    """IDM acceleration of vehicle i behind a leader; -1 is nobody [`IDMVehicle.acceleration`]."""
    scene, p, exponent = driver
    if i < 0:
        return 0.0
    wanted = np.clip(scene.target_speed[0, i], 0, scene.road.speed_limit)
    acceleration = p.acceleration_mps2 * (1 - (max(scene.speed[0, i], 0) / wanted) ** exponent)
    if leader >= 0:
        gap = distance(scene, i, leader)
        gap = gap if abs(gap) > 0.01 else math.copysign(0.01, gap)
        acceleration -= p.acceleration_mps2 * (desired_gap(driver, i, leader) / gap) ** 2
    return float(acceleration)


def mobil(driver: Driver, i: int, lane: int) -> bool:
    """Whether MOBIL changes to a lane [`IDMVehicle.mobil`]."""
    scene, p, _ = driver
    leader, follower = neighbours(scene, i, scene.lane[0, i])
    new_leader, new_follower = neighbours(scene, i, lane)
    imposed = idm_acceleration(driver, new_follower, i)
    if imposed < -p.imposed_braking_mps2:
        return False
    own = idm_acceleration(driver, i, new_leader) - idm_acceleration(driver, i, leader)
    new = imposed - idm_acceleration(driver, new_follower, new_leader)
    old = idm_acceleration(driver, follower, leader) - idm_acceleration(driver, follower, i)
    return own + p.politeness * (new + old) >= p.lane_change_gain_mps2


def idm_mobil(scene: Scene) -> tuple[list[float], list[int]]:
    """Accelerations and target lanes of all vehicles [`IDMVehicle.act`]."""
    road, p = scene.road, scene.constants.idm_mobil
    lanes, targets = scene.lane[0], [int(lane) for lane in scene.target_lane[0]]
    accelerations = []
    for i in range(len(targets)):
        if scene.crashed[0, i]:
            accelerations.append(0.0)
            continue
        exponent = p.exponent_low + scene.temperament[0, i] * (p.exponent_high - p.exponent_low)
        driver = (scene, p, exponent)
        if lanes[i] != targets[i]:
            for j in range(len(targets)):
                rival = targets[j] == targets[i] != lanes[j]
                if j != i and rival and 0 < distance(scene, i, j) < desired_gap(driver, i, j):
                    targets[i] = int(lanes[i])
                    break
        elif scene.timer_s[0, i] > p.lane_change_period_s and scene.speed[0, i] >= 1:
            for side in (lanes[i] - 1, lanes[i] + 1):
                near = abs(scene.y[0, i] - side * road.lane_width) <= 2 * road.lane_width
                on_length = 0 <= scene.x[0, i] < road.road_length + 5.0
                if 0 <= side < road.lanes and near and on_length and mobil(driver, i, side):
                    targets[i] = int(side)
        wanted = [
            idm_acceleration(driver, i, neighbours(scene, i, lane)[0])
            for lane in (lanes[i], targets[i])
        ]
        limit = p.acceleration_limit_mps2
        accelerations.append(float(np.clip(min(wanted), -limit, limit)))
    return accelerations, targets


def stackelberg(scene: Scene, i: int) -> tuple[float, int]:
    """Acceleration and target lane of a vehicle by the Stackelberg game, with default options."""
    p = scene.constants.idm_mobil._replace(acceleration_mps2=3.0, deceleration_mps2=4.0)
    driver = (scene, p, 4.0)
    lane, target = int(scene.lane[0, i]), int(scene.target_lane[0, i])
    if scene.crashed[0, i]:
        return 0.0, target

    def utility(on: int) -> float:
        leader, _ = neighbours(scene, i, on)
        gap = distance(scene, i, leader)
        return 1.0 if leader < 0 else gap / 200 + scene.speed[0, leader] / 66

    def is_open(on: int) -> bool:
        leader, follower = neighbours(scene, i, on)
        if follower < 0 or distance(scene, follower, i) > 50:
            return True
        before = idm_acceleration(driver, follower, leader)
        return before - idm_acceleration(driver, follower, i) <= 1

    if lane == target:
        best = utility(lane) + 0.1
        for side in (lane - 1, lane + 1):
            if 0 <= side < scene.road.lanes and utility(side) > best and is_open(side):
                best, target = utility(side), side
    wanted = [idm_acceleration(driver, i, neighbours(scene, i, on)[0]) for on in (lane, target)]
    return float(np.clip(min(wanted), -4.0, 3.0)), target


Decision = tuple[float, int, float | None]
"""The ego's speed, its lane, and the distance between centres to its leader, if there is one."""


def counts_of_smoothness(
    episodes: list[tuple[bool, list[Decision]]], rate: int, first: int
) -> dict[str, list[float]]:
    """Numbers by metric, over episodes that end with a collision or not: of what, and of how many.

    Decisions count from the number `first` on, counted from 1, without that of a collision.
    """
    accelerations, strong, reversals, changes, undone, near, short, decisions = (
        [],
        0,
        0,
        0,
        0,
        0,
        0,
        0,
    )
    for collides, rows in episodes:
        end, direction = len(rows) - collides, 0
        for k in range(end):
            speed, lane, ahead = rows[k]
            if k + 1 < first:
                continue
            decisions += 1
            if ahead is not None and ahead <= 100.0:
                near += 1
                short += ahead < speed
            if k == 0:
                continue
            acceleration = (speed - rows[k - 1][0]) * rate
            accelerations.append(acceleration)
            strong += abs(acceleration) > 1.1
            towards = (acceleration > 0.3) - (acceleration < -0.3)
            reversals += towards * direction < 0
            direction = towards or direction
            if lane != rows[k - 1][1]:
                changes += 1
                for later in range(k + 1, end):
                    if rows[later][1] != lane:
                        undone += rows[later][1] == rows[k - 1][1] and later - k <= 5 * rate
                        break
    return {
        "mean_acceleration_std": accelerations,
        "strong_acceleration_rate": [strong, len(accelerations)],
        "acceleration_reversals_per_min": [60 * rate * reversals, len(accelerations)],
        "lane_changes_undone": [undone, changes],
        "centre_headway_below_1s": [short, near],
    }


def completed_safety(scene: Scene, i: int, horizon_s: float, loses_mps: float) -> float:
    """The completed r_s of vehicle i, from times to collision if vehicles ahead lose speed."""
    lane, target = scene.lane[0, i], scene.target_lane[0, i]

    def safe(behind: int, ahead: int) -> float:
        if -1 in (behind, ahead):
            return 1.0
        bumpers = (scene.length[0, behind] + scene.length[0, ahead]) / 2
        gap = scene.x[0, ahead] - scene.x[0, behind] - bumpers
        closing = velocity(scene, behind)[0] - (velocity(scene, ahead)[0] - loses_mps)
        if gap <= 0:
            return 0.0
        return 1.0 if closing <= 0 else min(float(gap) / float(closing) / horizon_s, 1.0)

    leader, follower = neighbours(scene, i, target)
    if lane == target:
        return safe(i, leader)
    left = safe(i, neighbours(scene, i, lane)[0])
    return min((safe(i, leader) + safe(follower, i)) / 2, left)
