"""Reads OpenDRIVE 1.4 to 1.8 [ASAM OpenDRIVE 1.8.1].

A lane section is a road in each direction of travel, and so are the parts of a section with
different speed limits. Not read: lane heights, crossfall, shapes of the road surface, objects.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from itertools import groupby

import numpy as np

from charms_bench.errors import MapError
from charms_bench.foundation.arrays import Floats
from charms_bench.maps.assembly import Draft, without_repeated
from charms_bench.maps.elements import Element
from charms_bench.maps.reference_line import Polynomials, ReferenceLine, polynomials
from charms_bench.maps.road_map import MapLane, Signal
from charms_bench.maps.sampling import TooManyPointsError, stations
from charms_bench.world.road_network import CircularLane

CAR_LANES = frozenset(
    ["driving", "entry", "exit", "onRamp", "offRamp", "connectingRamp", "slipLane", "HOV", "mwyEntry", "mwyExit"]
)
"""The types of lanes on which cars drive."""
UNITS = {"m/s": 1.0, "km/h": 1 / 3.6, "mph": 0.44704, "": 1.0}
"""By what a speed is multiplied to be in m/s."""
NARROW_M = 1e-3
"""A lane that is nowhere wider has no width."""
LEAST_WIDTH_M = -0.1
"""Widths below 0 by less are errors of rounding, and are 0."""
_SHORT_M = 1e-4
"""Distances that are closer than this are one."""
_WIDEST_ARC = 2.8
"""Longer arcs, rad, are polylines: beyond half a turn, a position on an arc has no one distance."""
Place = tuple[str, int, int]
"""A lane: the id of its road, the number of its stretch, and its own id."""


@dataclass
class _Stretch:
    """A part of a road, of one side, with one set of lanes and speed limits."""

    section: Element
    number: int
    start: float
    end: float
    lanes: dict[int, Element]


@dataclass
class _Road:
    element: Element
    id: str
    is_left_hand: bool
    stretches: dict[int, list[_Stretch]]
    """Of the left (1) and of the right (-1), in ascending order."""
    ends: dict[str, Element] = field(default_factory=dict)
    """The `predecessor` and the `successor`."""

    def is_forward(self, lane: int) -> bool:
        """Whether cars drive towards larger distances."""
        return (lane < 0) != self.is_left_hand

    def lane_at(self, lane: int, end: str) -> Place | None:
        """The lane at the start or the end of the road, if there is one with that id."""
        stretches = self.stretches[1 if lane > 0 else -1]
        if not stretches:
            return None
        stretch = stretches[0 if end == "start" else -1]
        return (self.id, stretch.number, lane) if lane in stretch.lanes else None


class _Reader:
    def __init__(self, root: Element) -> None:
        header = root.get("version", "")
        self.draft = Draft(f"OpenDRIVE {header}".strip())
        self.roads: dict[str, _Road] = {}
        self.junctions: dict[str, Element] = {}
        self.kept: set[Place] = set()
        self.touching: dict[tuple[Place, str, Place, str], str] = {}
        """Ends of lanes that touch, and the junction in which they do."""

    # What each child of the root is.

    def header(self, element: Element) -> None:
        major, minor = (element.whole(name) for name in ("revMajor", "revMinor"))
        if major != 1 or not 1 <= minor <= 8:
            raise element.fault(f"is OpenDRIVE {major}.{minor}; expected 1.1 to 1.8")
        self.draft.format = f"OpenDRIVE {major}.{minor}"

    def junction(self, element: Element) -> None:
        self.junctions[element.word("id")] = element

    def road(self, element: Element) -> None:
        name = element.word("id")
        if name in self.roads:
            raise element.fault("another road has this id; ids must differ")
        line = ReferenceLine(element)
        road = _Road(element, name, element.get("rule") == "LHT", {})
        self.draft.left_hand_traffic |= road.is_left_hand
        for each in element.inside("link"):
            road.ends |= {child.tag: child for child in each.children}
        speeds = _speeds(element)
        lanes = element.needed("lanes")
        sections = lanes.every("laneSection")
        if not sections:
            raise element.fault("its <lanes> has no <laneSection>; expected at least one")
        sections.sort(key=lambda each: each.number("s", low=0.0))
        offset = polynomials(lanes.every("laneOffset"))
        elevation = polynomials(element.inside("elevationProfile", "elevation"))
        roll = polynomials(element.inside("lateralProfile", "superelevation"))
        surface = _Surface(line, offset, elevation, roll)
        for side, tag in ((1, "left"), (-1, "right")):
            road.stretches[side] = list(_stretches(sections, side, tag, line.length, speeds))
            for stretch in road.stretches[side]:
                self._add_lanes(road, stretch, side, surface, speeds)
        self.roads[name] = road
        self._add_signals(road, surface)
        # Only what the links need is kept of a road; a large map has a lot else.
        for each in ("planView", "elevationProfile", "lateralProfile", "objects", "signals"):
            element.children = [child for child in element.children if child.tag != each]

    def _add_lanes(
        self,
        road: _Road,
        stretch: _Stretch,
        side: int,
        surface: "_Surface",
        speeds: "list[tuple[float, float | None]]",
    ) -> None:
        ids = sorted(stretch.lanes, key=abs)
        borders = _Borders(stretch, ids, side)
        driven = []
        for lane in ids:
            kind = stretch.lanes[lane].get("type", "none")
            if kind not in CAR_LANES:
                self.draft.leave_out(f"of type {kind[:40]!r}")
            elif borders.widest(lane) < NARROW_M:
                self.draft.leave_out("without a width")
            else:
                driven.append(lane)
        if not driven:
            return
        points = borders.lines(surface, driven, road.element)
        forward = road.is_forward(side)
        places = [ids.index(lane) for lane in driven]
        together = groupby(
            zip(places, driven, strict=True), key=lambda each: each[0] - places.index(each[0])
        )
        for _, group in together:
            numbers = [lane for _, lane in group]
            # Lanes are listed from the left: from the inside to the outside in right-hand traffic.
            if road.is_left_hand:
                numbers.reverse()
            found = []
            for lane in numbers:
                line, exact = points[lane]
                element = stretch.lanes[lane]
                at = stretch.start
                limit = _limit(element, stretch.section, at, speeds)
                if not forward:
                    line = line[::-1]
                    exact = None if exact is None else _reversed(exact)
                name = f"{road.id}.{stretch.number}.{lane}"
                where = f"line {element.line}: <lane id='{lane}'> of road {road.id!r}"
                found.append((MapLane(name, line, exact, limit, element.get("type")), where))
                self.kept.add((road.id, stretch.number, lane))
            junction = road.element.get("junction", "-1")
            self.draft.add(found, "" if junction == "-1" else junction, False)

    # Links.

    def link(self) -> Draft:
        """The draft with the links between its lanes."""
        for road in self.roads.values():
            for side in (1, -1):
                self._link_stretches(road, road.stretches[side])
            for tag, end in (("predecessor", "start"), ("successor", "end")):
                if tag in road.ends:
                    self._link_roads(road, road.ends[tag], tag, end)
        for name, junction in self.junctions.items():
            for connection in junction.every("connection"):
                self._link_connection(name, junction, connection)
        for (one, one_end, other, other_end), junction in self.touching.items():
            if one not in self.kept or other not in self.kept:
                continue
            leaves = self.roads[one[0]].is_forward(one[2]) == (one_end == "end")
            enters = self.roads[other[0]].is_forward(other[2]) == (other_end == "start")
            if leaves != enters:
                raise MapError(
                    f"{self.draft.where[_name(one)]}: is linked to lane {_name(other)!r}, in which "
                    "cars drive in the opposite direction; correct the link"
                )
            pair = (one, other) if leaves else (other, one)
            self.draft.links[_name(pair[0]), _name(pair[1])] = junction
        self._add_priorities()
        return self.draft

    def _touch(self, one: Place, one_end: str, other: Place, other_end: str, at: str = "") -> None:
        first, second = sorted([(one, one_end), (other, other_end)])
        self.touching.setdefault((*first, *second), at)

    def _link_stretches(self, road: _Road, stretches: Sequence[_Stretch]) -> None:
        for one, other in zip(stretches, stretches[1:], strict=False):
            for lane, element in one.lanes.items():
                place = road.id, one.number, lane
                if one.section is other.section:
                    self._touch(place, "end", (road.id, other.number, lane), "start")
                    continue
                for target in _linked(element, "successor"):
                    self._check(target, other, f"section {other.number}")
                    to = road.id, other.number, target.whole("id")
                    self._touch(place, "end", to, "start")
            if one.section is not other.section:
                for lane, element in other.lanes.items():
                    for target in _linked(element, "predecessor"):
                        self._check(target, one, f"section {one.number}")
                        before = road.id, one.number, target.whole("id")
                        self._touch(before, "end", (road.id, other.number, lane), "start")

    def _check(self, target: Element, stretch: _Stretch, what: str) -> None:
        if target.whole("id") not in stretch.lanes:
            known = ", ".join(map(str, sorted(stretch.lanes))) or "none"
            raise target.fault(f"leads to no lane of {what} of the road; its lanes: {known}")

    def _link_roads(self, road: _Road, element: Element, tag: str, end: str) -> None:
        kind, name = element.get("elementType", "road"), element.word("elementId")
        if kind == "junction":
            if name not in self.junctions:
                raise element.fault(f"leads to junction {name!r}, which the file does not have")
            return
        if kind != "road":
            raise element.fault(f"elementType is {kind[:40]!r}; expected road or junction")
        if name not in self.roads:
            raise element.fault(f"leads to road {name!r}, which the file does not have")
        contact = _contact(element)
        for side in (1, -1):
            if not road.stretches[side]:
                continue
            stretch = road.stretches[side][0 if end == "start" else -1]
            for lane, each in stretch.lanes.items():
                for target in _linked(each, tag):
                    to = self.roads[name].lane_at(target.whole("id"), contact)
                    if to is None:
                        raise target.fault(
                            f"leads to no lane at the {contact} of road {name!r}; its lanes: "
                            f"{self._known(name, contact)}"
                        )
                    junction = road.element.get("junction", "-1")
                    place = road.id, stretch.number, lane
                    self._touch(place, end, to, contact, "" if junction == "-1" else junction)

    def _known(self, road: str, end: str) -> str:
        stretches = self.roads[road].stretches.values()
        found = [each[0 if end == "start" else -1].lanes for each in stretches if each]
        return ", ".join(map(str, sorted(lane for lanes in found for lane in lanes))) or "none"

    def _link_connection(self, name: str, junction: Element, connection: Element) -> None:
        if junction.get("type") == "virtual":
            return
        names = [
            connection.word("incomingRoad"),
            connection.word(
                "linkedRoad" if "linkedRoad" in connection.attributes else "connectingRoad"
            ),
        ]
        for each in names:
            if each not in self.roads:
                raise connection.fault(f"leads to road {each!r}, which the file does not have")
        incoming, connecting = (self.roads[each] for each in names)
        contact = _contact(connection)
        for link in connection.every("laneLink"):
            one, other = link.whole("from"), link.whole("to")
            here = [
                end
                for tag, end in (("predecessor", "start"), ("successor", "end"))
                if tag in incoming.ends
                and incoming.ends[tag].get("elementType") == "junction"
                and incoming.ends[tag].get("elementId") == name
            ]
            if len(here) != 1:  # the end at which cars leave the road
                here = ["end" if incoming.is_forward(one) else "start"]
            places = incoming.lane_at(one, here[0]), connecting.lane_at(other, contact)
            for place, lane, road, end in zip(
                places, (one, other), names, (here[0], contact), strict=True
            ):
                if place is None:
                    raise link.fault(
                        f"names lane {lane} at the {end} of road {road!r}; its lanes: "
                        f"{self._known(road, end)}"
                    )
            if places[0] is not None and places[1] is not None:
                self._touch(places[0], here[0], places[1], contact, name)

    def _add_priorities(self) -> None:
        """The right of way between the connecting roads of junctions."""
        lanes: dict[str, list[str]] = {}
        for road, number, lane in sorted(self.kept):
            lanes.setdefault(road, []).append(_name((road, number, lane)))
        for junction in self.junctions.values():
            for each in junction.every("priority"):
                low, high = lanes.get(each.get("low"), []), lanes.get(each.get("high"), [])
                self.draft.gives_way |= {(one, other) for one in low for other in high}

    def _add_signals(self, road: _Road, surface: "_Surface") -> None:
        for element in road.element.inside("signals", "signal"):
            s = min(element.number("s", low=-1.0), surface.line.length)
            place = surface.at(
                np.array([s]), np.array([[element.number("t")]]), surface.line.length
            )
            x, y = place[0, 0, :2].tolist()
            orientation = element.get("orientation", "none")
            valid = [
                tuple(sorted((each.whole("fromLane"), each.whole("toLane"))))
                for each in element.every("validity")
            ]
            lanes = [
                _name((road.id, stretch.number, lane))
                for side in (1, -1)
                for stretch in road.stretches[side]
                if stretch.start <= s < stretch.end or s >= stretch.end == surface.line.length
                for lane in stretch.lanes
                if (road.id, stretch.number, lane) in self.kept
                and (orientation not in "+-" or (orientation == "+") == road.is_forward(lane))
                and (not valid or any(low <= lane <= high for low, high in valid))
            ]
            code = "-".join(
                each
                for name in ("type", "subtype")
                if (each := element.get(name)) not in ("", "-1", "none")
            )
            kind = "light" if element.get("dynamic") == "yes" else "sign"
            self.draft.signals.append(Signal(element.word("id"), kind, x, y, code, tuple(lanes)))


def read_opendrive(root: Element, children: Iterator[Element]) -> Draft:
    """What an OpenDRIVE file describes; raises a `MapError`."""
    reader = _Reader(root)
    known = {"header": reader.header, "road": reader.road, "junction": reader.junction}
    for element in children:
        if element.tag in known:
            known[element.tag](element)
    return reader.link()


def _name(place: Place) -> str:
    return f"{place[0]}.{place[1]}.{place[2]}"


def _contact(element: Element) -> str:
    found = element.get("contactPoint")
    if found not in ("start", "end"):
        raise element.fault(f"contactPoint is {found[:40]!r}; expected start or end")
    return found


def _linked(lane: Element, tag: str) -> list[Element]:
    return lane.inside("link", tag)


def _stretches(
    sections: Sequence[Element],
    side: int,
    tag: str,
    length: float,
    speeds: "list[tuple[float, float | None]]",
) -> Iterator[_Stretch]:
    """The parts of a road on one side, each with its lanes."""
    own = [
        each for each in sections if each.get("singleSide") != "true" or each.first(tag) is not None
    ]
    number = 0
    for k, section in enumerate(own):
        start = section.number("s", low=0.0)
        end = own[k + 1].number("s") if k + 1 < len(own) else length
        lanes: dict[int, Element] = {}
        for element in section.inside(tag, "lane"):
            lane = element.whole("id")
            if lane * side <= 0:
                raise element.fault(
                    f"is on the {tag}, where ids are {'above' if side > 0 else 'below'} 0"
                )
            if lane in lanes:
                raise element.fault("another lane of the section has this id; ids must differ")
            lanes[lane] = element
        cuts = {s for s, _ in speeds}
        cuts |= {
            start + each.number("sOffset", low=0.0)
            for lane in lanes.values()
            for each in lane.every("speed")
        }
        inner = sorted(s for s in cuts if start + _SHORT_M < s < end - _SHORT_M)
        for low, high in zip([start, *inner], [*inner, max(end, start)], strict=True):
            yield _Stretch(section, number, low, high, lanes)
            number += 1


def _speeds(road: Element) -> list[tuple[float, float | None]]:
    """Where the speed limits of a road change, and what they are from there on."""
    found: list[tuple[float, float | None]] = []
    for each in sorted(road.every("type"), key=lambda each: each.number("s", 0.0)):
        speed = each.first("speed")
        limit = None if speed is None else _speed(speed)
        if not found or found[-1][1] != limit:
            found.append((each.number("s", 0.0), limit))
    return found


def _limit(
    lane: Element, section: Element, s: float, speeds: list[tuple[float, float | None]]
) -> float | None:
    """The speed limit of a lane from a distance on."""
    own = [
        (section.number("s") + each.number("sOffset"), _speed(each)) for each in lane.every("speed")
    ]
    for known in (own, speeds):
        valid = [
            limit
            for start, limit in sorted(known, key=lambda pair: pair[0])
            if start <= s + _SHORT_M
        ]
        if valid:
            return valid[-1]
    return None


def _speed(element: Element) -> float | None:
    """The speed limit that an element states, m/s; None if it states that there is none."""
    if element.get("max") in ("no limit", "undefined"):
        return None
    unit = element.get("unit")
    if unit not in UNITS:
        raise element.fault(f"unit is {unit[:40]!r}; expected m/s, km/h or mph")
    return element.number("max", low=0.0, high=1000.0) * UNITS[unit] or None


@dataclass
class _Surface:
    """The surface of a road."""

    line: ReferenceLine
    offset: Polynomials
    elevation: Polynomials
    roll: Polynomials

    def at(self, s: Floats, t: Floats, until: float) -> Floats:
        """The points (N, T, 3) at distances (N,) and lateral offsets (N, T) from the line."""
        x, y, heading = self.line.at(s, until)
        roll = self.roll.at(s, until)
        aside = t * np.cos(roll)[:, None]
        height = self.elevation.at(s, until)[:, None] + t * np.sin(roll)[:, None]
        sine, cosine = np.sin(heading)[:, None], np.cos(heading)[:, None]
        return np.stack([x[:, None] - sine * aside, y[:, None] + cosine * aside, height], axis=-1)


class _Borders:
    """The borders of the lanes of a stretch, from the centre lane outwards."""

    def __init__(self, stretch: _Stretch, ids: list[int], side: int) -> None:
        self.stretch, self.ids, self.side = stretch, ids, side
        start = stretch.section.number("s")
        self.widths, self.is_border = [], []
        for lane in ids:
            element = stretch.lanes[lane]
            widths, borders = element.every("width"), element.every("border")
            self.is_border.append(bool(borders) and not widths)
            self.widths.append(polynomials(widths or borders, "sOffset", start))
        starts = [each.starts for each in self.widths]
        self.starts = np.concatenate([[], *starts])

    def offsets(self, s: Floats) -> Floats:
        """The lateral offsets (N, 1 + L) of all borders from the centre lane, outwards positive."""
        found = [np.zeros_like(s)]
        for widths, is_border, lane in zip(self.widths, self.is_border, self.ids, strict=True):
            value = widths.at(s, self.stretch.end)
            outer = np.abs(value) if is_border else found[-1] + value
            if (outer < found[-1] + LEAST_WIDTH_M).any():
                worst = float((outer - found[-1]).min())
                raise self.stretch.lanes[lane].fault(
                    f"is {worst:.2f} m wide somewhere; expected widths of 0 m or more"
                )
            found.append(np.maximum(outer, found[-1]))
        return np.stack(found, axis=1)

    def breaks(self, others: Sequence[Floats]) -> Floats:
        """Where a record of the road or of a lane starts, and the ends of the stretch."""
        low, high = self.stretch.start, self.stretch.end
        every = np.concatenate([self.starts, *others])
        inner = every[(every > low + _SHORT_M) & (every < high - _SHORT_M)]
        return np.unique(np.concatenate([[low], inner, [high]]))

    def widest(self, lane: int) -> float:
        """The largest of the widths at a few distances."""
        breaks = self.breaks([])
        parts = np.linspace(0.0, 1.0, 5)
        s = (breaks[:-1, None] + np.diff(breaks)[:, None] * parts).ravel()
        offsets = self.offsets(s)
        place = self.ids.index(lane)
        return float((offsets[:, place + 1] - offsets[:, place]).max())

    def lines(
        self, surface: _Surface, lanes: list[int], road: Element
    ) -> dict[int, tuple[Floats, CircularLane | None]]:
        """The points of each lane's centre line, in the direction of the road, and its arc."""
        places = np.array([self.ids.index(lane) for lane in lanes])
        end = self.stretch.end

        def curves(s: Floats) -> Floats:
            offsets = self.offsets(s)
            inner, outer = offsets[:, places], offsets[:, places + 1]
            t = surface.offset.at(s, end)[:, None] + self.side * (inner + outer) / 2
            points = surface.at(s, t, end)
            width = (outer - inner) * np.cos(surface.roll.at(s, end))[:, None]
            return np.concatenate([points, width[..., None]], axis=-1)

        others = (surface.line, surface.offset, surface.elevation, surface.roll)
        try:
            s = stations(curves, self.breaks([each.starts for each in others]))
        except TooManyPointsError as error:
            raise road.fault(f"from s={self.stretch.start:g} to {end:g}, it {error}") from error
        found = curves(s)
        arc = self._arc(surface)
        lines = {}
        for k, lane in enumerate(lanes):
            points = without_repeated(found[:, k])
            width = points[:, 3]
            is_exact = arc is not None and (np.abs(width - width[0]) < 1e-9).all()
            lines[lane] = points, self._circular(arc, points) if is_exact and arc else None
        return lines

    def _arc(self, surface: _Surface) -> tuple[float, float, float, float] | None:
        """The centre, curvature and heading at the start of the arc that the stretch follows."""
        if not (surface.roll.is_zero and surface.elevation.is_zero):
            return None
        for each in (surface.offset, *self.widths):
            if each.coefficients[:, 1:].any() or len(np.unique(each.coefficients[:, 0])) > 1:
                return None
        line = surface.line
        first, last = (
            int(np.searchsorted(line.starts, s, side=side)) - 1
            for s, side in ((self.stretch.start, "right"), (self.stretch.end, "left"))
        )
        record = line.records[first]
        if first != last or record.kind != "arc" or record.numbers[0] == 0:
            return None
        curvature = record.numbers[0]
        x, y = (
            record.x - np.sin(record.heading) / curvature,
            record.y + np.cos(record.heading) / curvature,
        )
        heading = record.heading + curvature * (self.stretch.start - record.s)
        return float(x), float(y), curvature, float(heading)

    def _circular(
        self, arc: tuple[float, float, float, float], points: Floats
    ) -> CircularLane | None:
        x, y, curvature, heading = arc
        turn = curvature * (self.stretch.end - self.stretch.start)
        radius = float(np.hypot(points[0, 0] - x, points[0, 1] - y))
        if abs(turn) > _WIDEST_ARC:
            return None
        start = heading - np.sign(curvature) * np.pi / 2
        # A lane beyond the centre would be on the other side of it.
        if (
            np.hypot(
                x + radius * np.cos(start) - points[0, 0], y + radius * np.sin(start) - points[0, 1]
            )
            > 1e-6
        ):
            return None
        return CircularLane(
            center=(x, y),
            radius=radius,
            start_phase=float(start),
            end_phase=float(start + turn),
            clockwise=bool(curvature > 0),
            width=float(points[0, 3]),
        )


def _reversed(arc: CircularLane) -> CircularLane:
    return CircularLane(
        center=arc.center,
        radius=arc.radius,
        start_phase=arc.end_phase,
        end_phase=arc.start_phase,
        clockwise=not arc.clockwise,
        width=arc.width,
    )
