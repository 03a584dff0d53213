"""Small maps, written by hand."""

from collections.abc import Iterable
from pathlib import Path

import numpy as np

from charms_bench.maps.reading import read_road
from charms_bench.maps.road_map import MapLane, RoadMap

LINE = '<geometry s="0" x="{x}" y="{y}" hdg="{heading}" length="{length}"><line/></geometry>'


def read(folder: Path, text: str, name: str = "map.xml") -> RoadMap:
    """The map in a text."""
    path = folder / name
    path.write_text(text, encoding="utf-8")
    return read_road(path)


def same(one: RoadMap, other: RoadMap) -> bool:
    """Whether two maps are the same to the last bit."""
    pairs = zip(one.lanes, other.lanes, strict=True)
    lanes = all(
        vars(a) | {"points": 0} == vars(b) | {"points": 0} and np.array_equal(a.points, b.points)
        for a, b in pairs
    )
    roads = [
        [(each.start, each.end, each.junction, each.roundabout) for each in road.roads]
        for road in (one, other)
    ]
    others = [{k: v for k, v in vars(road).items() if k != "roads"} for road in (one, other)]
    return lanes and roads[0] == roads[1] and others[0] == others[1]


def lanes_of(road: RoadMap) -> dict[str, MapLane]:
    return {lane.id: lane for lane in road.lanes}


def opendrive(*parts: str) -> str:
    """An OpenDRIVE file of roads and junctions."""
    head = '<header revMajor="1" revMinor="6"/>'
    return f"<?xml version='1.0'?>\n<OpenDRIVE>{head}\n" + "\n".join(parts) + "\n</OpenDRIVE>\n"


def road(
    name: str,
    geometry: str | tuple[float, float, float, float],
    sections: str,
    *,
    link: str = "",
    attributes: str = "",
    others: str = "",
    junction: str = "-1",
) -> str:
    """A road; the geometry is XML, or x, y, heading and length of a line."""
    if not isinstance(geometry, str):
        x, y, heading, length = geometry
        geometry = LINE.format(x=x, y=y, heading=heading, length=length)
    return (
        f'<road id="{name}" junction="{junction}" {attributes}>\n<link>{link}</link>\n'
        f"<planView>{geometry}</planView>\n{others}<lanes>{sections}</lanes>\n</road>"
    )


def section(left: str = "", right: str = "", s: float = 0.0) -> str:
    sides = "".join(
        f"<{side}>\n{lanes}</{side}>" for side, lanes in (("left", left), ("right", right)) if lanes
    )
    return f'<laneSection s="{s}">{sides}<center><lane id="0" type="none"/></center></laneSection>'


def lane(
    number: int,
    width: float | str = 3.5,
    kind: str = "driving",
    *,
    before: int | None = None,
    after: int | None = None,
    others: str = "",
) -> str:
    """A lane; before and after are the lanes to which its links lead."""
    links = (("predecessor", before), ("successor", after))
    link = "".join(f'<{tag} id="{to}"/>' for tag, to in links if to is not None)
    if not isinstance(width, str):
        width = polynomial("width", "sOffset", a=width)
    return f'<lane id="{number}" type="{kind}"><link>{link}</link>{width}{others}</lane>\n'


def polynomial(
    tag: str,
    place: str,
    at: float = 0.0,
    a: float = 0.0,
    b: float = 0.0,
    c: float = 0.0,
    d: float = 0.0,
) -> str:
    return f'<{tag} {place}="{at!r}" a="{a!r}" b="{b!r}" c="{c!r}" d="{d!r}"/>'


def sumo(*parts: str) -> str:
    """A SUMO network."""
    return '<net version="1.16">\n' + "\n".join(parts) + "\n</net>\n"


def edge(
    name: str, *shapes: str, ends: tuple[str, str] = ("", ""), attributes: str = "", lane: str = ""
) -> str:
    """An edge with a lane along each shape, from index 0 on."""
    nodes = f'from="{ends[0]}" to="{ends[1]}"' if ends[0] else 'function="internal"'
    lanes = "\n".join(
        f'<lane id="{name}_{k}" index="{k}" speed="13.89" length="1" shape="{shape}" {lane}/>'
        for k, shape in enumerate(shapes)
    )
    return f'<edge id="{name}" {nodes} {attributes}>\n{lanes}\n</edge>'


def connection(
    start: str, end: str, lanes: tuple[int, int] = (0, 0), via: str = "", others: str = ""
) -> str:
    over = f'via="{via}"' if via else ""
    return (
        f'<connection from="{start}" to="{end}" fromLane="{lanes[0]}" toLane="{lanes[1]}" '
        f'{over} {others} dir="s" state="M"/>'
    )


def commonroad(*parts: str) -> str:
    return '<commonRoad commonRoadVersion="2020a">\n' + "\n".join(parts) + "\n</commonRoad>\n"


Points = Iterable[tuple[float, ...]]


def lanelet(name: int, left: Points, right: Points, *others: str) -> str:
    def bound(tag: str, points: Points) -> str:
        inner = "".join(
            "<point>"
            + "".join(f"<{axis}>{value}</{axis}>" for axis, value in zip("xyz", each, strict=False))
            + "</point>"
            for each in points
        )
        return f"<{tag}>{inner}</{tag}>"

    bounds = bound("leftBound", left) + bound("rightBound", right)
    return f'<lanelet id="{name}">\n{bounds}\n' + "\n".join(others) + "\n</lanelet>"
