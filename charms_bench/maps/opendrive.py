"""Reads OpenDRIVE 1.4 to 1.8 [ASAM OpenDRIVE 1.8.1].

A lane section is a road in each direction of travel, and so are the parts of a section with
different speed limits. Not read: lane heights, crossfall, shapes of the road surface, objects.
"""

from collections.abc import Iterator
from itertools import groupby

import numpy as np

from charms_bench.maps.draft import Draft
from charms_bench.maps.elements import Element
from charms_bench.maps.opendrive_lanes import (
    Borders,
    Speeds,
    Stretch,
    Surface,
    limit_of,
    reversed_arc,
    speeds_of,
    stretches,
)
from charms_bench.maps.opendrive_links import END, SIDES, START, Links, Place, Road
from charms_bench.maps.reference_line import ReferenceLine, polynomials
from charms_bench.maps.road_map import MapLane, Signal

CAR_LANES = {
    *("driving", "entry", "exit", "mwyEntry", "mwyExit", "HOV"),
    *("onRamp", "offRamp", "connectingRamp", "slipLane"),
}
"""The types of lanes on which cars drive."""
NARROW_M = 1e-3
"""A lane that is nowhere wider has no width."""


class _Reader:
    def __init__(self) -> None:
        self.draft = Draft("OpenDRIVE")
        self.roads: dict[str, Road] = {}
        self.junctions: dict[str, Element] = {}
        self.kept: dict[Place, str] = {}
        """The lanes on which cars drive, each with the element that it is."""

    def header(self, element: Element) -> None:
        major, minor = (element.whole(name) for name in ("revMajor", "revMinor"))
        if major != 1 or not 4 <= minor <= 8:
            raise element.fault(f"is OpenDRIVE {major}.{minor}; expected 1.4 to 1.8")
        self.draft.format = f"OpenDRIVE {major}.{minor}"

    def junction(self, element: Element) -> None:
        self.junctions[element.word("id")] = element

    def controller(self, element: Element) -> None:
        self.draft.leave_out("controller of traffic lights, which has no program")

    def road(self, element: Element) -> None:
        name = element.word("id")
        if name in self.roads:
            raise element.fault("another road has this id; ids must differ")
        road = Road(element, element.get("rule") == "LHT")
        self.draft.left_hand_traffic |= road.is_left_hand
        for tag, end in (("predecessor", START), ("successor", END)):
            for each in element.inside("link", tag):
                road.ends[end] = each
        lanes = element.needed("lanes")
        sections = sorted(lanes.every("laneSection"), key=lambda each: each.number("s", low=0.0))
        if not sections:
            raise element.fault("its <lanes> has no <laneSection>; expected at least one")
        surface = Surface(
            ReferenceLine(element),
            polynomials(lanes.every("laneOffset")),
            polynomials(element.inside("elevationProfile", "elevation")),
            polynomials(element.inside("lateralProfile", "superelevation")),
        )
        speeds = speeds_of(element)
        for side in SIDES:
            road.stretches[side] = list(stretches(sections, side, surface.line.length, speeds))
            for stretch in road.stretches[side]:
                self._add_lanes(road, stretch, side, surface, speeds)
        self.roads[name] = road
        self._add_signals(road, surface)
        # Of a large map, only what links need is kept.
        element.children.clear()
        for stretch in (each for side in SIDES for each in road.stretches[side]):
            stretch.section.children.clear()
            for lane in stretch.lanes.values():
                lane.children = lane.every("link")

    def _add_lanes(
        self, road: Road, stretch: Stretch, side: int, surface: Surface, speeds: Speeds
    ) -> None:
        ids = sorted(stretch.lanes, key=abs)
        borders = Borders(stretch, ids, side)
        driven = []
        for k, lane in enumerate(ids):
            kind = stretch.lanes[lane].get("type", "none")
            if kind not in CAR_LANES:
                self.draft.leave_out(f"of type {kind[:40]!r}")
            elif (way := stretch.lanes[lane].get("direction", "standard")) != "standard":
                self.draft.leave_out(f"of direction {way[:40]!r}")
            elif borders.widest(k) < NARROW_M:
                self.draft.leave_out("without a width")
            else:
                driven.append(k)
        if not driven:
            return
        lines = borders.lines(surface, driven, road.element)
        # Other lanes between two lanes separate them.
        for _, group in groupby(enumerate(driven), key=lambda each: each[1] - each[0]):
            found = []
            for _, k in group:
                lane = ids[k]
                element, (line, exact) = stretch.lanes[lane], lines[k]
                if not road.is_forward(lane):
                    line = line[::-1]
                    exact = None if exact is None else reversed_arc(exact)
                place = Place(road.id, stretch.number, lane)
                limit = limit_of(element, stretch.section, stretch.start, speeds)
                self.kept[place] = f"line {element.line}: <lane id='{lane}'> of road {road.id!r}"
                described = MapLane(str(place), line, exact, limit, element.get("type"))
                found.append((described, self.kept[place]))
            # From the left: in right-hand traffic, the inner lane is the left one.
            self.draft.add(found[::-1] if road.is_left_hand else found, road.junction, False)

    def _add_signals(self, road: Road, surface: Surface) -> None:
        length = surface.line.length
        for element in road.element.inside("signals", "signal"):
            s = min(max(element.number("s"), 0.0), length)
            point = surface.at(np.array([s]), np.array([[element.number("t")]]), length)
            x, y = point[0, 0, :2].tolist()
            orientation = element.get("orientation", "none")
            valid = [
                sorted((each.whole("fromLane"), each.whole("toLane")))
                for each in element.every("validity")
            ]
            lanes = [
                str(place)
                for side in SIDES
                for stretch in road.stretches[side]
                if stretch.start <= s < stretch.end or s == stretch.end == length
                for lane in stretch.lanes
                if (place := Place(road.id, stretch.number, lane)) in self.kept
                and (orientation not in "+-" or (orientation == "+") == road.is_forward(lane))
                and (not valid or any(low <= lane <= high for low, high in valid))
            ]
            kind = "light" if element.get("dynamic") == "yes" else "sign"
            codes = (element.get(name) for name in ("type", "subtype"))
            code = "-".join(each for each in codes if each not in ("", "-1", "none"))[:80]
            self.draft.signals.append(Signal(element.word("id"), kind, x, y, code, tuple(lanes)))

    def finished(self) -> Draft:
        """The draft, when all elements are read."""
        links = Links(self.roads, self.junctions)
        for one, other, junction in links.between(self.kept):
            self.draft.links[str(one), str(other)] = junction
        if links.inside:
            self.draft.leave_out("links from or into the middle of a road", links.inside)
        lanes: dict[str, list[str]] = {}
        for place in self.kept:
            lanes.setdefault(place.road, []).append(str(place))
        for element in self.junctions.values():
            for row in element.every("priority"):
                low, high = (lanes.get(row.get(name), []) for name in ("low", "high"))
                self.draft.gives_way |= {(one, other) for one in low for other in high}
        return self.draft


def read_opendrive(root: Element, children: Iterator[Element]) -> Draft:
    """What an OpenDRIVE file describes; raises a `MapError`."""
    reader = _Reader()
    known = {
        "header": reader.header,
        "road": reader.road,
        "junction": reader.junction,
        "controller": reader.controller,
    }
    for element in children:
        if element.tag in known:
            known[element.tag](element)
    return reader.finished()
