"""A generated network: a grid of streets with a lane in each direction, and junctions."""

import math
from collections.abc import Iterator
from itertools import product

from charms_bench.world.road_network import CircularLane, Lane, Network, StraightLane, network_of

BLOCK_M, HALF_M, WIDTH_M = 100.0, 10.0, 4.0
"""Between the centres of junctions; from a centre to its stop lines; of a lane."""
Way = tuple[int, int]
WAYS: tuple[Way, ...] = ((1, 0), (0, 1), (-1, 0), (0, -1))
SPEED = {"speed_limit": 15.0, "width": WIDTH_M}


def city(blocks: int) -> Network:
    """A grid of `blocks` x `blocks` junctions; 12 lanes in each, and 2 between two of them."""
    return network_of(lane for each in product(range(blocks), repeat=2) for lane in _at(*each))


def _at(column: int, row: int) -> Iterator[tuple[str, str, Lane]]:
    """The lanes that lead from a junction, and those in it."""
    x, y = column * BLOCK_M, row * BLOCK_M
    for k, (dx, dy) in enumerate(WAYS):
        side = -dy * WIDTH_M / 2, dx * WIDTH_M / 2  # on the right of the street
        here = f"from {column} {row} {k}"
        there = f"to {column + dx} {row + dy} {k}"
        start = x + dx * HALF_M + side[0], y + dy * HALF_M + side[1]
        length = BLOCK_M - 2 * HALF_M
        end = start[0] + dx * length, start[1] + dy * length
        yield here, there, StraightLane(start=start, end=end, **SPEED)
        before = x - dx * HALF_M + side[0], y - dy * HALF_M + side[1]
        arrival = f"to {column} {row} {k}"
        yield arrival, here, StraightLane(start=before, end=start, **SPEED)
        for turn, radius in ((1, HALF_M - WIDTH_M / 2), (-1, HALF_M + WIDTH_M / 2)):
            centre = before[0] - turn * dy * radius, before[1] + turn * dx * radius
            phase = math.atan2(before[1] - centre[1], before[0] - centre[0])
            arc = CircularLane(
                center=centre,
                radius=radius,
                start_phase=phase,
                end_phase=phase + turn * math.pi / 2,
                clockwise=turn > 0,
                **SPEED,
            )
            yield arrival, f"from {column} {row} {(k + turn) % 4}", arc
