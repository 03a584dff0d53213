"""Which lanes of OpenDRIVE roads follow each other.

A link is found where the end of a lane touches that of another, by the links of lanes or by a
junction, from either side. In which direction it leads follows from the directions of travel.
"""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from itertools import pairwise

from charms_bench.errors import MapError
from charms_bench.maps.elements import LONGEST_NAME, Element
from charms_bench.maps.opendrive_lanes import Stretch

START, END = "start", "end"
SIDES = (1, -1)
"""The left and the right of a reference line, the signs of their lanes."""
OUTSIDE = "-1"
"""The junction of a road that is in none."""


@dataclass(frozen=True)
class Place:
    """A lane of a stretch of a road."""

    road: str
    stretch: int
    lane: int

    def __str__(self) -> str:
        return f"{self.road}.{self.stretch}.{self.lane}"


@dataclass
class Road:
    """A road without its geometry."""

    element: Element
    is_left_hand: bool
    stretches: dict[int, list[Stretch]] = field(default_factory=dict)
    """Of each side, in ascending order."""
    ends: dict[str, Element] = field(default_factory=dict)
    """The links of the road at its `start` and its `end`."""

    @property
    def id(self) -> str:
        """The name of the road."""
        return self.element.get("id")

    @property
    def junction(self) -> str:
        """The junction that the road is in; empty outside of junctions."""
        found = self.element.get("junction", OUTSIDE)
        return "" if found == OUTSIDE else found[:LONGEST_NAME]

    def is_forward(self, lane: int) -> bool:
        """Whether cars drive towards larger distances."""
        return (lane < 0) != self.is_left_hand

    def lanes_at(self, end: str) -> dict[int, Place]:
        """The lanes at the start or the end of the road, by their ids."""
        several = [each[0 if end == START else -1] for each in self.stretches.values() if each]
        return {
            lane: Place(self.id, stretch.number, lane)
            for stretch in several
            for lane in stretch.lanes
        }

    def lane_at(self, lane: int, end: str, link: Element) -> Place:
        """One of them, to which a link leads; raises a `MapError` if there is none."""
        lanes = self.lanes_at(end)
        if lane not in lanes:
            known = ", ".join(map(str, sorted(lanes))) or "none"
            raise link.fault(
                f"leads to lane {lane} at the {end} of road {self.id!r}, which does not have it; "
                f"its lanes: {known}"
            )
        return lanes[lane]


Contact = tuple[Place, str]
"""A lane and one of its ends."""


class Links:
    """Collects the ends of lanes that touch.

    Args:
        roads: The roads by their ids.
        junctions: The junctions by their ids.
    """

    def __init__(self, roads: Mapping[str, Road], junctions: Mapping[str, Element]) -> None:
        self._roads, self._junctions = roads, junctions
        self._touching: dict[frozenset[Contact], str] = {}
        """With the junctions in which they touch."""
        self.inside = 0
        """How many links are left out because they lead into the middle of a road."""
        for road in roads.values():
            for side in SIDES:
                self._add_stretches(road, road.stretches[side])
            for end, element in road.ends.items():
                self._add_road(road, element, end)
        for name, junction in junctions.items():
            if junction.get("type") != "virtual":
                for connection in junction.every("connection"):
                    self._add_connection(name, connection)

    def between(self, kept: Mapping[Place, str]) -> Iterable[tuple[Place, Place, str]]:
        """Each lane with one that follows it, and their junction.

        Args:
            kept: The lanes on which cars drive, each with the element that it is.
        """
        for contacts, junction in self._touching.items():
            if len(contacts) == 1 or any(place not in kept for place, _ in contacts):
                continue
            leaving = [place for place, end in contacts if self._leaves(place, end)]
            if len(leaving) != 1:
                (one, _), (other, _) = sorted(contacts, key=str)
                raise MapError(
                    f"{kept[one]}: is linked to lane '{other}', in which cars drive in the "
                    "opposite direction; correct the link"
                )
            (entered,) = (place for place, end in contacts if not self._leaves(place, end))
            yield leaving[0], entered, junction

    def _leaves(self, place: Place, end: str) -> bool:
        """Whether cars leave a lane at an end."""
        return self._roads[place.road].is_forward(place.lane) == (end == END)

    def _touch(self, one: Contact, other: Contact, junction: str = "") -> None:
        self._touching.setdefault(frozenset((one, other)), junction)

    def _road(self, element: Element, name: str) -> Road:
        if name not in self._roads:
            raise element.fault(f"leads to road {name!r}, which the file does not have")
        return self._roads[name]

    def _add_stretches(self, road: Road, stretches: list[Stretch]) -> None:
        for one, other in pairwise(stretches):
            for here, there, tag in ((one, other, "successor"), (other, one, "predecessor")):
                ends = (END, START) if here is one else (START, END)
                for lane, element in here.lanes.items():
                    place = Place(road.id, here.number, lane)
                    if one.section is other.section:
                        following = [lane]
                    else:
                        links = element.inside("link", tag)
                        following = [_lane_of(link, there) for link in links]
                    for each in following:
                        to = Place(road.id, there.number, each)
                        self._touch((place, ends[0]), (to, ends[1]))

    def _add_road(self, road: Road, element: Element, end: str) -> None:
        kind, name = element.get("elementType", "road"), element.word("elementId")
        if kind == "junction":
            if name not in self._junctions:
                raise element.fault(f"leads to junction {name!r}, which the file does not have")
            return
        if kind != "road":
            raise element.fault(f"elementType is {kind[:40]!r}; expected road or junction")
        if "elementS" in element.attributes:  # of a road that starts at a virtual junction
            self.inside += 1
            return
        other, contact = self._road(element, name), _contact_point(element)
        for lane, place in road.lanes_at(end).items():
            side = road.stretches[1 if lane > 0 else -1]
            for link in side[0 if end == START else -1].lanes[lane].inside("link", element.tag):
                to = other.lane_at(link.whole("id"), contact, link)
                self._touch((place, end), (to, contact), road.junction or other.junction)

    def _add_connection(self, junction: str, connection: Element) -> None:
        is_direct = "linkedRoad" in connection.attributes
        names = [
            connection.word("incomingRoad"),
            connection.word("linkedRoad" if is_direct else "connectingRoad"),
        ]
        incoming, following = (self._road(connection, name) for name in names)
        contact = _contact_point(connection)
        ends = [
            end
            for end, each in incoming.ends.items()
            if (each.get("elementType"), each.get("elementId")) == ("junction", junction)
        ]
        for link in connection.every("laneLink"):
            lane = link.whole("from")
            # A road with both ends at the junction is left where cars leave it.
            leaving = END if incoming.is_forward(lane) else START
            end = ends[0] if len(ends) == 1 else leaving
            one = incoming.lane_at(lane, end, link)
            other = following.lane_at(link.whole("to"), contact, link)
            self._touch((one, end), (other, contact), junction)


def _lane_of(link: Element, stretch: Stretch) -> int:
    """The lane of the next or the last section to which a link leads."""
    lane = link.whole("id")
    if lane not in stretch.lanes:
        known = ", ".join(map(str, sorted(stretch.lanes))) or "none"
        raise link.fault(
            f"leads to lane {lane} of the lane section at s={stretch.start:g}, which does not have "
            f"it; its lanes: {known}"
        )
    return lane


def _contact_point(element: Element) -> str:
    found = element.get("contactPoint")
    if found not in (START, END):
        raise element.fault(f"contactPoint is {found[:40]!r}; expected start or end")
    return found
