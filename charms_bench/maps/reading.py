"""Reads a road map in any known format."""

from collections.abc import Callable, Iterator
from pathlib import Path

from charms_bench.errors import MapError
from charms_bench.maps.assembly import Draft, assembled
from charms_bench.maps.commonroad import read_commonroad
from charms_bench.maps.elements import Element, elements
from charms_bench.maps.opendrive import read_opendrive
from charms_bench.maps.road_map import RoadMap
from charms_bench.maps.sumo import read_sumo

READERS: dict[str, Callable[[Element, Iterator[Element]], Draft]] = {
    "OpenDRIVE": read_opendrive,
    "commonRoad": read_commonroad,
    "net": read_sumo,
}
"""What reads a file, by the tag of its root."""


def read_road(path: str | Path) -> RoadMap:
    path = Path(path)
    children = elements(path)
    try:
        root = next(children)
        return assembled(READERS[root.tag](root, children), path.stem)
    except MapError as error:
        raise MapError(f"{path}: {error}") from error
