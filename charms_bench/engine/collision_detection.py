"""The collision test: which vehicles touch, and how far apart the impact pushes them."""

import math

import numpy as np

from charms_bench.foundation.compiled import compiled, index
from charms_bench.world.scene import Bools, Floats, Scene

USUAL_SPEED_MPS = 50.0
"""Up to this speed, collisions are searched as if every vehicle had it; the result is the same."""


@compiled
def collide(scene: Scene, first: int, after: int, apart: Bools | None = None) -> None:
    """Finds the collisions of pairs [`Road.step`, `RoadObject.handle_collisions`].

    Two vehicles that are both marked in `apart` [B, N] do not collide; without it, no code is
    compiled that asks [`RoadObject.check_collisions`].

    Pairs are found along `order`, but applied in highway-env's order, that of entry: a later impact
    replaces an earlier one.
    """
    c, vehicles = scene.constants, scene.x.shape[1]
    hits = np.empty((vehicles, 6))
    corners = np.empty((2, 4, 2))
    standard = math.sqrt(c.length**2 + c.width**2)
    length, width = scene.length, scene.width
    x, y, heading, speed = scene.x, scene.y, scene.heading, scene.speed
    direction_x, direction_y = scene.direction_x, scene.direction_y
    order, entry = scene.order, scene.entry
    for row in range(first, after):
        b = index(row)
        fastest = USUAL_SPEED_MPS
        is_faster = False
        for i in range(vehicles):
            is_faster |= abs(speed[b, i]) > fastest
        if is_faster:
            fastest = np.abs(speed[b]).max()
        largest = standard
        if c.mixed_sizes:
            largest = math.sqrt(length[b].max() ** 2 + width[b].max() ** 2)
        reach = largest + fastest * c.dt
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
                if apart is not None and apart[b, near] and apart[b, far]:
                    continue
                # A margin, so that rounding does not decide whether they touch.
                beside = (width[b, near] + width[b, far]) / 2 + 1e-6
                if heading[b, near] == 0.0 and heading[b, far] == 0.0 and abs(dy) > beside:
                    continue  # side by side and straight, so they are apart across the road
                i, j = (near, far) if entry[b, near] < entry[b, far] else (far, near)
                diagonal = math.sqrt(length[b, i] ** 2 + width[b, i] ** 2)
                other_diagonal = math.sqrt(length[b, j] ** 2 + width[b, j] ** 2)
                distance = math.sqrt(dx * dx + dy * dy)
                if distance > (diagonal + other_diagonal) / 2 + speed[b, i] * c.dt:
                    continue
                for corner, v in enumerate((i, j)):
                    cos, sin = direction_x[b, v], direction_y[b, v]
                    size = length[b, v], width[b, v]
                    fill_polygon(x[b, v], y[b, v], cos, sin, *size, corners[corner])
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
    """Applies the collisions of scene b, pair by pair in the order in which vehicles entered.

    Each row of `hits` is (place, place, now, soon, translation), with the first to enter first.
    """
    # There are few pairs, and NumPy's sorting would take longer to compile than this function.
    entry, last, last_other = scene.entry[b], -1, -1
    for _ in range(len(hits)):
        hit, first, second = -1, 0, 0
        for each in range(len(hits)):
            own, other = entry[int(hits[each, 0])], entry[int(hits[each, 1])]
            is_later = own > last or (own == last and other > last_other)
            if is_later and (hit < 0 or own < first or (own == first and other < second)):
                hit, first, second = each, own, other
        last, last_other = first, second
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
def fill_polygon(
    x: float, y: float, cos: float, sin: float, length: float, width: float, corners: Floats
) -> None:
    """Writes a vehicle's corners (4, 2) [`RoadObject.polygon` without the repeated corner]."""
    for corner in range(4):
        ahead = -length / 2 if corner < 2 else length / 2
        aside = -width / 2 if corner in (0, 3) else width / 2
        corners[corner, 0] = cos * ahead - sin * aside + x
        corners[corner, 1] = sin * ahead + cos * aside + y


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
