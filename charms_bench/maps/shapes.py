"""Points along lanes that are straight lines, sines and arcs."""

import numpy as np

from charms_bench.foundation.arrays import Floats
from charms_bench.maps.sampling import stations
from charms_bench.world.lane_geometry import Pair
from charms_bench.world.road_network import CircularLane, SineLane, StraightLane


def points_of(lane: StraightLane | SineLane | CircularLane, heights: Pair) -> Floats:
    """Points (N, 4) of a lane: x, y, height and width; heights are those of its ends."""

    if not isinstance(lane, SineLane | CircularLane):
        ends = zip((lane.start, lane.end), heights, strict=True)
        return np.array([(*end, height, lane.width) for end, height in ends])

    def curve(part: Floats) -> Floats:
        height = heights[0] + (heights[1] - heights[0]) * part
        x, y = _circular(lane, part) if isinstance(lane, CircularLane) else _sine(lane, part)
        points = np.stack([x, y, height, np.full_like(x, lane.width)], axis=1)
        return np.asarray(points[:, None, :])

    return np.asarray(curve(stations(curve, np.linspace(0.0, 1.0, 9)))[:, 0])


def _circular(lane: CircularLane, part: Floats) -> tuple[Floats, Floats]:
    phase = lane.start_phase + (lane.end_phase - lane.start_phase) * part
    x, y = lane.center
    return x + lane.radius * np.cos(phase), y + lane.radius * np.sin(phase)


def _sine(lane: SineLane, part: Floats) -> tuple[Floats, Floats]:
    (x, y), way = lane.start, np.subtract(lane.end, lane.start, dtype=np.float64)
    length = float(np.hypot(*way))
    aside = lane.amplitude * np.sin(lane.pulsation * length * part + lane.phase) / length
    return x + way[0] * part - way[1] * aside, y + way[1] * part + way[0] * aside


def straight(points: Floats) -> StraightLane | None:
    """The straight lane that a polyline (N, 4) of two points and one width is."""
    if len(points) != 2 or points[0, 3] != points[1, 3]:
        return None
    (start_x, start_y), (end_x, end_y) = points[:, :2].tolist()
    return StraightLane(start=(start_x, start_y), end=(end_x, end_y), width=float(points[0, 3]))
