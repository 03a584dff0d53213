"""Reads the recorded vehicles and the planning problems of a CommonRoad scenario.

Where a state is known only within an area or an interval, it is its middle.
"""

import math
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np

from charms_bench.errors import MapError
from charms_bench.foundation.arrays import Floats
from charms_bench.maps.elements import LARGEST, Element, elements, printable
from charms_bench.world.lane_geometry import Pair
from charms_bench.world.recorded_moments import Tracks

NO_VEHICLES = frozenset(["pedestrian", "bicycle", "train", "constructionZone", "roadBoundary"])
"""The types of obstacles that do not drive on lanes of cars."""
SIZES_M = 0.1, 50.0
MOST_STATES = 1_000_000


class Area(NamedTuple):
    """Where a planning problem ends; the coordinates are those of a `RoadMap`."""

    x: float
    """Of its middle, m."""
    y: float
    heading: float
    """Of a vehicle there, rad."""
    before: float
    """How far before its middle it begins, m."""
    corners: tuple[Pair, ...]
    """Of a polygon, or the middle of a circle, m."""
    radius: float = 0.0
    """Of a circle, m; 0 for a polygon."""


class GoalState(NamedTuple):
    """What a vehicle meets together at the end; what is not stated is infinite."""

    frames: Pair
    """From when until when."""
    speeds: Pair
    """m/s."""
    headings: Pair
    """rad."""
    areas: tuple[Area, ...]
    """It is in one of them; if there are none, it can be anywhere."""


class Problem(NamedTuple):
    """A planning problem: a vehicle without a recording, and where it should go."""

    id: str
    x: float
    y: float
    heading: float
    speed: float
    frame: int
    goals: tuple[GoalState, ...]
    """The ego should meet one of them."""
    last: int | None
    """The last frame in which it may get there; None if the file does not say."""


@dataclass(frozen=True, eq=False)
class RecordedScene:
    """What a scenario holds beside its road; see `RoadMap` for the coordinates."""

    rate_hz: float
    """Frames per second."""
    ids: tuple[str, ...]
    """The V vehicles."""
    tracks: Tracks
    """Those of the vehicles."""
    problems: tuple[Problem, ...]
    left_out: Mapping[str, int]
    """How many obstacles are no recorded vehicles, by the reason."""


def read_scene(path: Path, origin: Pair) -> RecordedScene | None:
    """The vehicles and the planning problems of a scenario on a road with this `RoadMap.origin`.

    None if the file has no recorded vehicle. Raises a `MapError` if one has a fault.
    """
    try:
        return _read(path, origin)
    except MapError as error:
        raise MapError(f"{path}: {error}") from error
    except OSError as error:
        raise MapError(f"{path}: cannot be read: {error.strerror}") from error


def _read(path: Path, origin: Pair) -> RecordedScene | None:
    children = elements(path)
    root = next(children)
    if root.tag != "commonRoad":
        return None
    step = root.number("timeStepSize", low=1e-3, high=10.0)
    lanelets: dict[str, Element] = {}
    problems, left_out = [], Counter[str]()
    found: dict[str, tuple[Floats, int, float, float]] = {}
    for element in children:
        if element.tag == "lanelet":
            lanelets[element.get("id")] = element
        elif element.tag == "planningProblem":
            problems.append(element)
        elif element.tag.lower().endswith("obstacle"):
            if reason := _not_recorded(element):
                left_out[reason] += 1
                continue
            name = element.word("id")
            if name in found:
                raise element.fault("another obstacle has this id; ids must differ")
            found[name] = _vehicle(element, origin)
    if not found:
        return None
    return RecordedScene(
        1 / step,
        tuple(found),
        tracks_of(found.values()),
        tuple(_problem(each, lanelets, origin) for each in problems),
        dict(sorted(left_out.items())),
    )


def tracks_of(vehicles: Iterable[tuple[Floats, int, float, float]]) -> Tracks:
    """The tracks of vehicles, each with its states (T, 4), its first frame, length and width."""
    states, first, length, width = (list(each) for each in zip(*vehicles, strict=True))
    counts = np.array([len(each) for each in states])
    row = np.cumsum(counts) - counts
    x, y, heading, speed = np.concatenate(states).T.copy()
    return Tracks(
        x=x,
        y=y,
        heading=heading,
        speed=speed,
        row=row,
        first=np.array(first),
        last=np.array(first) + counts - 1,
        length=np.array(length),
        width=np.array(width),
        fastest=np.maximum.reduceat(speed, row),
    )


def _not_recorded(element: Element) -> str:
    """Why an obstacle is no recorded vehicle; empty if it is one."""
    role = element.first("role")
    kind = _text(element.first("type"))
    if element.tag != "dynamicObstacle" and _text(role) != "dynamic":
        return "that do not move"
    if kind in NO_VEHICLES:
        return f"of type {kind!r}"
    if element.first("trajectory") is None:
        return "without a trajectory"
    return "" if element.inside("shape", "rectangle") else "without a rectangle as shape"


def _vehicle(element: Element, origin: Pair) -> tuple[Floats, int, float, float]:
    """The states (T, 4) of a vehicle, its first frame, length and width."""
    shape = element.inside("shape", "rectangle")[0]
    length, width = (
        each.parsed(each.text, each.tag, *SIZES_M)
        for each in (shape.needed("length"), shape.needed("width"))
    )
    states = [element.needed("initialState"), *element.inside("trajectory", "state")]
    first = _frame(states[0])
    for k, state in enumerate(states):
        if _frame(state) != first + k:
            raise state.fault(
                f"is of the time step {_frame(state)}; expected {first + k}, the one after that of "
                "the state before"
            )
    found = np.array([_state(each, origin) for each in states])
    found[:, 2] = np.unwrap(found[:, 2])
    return found, first, length, width


def _state(state: Element, origin: Pair) -> tuple[float, float, float, float]:
    """Position, heading and speed."""
    position = state.needed("position")
    where = position.first("point")
    if where is None:
        areas = [*position.inside("rectangle", "center"), *position.inside("circle", "center")]
        if not areas:
            raise position.fault("has no <point>, <rectangle> or <circle>")
        where = areas[0]
    x, y = _place(where, origin)
    return x, y, -_middle(state, "orientation", 100.0), _middle(state, "velocity", 100.0)


def _place(where: Element, origin: Pair) -> Pair:
    x, y = (each.parsed(each.text, each.tag) for each in (where.needed("x"), where.needed("y")))
    return x - origin[0], origin[1] - y


def _middle(state: Element, tag: str, most: float = LARGEST) -> float:
    """A number, or the middle of its interval."""
    element = state.needed(tag)
    exact = element.first("exact")
    ends = [exact] if exact else [element.needed(f"interval{end}") for end in ("Start", "End")]
    return math.fsum(each.parsed(each.text, tag, -most, most) for each in ends) / len(ends)


def _frame(state: Element) -> int:
    time = state.needed("time")
    exact = time.needed("exact")
    value = exact.parsed(exact.text, "time", 0.0, MOST_STATES)
    if value != int(value):
        raise time.fault(f"is {exact.text.strip()[:40]!r}; expected a whole number of time steps")
    return int(value)


def _problem(element: Element, lanelets: Mapping[str, Element], origin: Pair) -> Problem:
    initial = element.needed("initialState")
    x, y, heading, speed = _state(initial, origin)
    goals = []
    for goal in element.every("goalState"):
        low, high = _interval(goal, "orientation")
        times, speeds = _interval(goal, "time"), _interval(goal, "velocity")
        areas = tuple(_areas(goal, lanelets, origin))
        goals.append(GoalState(times, speeds, (-high, -low), areas))
    last = max((int(each.frames[1]) for each in goals if each.frames[1] < math.inf), default=None)
    return Problem(element.word("id"), *(x, y, heading, speed, _frame(initial)), tuple(goals), last)


def _interval(goal: Element, tag: str) -> Pair:
    """The interval of a quantity, from minus to plus infinity if a goal state does not have it."""
    element = goal.first(tag)
    if element is None:
        return -math.inf, math.inf
    exact = element.first("exact")
    ends = [exact] * 2 if exact else [element.needed(f"interval{end}") for end in ("Start", "End")]
    low, high = (each.parsed(each.text, tag) for each in ends)
    if low > high:
        raise element.fault(f"begins at {low:g} and ends at {high:g}; expected an end behind it")
    return low, high


def _areas(goal: Element, lanelets: Mapping[str, Element], origin: Pair) -> Iterator[Area]:
    """The areas of a goal state; it has none if only the time counts."""
    for position in goal.every("position"):
        for each in position.children:
            if each.tag == "lanelet":
                name = each.word("ref")
                if name not in lanelets:
                    raise each.fault(f"refers to lanelet {name!r}, which the file does not have")
                yield _area_of_lanelet(lanelets[name], origin)
            elif each.tag in ("rectangle", "circle"):
                is_circle = each.tag == "circle"
                size = each.needed("radius" if is_circle else "length")
                before = size.parsed(size.text, size.tag, 0.0) / (1 if is_circle else 2)
                heading = -_heading(goal if goal.first("orientation") else each)
                place = _place(each.needed("center"), origin)
                if is_circle:
                    yield Area(*place, heading, before, (place,), before)
                else:
                    turn = each.first("orientation")
                    turned = 0.0 if turn is None else -turn.parsed(turn.text, "orientation")
                    width = each.needed("width")
                    sizes = 2 * before, width.parsed(width.text, "width", 0.0)
                    yield Area(*place, heading, before, _corners(place, turned, *sizes))
            else:
                raise each.fault("is no goal that is read; expected lanelet, rectangle or circle")


def _corners(place: Pair, heading: float, length: float, width: float) -> tuple[Pair, ...]:
    """Those of a rectangle around a place."""
    cos, sin = math.cos(heading), math.sin(heading)
    corners = ((-1, -1), (1, -1), (1, 1), (-1, 1))
    halves = [(along * length / 2, aside * width / 2) for along, aside in corners]
    return tuple(
        (place[0] + cos * along - sin * aside, place[1] + sin * along + cos * aside)
        for along, aside in halves
    )


def _heading(element: Element) -> float:
    """The orientation of a goal state, or that of its rectangle."""
    found = element.first("orientation")
    if found is None:
        raise element.fault("the goal has no <orientation>, so the way to it is not known")
    if found.children:
        return _middle(element, "orientation")
    return found.parsed(found.text, "orientation")


def _area_of_lanelet(lanelet: Element, origin: Pair) -> Area:
    sides = [
        np.array([_place(each, origin) for each in lanelet.needed(tag).every("point")])
        for tag in ("leftBound", "rightBound")
    ]
    centre = (sides[0] + sides[1]) / 2
    along = np.append(0.0, np.cumsum(np.hypot(*np.diff(centre, axis=0).T)))
    k = int(np.searchsorted(along, along[-1] / 2)) - 1
    x, y = (np.interp(along[-1] / 2, along, each) for each in centre.T)
    dx, dy = (centre[k + 1] - centre[k]).tolist()
    corners = tuple((float(x), float(y)) for x, y in (*sides[0], *sides[1][::-1]))
    return Area(float(x), float(y), math.atan2(dy, dx), float(along[-1] / 2), corners)


def _text(element: Element | None) -> str:
    return "" if element is None else printable(element.text.strip())[:80]
