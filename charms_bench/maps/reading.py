"""Reads a road map in any known format."""

from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np

from charms_bench.errors import MapError, suggestion
from charms_bench.foundation.arrays import Floats
from charms_bench.foundation.files import is_compressed, size_of
from charms_bench.maps.assembly import assembled
from charms_bench.maps.commonroad import read_commonroad
from charms_bench.maps.draft import Draft
from charms_bench.maps.elements import LONGEST_NAME, Element, elements, printable
from charms_bench.maps.opendrive import read_opendrive
from charms_bench.maps.road_file import read_road_file
from charms_bench.maps.road_map import RoadMap
from charms_bench.maps.sumo import read_sumo
from charms_bench.world.lane_geometry import Pair
from charms_bench.world.named_road import ROAD_LIMIT_BYTES

READERS: dict[str, Callable[[Element, Iterator[Element]], Draft]] = {
    "OpenDRIVE": read_opendrive,
    "commonRoad": read_commonroad,
    "net": read_sumo,
}
"""What reads an XML file, by the tag of its root."""


def read_road(
    path: str | Path, *, around: Pair | None = None, radius: float | None = None
) -> RoadMap:
    """The roads of a map, in CommonRoad, OpenDRIVE or SUMO's format, or of a road file.

    Args:
        path: The file; its content says which format it has.
        around: If given, only roads that come within `radius` of this point (x, y) are kept, in
            the coordinates of the map, m.
        radius: m.

    Raises:
        MapError: The file cannot be read; the message names the element and its line.
    """
    path = Path(path)
    given = [*(around or ()), *(() if radius is None else (radius,))]
    if len(given) not in (0, 3) or not np.isfinite(given).all():
        raise MapError("around and radius: expected a point and a distance, or neither")
    try:
        road = _read(path)
        return road if around is None or radius is None else cut(road, around, radius)
    except MapError as error:
        raise MapError(f"{path}: {error}") from error
    except OSError as error:
        raise MapError(f"{path}: cannot be read: {error.strerror}") from error


def _read(path: Path) -> RoadMap:
    if size_of(path) > ROAD_LIMIT_BYTES:
        raise MapError(
            f"larger than {ROAD_LIMIT_BYTES:,} bytes; cut the map with the tools of its format"
        )
    with path.open("rb") as file:
        beginning = file.read(64)
    if is_compressed(beginning):
        raise MapError("is compressed; expected text, so decompress it first")
    if beginning.lstrip(b"\xef\xbb\xbf \t\r\n").startswith(b"{"):
        return read_road_file(path)
    children = elements(path)
    root = next(children)
    if root.tag not in READERS:
        known = suggestion(root.tag[:80], dict.fromkeys(READERS))
        raise MapError(f"line {root.line}: the root is <{root.tag[:80]}>, no known format. {known}")
    return assembled(READERS[root.tag](root, children), printable(path.stem)[:LONGEST_NAME])


def cut(road: RoadMap, around: Pair, radius: float) -> RoadMap:
    """The roads that come within a radius of a point of the map; raises a `MapError` without any.

    Roads are kept as a whole, and what refers to other lanes is left out.
    """
    centre = np.array([around[0] - road.origin[0], road.origin[1] - around[1]])
    roads = [
        each
        for each in road.roads
        if min(_distance(lane.points, centre) for lane in each.lanes) <= radius
    ]
    if not roads:
        nearest = min(_distance(lane.points, centre) for lane in road.lanes)
        where = f"({around[0]:g}, {around[1]:g})"
        raise MapError(
            f"no lane is within {radius:g} m of {where}; the nearest is {nearest:,.0f} m away"
        )
    kept = {lane.id for each in roads for lane in each.lanes}
    inside = {each.junction for each in roads}
    return replace(
        road,
        roads=tuple(
            replace(
                each,
                lanes=tuple(
                    replace(lane, successors=tuple(s for s in lane.successors if s in kept))
                    for lane in each.lanes
                ),
            )
            for each in roads
        ),
        junctions=tuple(name for name in road.junctions if name in inside),
        conflicts=tuple(each for each in road.conflicts if kept.issuperset(each.lanes)),
        signals=tuple(
            replace(each, lanes=tuple(lane for lane in each.lanes if lane in kept))
            for each in road.signals
            if not kept.isdisjoint(each.lanes)
        ),
        gaps=tuple(each for each in road.gaps if kept.issuperset((*each.lanes, *each.bridge))),
    )


def _distance(points: Floats, centre: Floats) -> float:
    """How far a point is from a polyline."""
    start, way = points[:-1, :2], np.diff(points[:, :2], axis=0)
    along = ((centre - start) * way).sum(axis=1) / (way * way).sum(axis=1)
    nearest = start + np.clip(along, 0.0, 1.0)[:, None] * way
    return float(np.hypot(*(nearest - centre).T).min())
