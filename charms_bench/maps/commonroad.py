"""Reads CommonRoad 2018b and 2020a [Althoff et al. 2017; commonroad.in.tum.de].

Lanelets that are neighbours in the same direction are the lanes of a road. `commonroad_scene` reads
vehicles and planning problems.
"""

from collections.abc import Iterator

import numpy as np

from charms_bench.foundation.arrays import Floats
from charms_bench.maps.draft import Draft, without_repeated
from charms_bench.maps.elements import Element, printable
from charms_bench.maps.programs import program_of
from charms_bench.maps.road_map import MapLane, Program, Signal

VERSIONS = ("2018b", "2020a")
NO_CAR_LANES = frozenset(
    [
        "shoulder",
        "busLane",
        "busStop",
        "bicycleLane",
        "sidewalk",
        "crosswalk",
        "border",
        "parking",
        "restricted",
    ]
)
"""The types of lanelets on which no car drives."""
CARS = frozenset(("vehicle", "car"))
SPEED_SIGNS = frozenset(
    ["274", "R2-1", "r301", "3.24", "R15", "C43", "B14", "Ρ-32", "B31", "maxSpeed"]
)
"""The signs of speed limits in the countries of CommonRoad; their value is in m/s."""


COLOURS = {"green": True, "inactive": True, "red": False, "redYellow": False, "yellow": False}
"""Whether vehicles may go on."""
TURNS = ("left", "straight", "right")


class _Reader:
    def __init__(self, root: Element) -> None:
        version = root.get("commonRoadVersion")
        if version not in VERSIONS:
            raise root.fault(f"version {version[:40]!r}; expected {' or '.join(VERSIONS)}")
        self.draft, self.root = Draft(f"CommonRoad {version}"), root
        self.lanelets: dict[str, Element] = {}
        self.signs: dict[str, Element] = {}
        self.lights: dict[str, Element] = {}
        self.junction_of: dict[str, str] = {}
        self.turns: dict[str, set[str]] = {}
        """Where the ways over intersections lead: some of `TURNS`."""
        self.intersections: list[Element] = []

    def lanelet(self, element: Element) -> None:
        name = element.word("id")
        if name in self.lanelets:
            raise element.fault("another lanelet has this id; ids must differ")
        self.lanelets[name] = element

    def finished(self) -> Draft:
        """The draft, when all elements are read."""
        for element in self.intersections:
            for incoming in element.every("incoming"):
                for each in incoming.children:
                    if each.tag.startswith("successors"):
                        self._check(each)
                        self.junction_of[each.get("ref")] = element.word("id")
                        turn = each.tag.removeprefix("successors").lower()
                        self.turns.setdefault(each.get("ref"), set()).add(turn)
        kept = {name for name, each in self.lanelets.items() if self._is_kept(each)}
        points = {name: _points(self.lanelets[name]) for name in self.lanelets if name in kept}
        for group in self._roads(kept):
            found = []
            for name in group:
                element = self.lanelets[name]
                kinds = [_text(each) for each in element.every("laneletType")]
                lane = MapLane(
                    name,
                    points[name],
                    None,
                    self._limit(element),
                    " ".join(kinds)[:80] or "lanelet",
                )
                found.append((lane, f"line {element.line}: {element.named()}"))
            junctions = [self.junction_of[name] for name in group if name in self.junction_of]
            self.draft.add(found, junctions[0] if junctions else "", False)
        for name, element in self.lanelets.items():
            for tag in ("successor", "predecessor"):
                for each in element.every(tag):
                    other = self._check(each)
                    pair = (name, other) if tag == "successor" else (other, name)
                    if name in kept and other in kept:
                        self.draft.links[pair] = self.junction_of.get(other, "")
        self._add_signals(kept, points)
        return self.draft

    def _check(self, reference: Element) -> str:
        """The lanelet that an element refers to."""
        name = reference.word("ref")
        if name not in self.lanelets:
            raise reference.fault(f"refers to lanelet {name!r}, which the file does not have")
        return name

    def _is_kept(self, element: Element) -> bool:
        kinds = {_text(each) for each in element.every("laneletType")}
        for kind in sorted(kinds & NO_CAR_LANES):
            self.draft.leave_out(f"of type {kind!r}")
            return False
        one_way = {_text(each) for each in element.every("userOneWay")}
        both = {_text(each) for each in element.every("userBidirectional")}
        if both & CARS:
            self.draft.leave_out("driven in both directions")
            return False
        if (one_way or both) and not one_way & CARS:
            self.draft.leave_out("not for cars")
            return False
        return True

    def _roads(self, kept: set[str]) -> Iterator[list[str]]:
        """The lanelets of each road from the left to the right."""
        right: dict[str, str] = {}
        left: dict[str, str] = {}
        for tag, beside in (("adjacentRight", right), ("adjacentLeft", left)):
            for name, element in self.lanelets.items():
                for each in element.every(tag):
                    other = self._check(each)
                    if each.get("drivingDir") == "same" and {name, other} <= kept:
                        beside[name] = other
        # Only neighbours that name each other are lanes of one road.
        right = {name: other for name, other in right.items() if left.get(other) == name}
        inner = set(right.values())
        done = set()
        for name in self.lanelets:
            if name in kept and name not in inner:
                group = [name]
                while group[-1] in right:
                    group.append(right[group[-1]])
                done.update(group)
                yield group
        for name in sorted(kept - done):
            raise self.lanelets[name].fault("is its own neighbour, by way of its neighbours")

    def _limit(self, element: Element) -> float | None:
        """The lowest of the speed limits that apply to a lanelet, m/s."""
        found = [
            each.parsed(each.text, "speedLimit", 0.0, 1000.0)
            for each in element.every("speedLimit")
        ]
        for reference in element.every("trafficSignRef"):
            name = reference.word("ref")
            if name not in self.signs:
                raise reference.fault(f"refers to sign {name!r}, which the file does not have")
            for sign in self.signs[name].every("trafficSignElement"):
                code, value = (sign.first(tag) for tag in ("trafficSignID", "additionalValue"))
                if code is not None and value is not None and _text(code) in SPEED_SIGNS:
                    found.append(value.parsed(value.text, "additionalValue", 0.0, 1000.0))
        return min((each for each in found if each > 0), default=None)

    def _add_signals(self, kept: set[str], points: dict[str, Floats]) -> None:
        """Places lights and signs where the file does, or at the end of the first lane."""
        for tag, kind, known in (
            ("trafficLightRef", "light", self.lights),
            ("trafficSignRef", "sign", self.signs),
        ):
            lanes: dict[str, list[str]] = {}
            for name, element in self.lanelets.items():
                for reference in element.every(tag):
                    other = reference.word("ref")
                    if other not in known:
                        raise reference.fault(f"refers to {other!r}, which the file does not have")
                    if name in kept:
                        lanes.setdefault(other, []).append(name)
            for name, of_lanes in lanes.items():
                element = known[name]
                program = self._program(element) if kind == "light" else ()
                if program:
                    of_lanes = self._lit(element, of_lanes, kept)
                x, y = points[of_lanes[0]][-1, :2].tolist()
                for point in element.inside("position", "point"):
                    x, y, _ = _point(point)
                codes = [
                    _text(each) for each in element.inside("trafficSignElement", "trafficSignID")
                ]
                code = " ".join(codes)[:80]
                signal = Signal(name, kind, x, y, code, tuple(of_lanes), program)
                self.draft.signals.append(signal)

    def _program(self, light: Element) -> Program:
        """The cycle of a light; empty if it has none or is not active."""
        phases = []
        for each in light.inside("cycle", "cycleElement"):
            duration, colour = each.needed("duration"), _text(each.needed("color"))
            if colour not in COLOURS:
                raise each.fault(f"color is {colour[:40]!r}; expected {', '.join(COLOURS)}")
            seconds = duration.parsed(duration.text, "duration", 0.0)
            phases.append((seconds, COLOURS[colour]))
        is_off = any(_text(each) == "false" for each in light.every("active"))
        if is_off or not sum(duration for duration, _ in phases):
            return ()
        step = self.root.number("timeStepSize", low=1e-3, high=10.0)
        (begins,) = [
            each.parsed(each.text, each.tag) for each in light.inside("cycle", "timeOffset")
        ] or [0.0]
        return program_of([(step * each, is_green) for each, is_green in phases], step * begins)

    def _lit(self, light: Element, lanes: list[str], kept: set[str]) -> list[str]:
        """The ways over the intersection in the directions of a light, or lanes that lead there."""
        directions = "".join(_text(each) for each in light.every("direction")).lower()
        turns = {turn for turn in TURNS if turn in directions}
        if not turns:
            return lanes
        every = [each for name in lanes for each in self.lanelets[name].every("successor")]
        after = [name for each in every if (name := self._check(each)) in kept]
        return [*dict.fromkeys(name for name in after if turns & self.turns.get(name, set()))]


def read_commonroad(root: Element, children: Iterator[Element]) -> Draft:
    """The lanelets, signs and traffic lights of a scenario; raises a `MapError`."""
    reader = _Reader(root)
    for element in children:
        if element.tag == "lanelet":
            reader.lanelet(element)
        elif element.tag == "trafficSign":
            reader.signs[element.word("id")] = element
        elif element.tag == "trafficLight":
            reader.lights[element.word("id")] = element
        elif element.tag == "intersection":
            reader.intersections.append(element)
    return reader.finished()


def _text(element: Element) -> str:
    return printable(element.text.strip())


def _point(point: Element) -> tuple[float, float, float]:
    x, y = (point.needed(name) for name in "xy")
    z = point.first("z")
    height = 0.0 if z is None else z.parsed(z.text, "z")
    return x.parsed(x.text, "x"), y.parsed(y.text, "y"), height


def _points(lanelet: Element) -> Floats:
    """The middle of the two bounds of a lanelet, and how far they are apart."""
    bounds = [
        np.array([_point(each) for each in lanelet.needed(tag).every("point")])
        for tag in ("leftBound", "rightBound")
    ]
    if len(bounds[0]) != len(bounds[1]) or len(bounds[0]) < 2:
        counts = " and ".join(str(len(each)) for each in bounds)
        raise lanelet.fault(f"its bounds have {counts} points; expected as many, at least 2")
    left, right = bounds
    width = np.hypot(*(left - right)[:, :2].T)
    if width.max() == 0:
        raise lanelet.fault("its left bound is its right bound; expected a width above 0 m")
    return without_repeated(np.column_stack([(left + right) / 2, width]))
