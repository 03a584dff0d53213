"""The road file: a road map as JSON. Its format is described in docs/maps.md."""

import json
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Field, ValidationError

from charms_bench.errors import MapError, first_problem
from charms_bench.foundation.fields import (
    Duration,
    Finite,
    FrozenModel,
    Line,
    NonNegative,
    Positive,
)
from charms_bench.foundation.files import read_limited, write_bytes
from charms_bench.maps.assembly import WIDEST_LANE_M, check_lanes
from charms_bench.maps.bridging import touch
from charms_bench.maps.conflicts import conflicts_of
from charms_bench.maps.nodes import turns_back
from charms_bench.maps.road_map import (
    Conflict,
    Exact,
    Gap,
    MapLane,
    MapRoad,
    RoadMap,
    Signal,
)
from charms_bench.maps.sampling import lengths_of
from charms_bench.maps.shapes import points_of
from charms_bench.world.road_network import CircularLane, SineLane, StraightLane

VERSION = 1
KEY = "charms_bench_road"
LIMIT_BYTES = 2**28
_ALONG_M = 1.0
"""How far beyond its lane's end a conflict may be, from rounding."""
Point = Annotated[tuple[Finite, Finite], Field(strict=False)]
Numbers = Annotated[tuple[Finite, ...], Field(strict=False)]
Pairs = Annotated[tuple[Line, Line], Field(strict=False)]
Names = Annotated[tuple[Line, ...], Field(strict=False)]
Width = Annotated[float, Field(ge=0, le=WIDEST_LANE_M)]
Phase = Annotated[tuple[Duration, Literal["green", "red"]], Field(strict=False)]


class _Lane(FrozenModel):
    id: Annotated[Line, Field(min_length=1)]
    """A name that no other lane has."""
    speed_limit: Annotated[float, Field(gt=0, le=1000)] | None = None
    """m/s; none if the map states none."""
    type: Line = "driving"
    """What the map calls the lane."""
    successors: Names = ()
    """The ids of the lanes that follow; their roads start at the node at which this road ends."""


class PolylineLane(_Lane):
    """A lane along points, in metres; all lists are as long."""

    kind: Literal["polyline"]
    x: Numbers
    """Of the centre line, from where vehicles enter."""
    y: Numbers
    """To the right of x."""
    z: Numbers = ()
    """Heights; without them, 0."""
    width: Annotated[tuple[Width, ...], Field(strict=False, min_length=2)]
    """Of the lane at each point."""


class _ExactLane(_Lane):
    width: Width = 4.0
    """m."""
    z: Point = (0.0, 0.0)
    """Heights of the start and the end, m."""


class StraightFileLane(_ExactLane):
    """A straight lane."""

    kind: Literal["straight"]
    start: Point
    """[x, y], m."""
    end: Point
    """[x, y], m."""


class SineFileLane(_ExactLane):
    """A lane that swings about the line from its start to its end."""

    kind: Literal["sine"]
    start: Point
    """[x, y] of the line, m."""
    end: Point
    """[x, y] of the line, m."""
    amplitude: Finite
    """m."""
    pulsation: Finite
    """rad/m."""
    phase: Finite
    """rad."""


class CircularFileLane(_ExactLane):
    """An arc of less than half a turn."""

    kind: Literal["circular"]
    center: Point
    """[x, y], m."""
    radius: Positive
    """m."""
    start_phase: Finite
    """The angle from the centre to the start, rad; from x towards y."""
    end_phase: Finite
    """The angle to the end; above `start_phase` if `clockwise`, else below."""
    clockwise: bool
    """Whether vehicles turn to the right."""


FileLane = Annotated[
    PolylineLane | StraightFileLane | SineFileLane | CircularFileLane, Field(discriminator="kind")
]


class FileRoad(FrozenModel):
    """Parallel lanes in one direction between two nodes; no other road has the same two."""

    start: Annotated[Line, Field(min_length=1)]
    """The node at which the road starts."""
    end: Annotated[Line, Field(min_length=1)]
    """The node at which it ends, and at which the roads that follow start."""
    lanes: Annotated[tuple[FileLane, ...], Field(strict=False, min_length=1)]
    """From the left to the right: neighbours in this list are neighbours on the road. A lane is at
    most 1,000 km long, all lanes together 100,000 km."""
    junction: Line = ""
    """The junction that the road is in."""
    roundabout: bool = False
    """Whether the road is in a roundabout."""


class FileConflict(FrozenModel):
    """Where two lanes cross or merge at one level."""

    lanes: Pairs
    """Two ids."""
    at: Annotated[tuple[NonNegative, NonNegative], Field(strict=False)]
    """How far along each lane, m."""
    kind: Literal["crossing", "merging"]
    """How the lanes meet."""
    gives_way: Line = ""
    """The lane whose vehicles give way; empty if the map does not say."""


class FileSignal(FrozenModel):
    """A traffic light or a sign."""

    id: Line
    """The map's name."""
    kind: Literal["light", "sign"]
    """What it is."""
    x: Finite
    """m."""
    y: Finite
    """m."""
    code: Line = ""
    """What the map calls it, such as the number of a sign."""
    lanes: Names = ()
    """The ids of the lanes for which it is: vehicles stop at their ends, or before those in a
    junction, if only some of the ways from a lane have this light."""
    program: Annotated[tuple[Phase, ...], Field(strict=False)] = ()
    """How long the light is `green` or `red`, s, such as `[[20, "green"], [25, "red"]]`; it begins
    with an episode and is repeated. Without a program, vehicles do not look at the light."""


class FileGap(FrozenModel):
    """Where linked lanes did not touch in the map."""

    lanes: Pairs
    """The lane before the gap and the one behind it."""
    length: NonNegative
    """m."""
    bridge: Annotated[tuple[Line, ...], Field(strict=False, min_length=1)]
    """The ids of the lane over the gap, or of its parts: a cubic Hermite curve."""


class RoadFile(FrozenModel):
    """The whole of a road file."""

    charms_bench_road: Literal[1]
    """The version of the format."""
    name: Line = ""
    """A title."""
    format: Line = ""
    """The format of the map that the file was made of."""
    origin: Point = (0.0, 0.0)
    """The map's coordinates of (0, 0): a point (x, y) of the file is at (origin[0] + x, origin[1] -
    y) in the map."""
    left_hand_traffic: bool = False
    """Whether vehicles keep to the left."""
    junctions: Names = ()
    """The names of the junctions."""
    left_out: Annotated[dict[str, int], Field(default_factory=dict)]
    """How many lanes, and programs of lights, of the map are not in the file, by the reason."""
    roads: Annotated[tuple[FileRoad, ...], Field(strict=False, min_length=1)]
    """All roads."""
    conflicts: Annotated[tuple[FileConflict, ...], Field(strict=False)] | None = None
    """Where lanes cross or merge; without this key, they are looked for."""
    signals: Annotated[tuple[FileSignal, ...], Field(strict=False)] = ()
    """Traffic lights and signs."""
    gaps: Annotated[tuple[FileGap, ...], Field(strict=False)] = ()
    """The gaps that were bridged."""


def write_road(road: RoadMap, path: str | Path) -> None:
    """Writes a road map into a road file; raises a `RunFolderError` if that is not possible."""
    head = {
        KEY: VERSION,
        "name": road.name,
        "format": road.format,
        "origin": list(road.origin),
        "left_hand_traffic": road.left_hand_traffic,
        "junctions": list(road.junctions),
        "left_out": dict(road.left_out),
    }
    lines = [f"  {json.dumps(key)}: {_text(value)}" for key, value in head.items()]
    roads = []
    for each in road.roads:
        lanes = ",\n".join(f"      {_text(_described(lane))}" for lane in each.lanes)
        roads.append(f'    {_text(_given(each, "lanes"))[:-1]}, "lanes": [\n{lanes}]}}')
    lines.append('  "roads": [\n' + ",\n".join(roads) + "\n  ]")
    several = {"conflicts": road.conflicts, "signals": road.signals, "gaps": road.gaps}
    for key, items in several.items():
        inner = ",\n".join(f"    {_text(_given(each))}" for each in items)
        lines.append(f'  "{key}": [' + (f"\n{inner}\n  ]" if inner else "]"))
    write_bytes(Path(path), ("{\n" + ",\n".join(lines) + "\n}\n").encode())


def _text(value: object) -> str:
    return json.dumps(value, ensure_ascii=False)


def _given(item: Any, *without: str) -> dict[str, Any]:
    """The fields of a dataclass but for empty ones."""
    return {
        name: value
        for name, value in vars(item).items()
        if value not in ("", ()) and value is not False and name not in without
    }


def _described(lane: MapLane) -> dict[str, Any]:
    points, exact = lane.points, lane.exact
    found: dict[str, Any] = {"id": lane.id}
    heights = points[:, 2]
    if exact is None:
        found |= {"kind": "polyline", "x": points[:, 0].tolist(), "y": points[:, 1].tolist()}
        found |= {"z": heights.tolist()} if heights.any() else {}
        found["width"] = points[:, 3].tolist()
    else:
        found["kind"] = next(kind for kind, (_, of) in _EXACT.items() if type(exact) is of)
        found |= {name: getattr(exact, name) for name in (*_EXACT[found["kind"]][0], "width")}
        found |= {"z": heights[[0, -1]].tolist()} if heights.any() else {}
    found |= {} if lane.speed_limit is None else {"speed_limit": lane.speed_limit}
    return found | {"type": lane.type, "successors": list(lane.successors)}


_EXACT: dict[str, tuple[tuple[str, ...], type[Exact]]] = {
    "straight": (("start", "end"), StraightLane),
    "sine": (("start", "end", "amplitude", "pulsation", "phase"), SineLane),
    "circular": (("center", "radius", "start_phase", "end_phase", "clockwise"), CircularLane),
}
"""The fields of the shapes that are not polylines, and their classes."""


def read_road_file(path: Path) -> RoadMap:
    """The road map in a road file.

    Raises:
        MapError: The file is not a road file, or what it says does not fit together. It does not
            name the file.
        OSError: The file cannot be read.
    """
    data = read_limited(path, LIMIT_BYTES)
    try:
        file = RoadFile.model_validate_json(data)
    except ValidationError as error:
        where, what = first_problem(error)
        if not where:  # not JSON, or not an object; what was found is the whole file
            what = what.partition(", found ")[0]
        raise MapError(f"{'.'.join(map(str, where))}: {what}".removeprefix(": ")) from error
    roads = tuple(
        MapRoad(
            each.start,
            each.end,
            tuple(_lane(lane, f"roads.{k}.lanes.{n}") for n, lane in enumerate(each.lanes)),
            each.junction,
            each.roundabout,
        )
        for k, each in enumerate(file.roads)
    )
    _check(file, roads)
    return RoadMap(
        name=file.name,
        format=file.format,
        roads=roads,
        origin=file.origin,
        left_hand_traffic=file.left_hand_traffic,
        junctions=file.junctions,
        conflicts=tuple(
            conflicts_of(roads, set())
            if file.conflicts is None
            else (
                Conflict(each.lanes, each.at, each.kind, each.gives_way) for each in file.conflicts
            )
        ),
        signals=tuple(
            Signal(each.id, each.kind, each.x, each.y, each.code, each.lanes, each.program)
            for each in file.signals
        ),
        gaps=tuple(Gap(each.lanes, each.length, each.bridge) for each in file.gaps),
        left_out=file.left_out,
    )


def _lane(lane: Any, where: str) -> MapLane:
    """The lane of a map, from one of a file."""
    exact: Exact | None = None
    if lane.kind == "polyline":
        lists = (lane.x, lane.y, lane.z or (0.0,) * len(lane.x), lane.width)
        if len({*map(len, lists)}) != 1:
            counts = ", ".join(str(len(each)) for each in lists)
            raise MapError(f"{where}: x, y, z and width have {counts} numbers; expected as many")
        points = np.array(lists).T
        if (np.diff(lengths_of(points)) <= 0).any():
            raise MapError(f"{where}: two points that follow each other are the same")
    else:
        names, kind = _EXACT[lane.kind]
        values = {name: getattr(lane, name) for name in names}
        exact = kind(**values, width=lane.width)
        problem = _problem(exact)
        if problem:
            raise MapError(f"{where}: {problem}")
        points = points_of(exact, lane.z)
    found = MapLane(lane.id, points, exact, lane.speed_limit, lane.type, lane.successors)
    if turns_back(found):
        raise MapError(
            f"{where}: turns back, so that positions along it are not found; make its road several "
            "roads, one after the other"
        )
    return found


def _problem(exact: Exact) -> str:
    """What is wrong with a shape; empty if nothing is."""
    if isinstance(exact, CircularLane):
        turn = (exact.end_phase - exact.start_phase) * (1 if exact.clockwise else -1)
        if not 0 < turn < np.pi:
            return f"turns by {turn:g} rad; expected more than 0 and less than half a turn"
    elif exact.start == exact.end:
        return "starts where it ends"
    return ""


def _check(file: RoadFile, roads: tuple[MapRoad, ...]) -> None:
    """Raises a `MapError` if the parts of a file do not fit together."""
    road_of: dict[str, MapRoad] = {}
    lane_of: dict[str, MapLane] = {}
    place_of: dict[str, str] = {}
    seen: dict[tuple[str, str], int] = {}
    for k, road in enumerate(roads):
        if seen.setdefault((road.start, road.end), k) != k:
            raise MapError(
                f"roads.{k}: leads from node {road.start!r} to {road.end!r} as roads."
                f"{seen[road.start, road.end]} does; make them one road, or give one a node between"
            )
        for n, lane in enumerate(road.lanes):
            if lane.id in road_of:
                raise MapError(f"roads.{k}.lanes.{n}.id: another lane is named {lane.id!r}")
            road_of[lane.id], lane_of[lane.id] = road, lane
            place_of[lane.id] = f"roads.{k}.lanes.{n}"
    check_lanes(roads, place_of)
    for k, road in enumerate(roads):
        for n, lane in enumerate(road.lanes):
            for name in lane.successors:
                where = f"roads.{k}.lanes.{n}.successors"
                if name not in road_of:
                    raise MapError(f"{where}: there is no lane {name!r}")
                if road_of[name].start != road.end:
                    raise MapError(
                        f"{where}: lane {name!r} starts at node {road_of[name].start!r}; "
                        f"expected {road.end!r}, at which this road ends"
                    )
                if not touch(lane.points[-1], lane_of[name].points[0]):
                    end, start = (
                        "({:g}, {:g})".format(*each[:2])
                        for each in (lane.points[-1], lane_of[name].points[0])
                    )
                    raise MapError(f"{where}: lane {name!r} starts at {start}; expected {end}")
    named = [
        *(
            (f"conflicts.{k}", [*each.lanes, each.gives_way])
            for k, each in enumerate(file.conflicts or ())
        ),
        *((f"signals.{k}", each.lanes) for k, each in enumerate(file.signals)),
        *((f"gaps.{k}", [*each.lanes, *each.bridge]) for k, each in enumerate(file.gaps)),
    ]
    for where, names in named:
        for name in names:
            if name and name not in road_of:
                raise MapError(f"{where}: there is no lane {name!r}")
    for k, each in enumerate(file.conflicts or ()):
        if each.gives_way and each.gives_way not in each.lanes:
            raise MapError(f"conflicts.{k}.gives_way: is not one of the two lanes")
        for name, at in zip(each.lanes, each.at, strict=True):
            if at > (length := lane_of[name].length) + _ALONG_M:
                raise MapError(
                    f"conflicts.{k}.at: {at:g} m, but lane {name!r} is {length:g} m long"
                )
