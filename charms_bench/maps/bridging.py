"""Bridges the gaps between linked lanes where a map has no lanes in junctions."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from charms_bench.errors import MapError
from charms_bench.foundation.arrays import Floats
from charms_bench.maps.draft import Draft, Links
from charms_bench.maps.road_map import DECIMALS, Gap, MapLane, MapRoad
from charms_bench.maps.sampling import stations
from charms_bench.maps.shapes import straight

TOUCH_M = 0.5
"""Linked lanes whose ends are closer than this are left as they are in the map, and so are lanes of
different widths whose borders are: a lane that ends where its width is 0 ends beside the next."""
WIDEST_GAP_M = 100.0
"""Wider gaps are a fault of the map."""


def touch(end: Floats, start: Floats) -> bool:
    """Whether a lane that ends at a point (x, y, height, width) touches one that starts there."""
    return bool(np.hypot(*(start - end)[:2]) <= TOUCH_M + abs(end[3] - start[3]) / 2)


def bridged(draft: Draft, roads: Sequence[MapRoad]) -> tuple[Links, list[MapRoad], list[Gap]]:
    """The links with bridges in those of lanes that do not touch, the bridges, and the gaps."""
    lane_of = {lane.id: lane for road in roads for lane in road.lanes}
    links: Links = {}
    bridges, gaps = [], []
    for (one, other), junction in draft.links.items():
        end, start = lane_of[one].points[-1], lane_of[other].points[0]
        if touch(end, start):
            links[one, other] = junction
            continue
        gap = float(np.hypot(*(start - end)[:2]))
        most = WIDEST_GAP_M if (one, other) in draft.open_links else TOUCH_M
        if gap > most:
            raise MapError(
                f"{draft.where[one]}: ends {gap:.2f} m from where the following lane "
                f"{other!r} starts; expected at most {most:g} m"
            )
        bridge = _bridge(lane_of[one], lane_of[other], gap)
        bridges.append(MapRoad("", "", (bridge,), junction or f"gap after {one}"))
        gaps.append(Gap((one, other), round(gap, 3), (bridge.id,)))
        links |= {(one, bridge.id): junction, (bridge.id, other): junction}
    return links, bridges, gaps


def _bridge(one: MapLane, other: MapLane, gap: float) -> MapLane:
    """A cubic Hermite curve between two ends, with tangents as long as the gap."""
    start, end = one.points[-1], other.points[0]
    leaving, arriving = one.points[-1] - one.points[-2], other.points[1] - other.points[0]
    tangents = [gap * each[:2] / np.hypot(*each[:2]) for each in (leaving, arriving)]

    def curve(part: Floats) -> Floats:
        t = (part / gap)[:, None]
        height = t * t * (3 - 2 * t)
        found = start + (end - start) * t
        found[:, :2] = start[:2] * (1 - height) + end[:2] * height
        found[:, :2] += (t * (1 - t) ** 2) * tangents[0] + (t * t * (t - 1)) * tangents[1]
        return np.asarray(found[:, None, :])

    s = stations(curve, np.array([0.0, gap]))
    points = np.round(curve(s)[:, 0], DECIMALS) + 0.0
    points[[0, -1]] = start, end
    # Where it turns back, two points can be one after rounding.
    inside, before = points[1:-1, :2], points[:-2, :2]
    differs = (inside != before).any(axis=1) & (inside != end[:2]).any(axis=1)
    points = points[np.concatenate([[True], differs, [True]])]
    limits = [each.speed_limit for each in (one, other) if each.speed_limit is not None]
    lane = MapLane(f"{one.id}->{other.id}", points, None, min(limits, default=None), one.type)
    return replace(lane, exact=straight(points))
