"""A road as data: lanes between named nodes, and what stands on them."""

from collections.abc import Iterable, Iterator, Sequence
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from charms_bench.foundation.arrays import Ints
from charms_bench.roads.scenes import OBSTACLE, OBSTACLE_SIZE_M, ROUTE_STEPS
from charms_bench.world.road_network import (
    NO_LINE,
    SOLID_LINE,
    STRIPED,
    Lane,
    StraightLane,
    network_of,
)

WIDTH_M = 4.0
"""[`AbstractLane.DEFAULT_WIDTH`]"""
Edge = tuple[str, str, Lane]
"""The names of the nodes at the start and at the end of a lane, and the lane."""
LaneName = tuple[str, str, int]
"""highway-env's name of a lane: two nodes and a number."""


class RoadObject(NamedTuple):
    """An obstacle or a landmark, which does not move; SI units [`RoadObject`]."""

    x: float
    y: float
    heading: float = 0.0
    length: float = OBSTACLE_SIZE_M
    width: float = OBSTACLE_SIZE_M
    kind: int = OBSTACLE
    """An index into `scenes.KINDS`."""


class Layout:
    """The lanes of a road, in the order of highway-env's calls of `add_lane` [`RoadNetwork`]."""

    def __init__(self, edges: Iterable[Edge]) -> None:
        described = list(edges)
        self.graph: dict[str, dict[str, int]] = {}
        """How many lanes lead from a node to another."""
        for start, end, _ in described:
            ends = self.graph.setdefault(start, {})
            ends[end] = ends.get(end, 0) + 1
        names = [
            (start, end, number)
            for start, ends in self.graph.items()
            for end, count in ends.items()
            for number in range(count)
        ]
        self.lanes: dict[LaneName, int] = {name: lane for lane, name in enumerate(names)}
        """The indices of the lanes by their names."""
        self.network = network_of(described)
        """The table of lanes."""

    def shortest_path(self, start: str, goal: str) -> list[str]:
        """The nodes of the first of the shortest ways between two nodes; empty if there is none.

        [`RoadNetwork.shortest_path`]
        """
        paths, seen = [[start]], {start}
        for path in paths:
            for node in sorted(self.graph.get(path[-1], {}).keys() - seen):
                if node == goal:
                    return [*path, node]
                seen.add(node)
                paths.append([*path, node])
        return []

    def routes_to(self, destinations: Sequence[str]) -> Ints:
        """The routes [D, L, 1 + R] from the ends of lanes to nodes.

        The first number is that of the steps after the lane itself, and each step is the first lane
        of a road [`ControlledVehicle.plan_route_to`].
        """
        shape = len(destinations), len(self.lanes), 1 + ROUTE_STEPS
        routes = np.zeros(shape, dtype=np.int64)
        for d, destination in enumerate(destinations):
            for (_, end, _), lane in self.lanes.items():
                path = self.shortest_path(end, destination)
                steps = [self.lanes[*nodes, 0] for nodes in pairwise(path)]
                routes[d, lane, : 1 + len(steps)] = len(steps), *steps
        return routes


def straight_lanes(
    start: str, end: str, count: int, x: float, length: float, speed_limit: float = 30.0
) -> Iterator[tuple[str, str, StraightLane]]:
    """Parallel lanes from x on, the leftmost at y = 0 [`RoadNetwork.straight_road_network`]."""
    for k in range(count):
        y = WIDTH_M * k
        left = STRIPED if k else SOLID_LINE
        right = NO_LINE if k < count - 1 else SOLID_LINE
        lane = StraightLane(
            start=(x, y), end=(x + length, y), line_types=(left, right), speed_limit=speed_limit
        )
        yield start, end, lane
