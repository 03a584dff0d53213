"""Reads SUMO networks (`.net.xml`) [https://sumo.dlr.de/docs/Networks/SUMO_Road_Networks.html].

An edge is a road. Where a network has no internal lanes, the gaps at its junctions are bridged.
"""

from collections.abc import Iterator

import numpy as np

from charms_bench.errors import MapError
from charms_bench.foundation.arrays import Floats
from charms_bench.maps.draft import Draft, without_repeated
from charms_bench.maps.elements import LONGEST_NAME, Element
from charms_bench.maps.programs import program_of
from charms_bench.maps.road_map import MapLane, Program, Signal

CAR = "passenger"
"""SUMO's class of cars."""
WIDTH_M = 3.2
"""Of lanes that state none [SUMO_const_laneWidth]."""
NOT_ROADS = ("crossing", "walkingarea")
"""The functions of edges on which nobody drives."""
GREEN = frozenset("GgoO")
"""The states of a link in which vehicles may go on, also where the light is off."""
Link = tuple[str, int]
"""A junction, and which of its links it is."""


class _Reader:
    def __init__(self, root: Element) -> None:
        self.draft = Draft(f"SUMO {root.get('version')[:40]}".strip())
        self.draft.left_hand_traffic = root.get("lefthand") == "true"
        self.edges: dict[str, Element] = {}
        self.connections: list[Element] = []
        self.junctions: dict[str, Element] = {}
        self.roundabouts: set[str] = set()
        self.lanes: dict[str, list[str]] = {}
        """The ids of an edge's lanes, by their index."""
        self.programs: dict[str, Element] = {}

    def edge(self, element: Element) -> None:
        name = element.word("id")
        if name in self.edges:
            raise element.fault("another edge has this id; ids must differ")
        lanes = sorted(element.every("lane"), key=lambda each: each.whole("index"))
        if [lane.whole("index") for lane in lanes] != list(range(len(lanes))):
            raise element.fault("the indices of its lanes are not 0, 1, 2, ...")
        self.edges[name] = element
        self.lanes[name] = [lane.word("id") for lane in lanes]

    def connection(self, element: Element) -> None:
        self.connections.append(element)

    def junction(self, element: Element) -> None:
        # An internal junction is a point at which vehicles wait within another junction.
        if element.get("type") != "internal":
            self.junctions[element.word("id")] = element

    def program(self, element: Element) -> None:
        name, kind = element.word("id"), element.get("type", "static")
        jumps = any(each.get("next") for each in element.every("phase"))
        if kind != "static" or jumps:
            reason = "with jumps" if jumps else f"of type {kind[:40]!r}"
            self.draft.leave_out(f"program of a traffic light {reason}")
        elif name in self.programs:
            self.draft.leave_out("further program of a traffic light")
        else:
            self.programs[name] = element

    def roundabout(self, element: Element) -> None:
        self.roundabouts |= set(element.get("edges").split())

    def finished(self) -> Draft:
        """The draft, when all elements are read."""
        for name in sorted(self.roundabouts - self.edges.keys()):
            raise MapError(f"<roundabout>: names edge {name[:80]!r}, which the file does not have")
        for edge in self.edges.values():
            self._add_edge(edge)
        self._link()
        return self.draft

    def _add_edge(self, edge: Element) -> None:
        name, function = edge.word("id"), edge.get("function", "normal")
        lanes = sorted(edge.every("lane"), key=lambda each: each.whole("index"))
        if function in NOT_ROADS:
            self.draft.leave_out(f"of a {function}", len(lanes))
            return
        groups: list[list[tuple[MapLane, str]]] = [[]]
        # Index 0 is the outermost lane, and lanes are listed from the left.
        for element in lanes if self.draft.left_hand_traffic else lanes[::-1]:
            if not _is_for_cars(element):
                self.draft.leave_out("not for cars")
                groups.append([])
                continue
            limit = element.number("speed", low=0.0, high=1000.0) or None
            kind = (edge.get("type") or function)[:80]
            lane = MapLane(element.word("id"), _points(element), None, limit, kind)
            where = f"line {element.line}: {element.named()} of edge {name!r}"
            groups[-1].append((lane, where))
        junction = ""
        if function == "internal":
            junction = _junction_of(name)
        for group in filter(None, groups):
            self.draft.add(group, junction, name in self.roundabouts)

    def _link(self) -> None:
        """Links the lanes, and notes their traffic lights and which gives way to which."""
        ends = [
            tuple(self._lane(each, *names) for names in (("from", "fromLane"), ("to", "toLane")))
            for each in self.connections
        ]
        continued = {one for one, _ in ends}
        known = {lane for lanes in self.lanes.values() for lane in lanes}
        of_link = self._links_of_junctions([one for one, _ in ends])
        found: dict[str, set[Link]] = {}
        lights: dict[tuple[str, str], dict[str, Program]] = {}
        for k, (element, (one, other)) in enumerate(zip(self.connections, ends, strict=True)):
            via = element.get("via")
            if via and via not in known:
                raise element.fault(f"via is {via[:80]!r}, a lane that the file does not have")
            if any(lane not in self.draft.where for lane in (one, via or one, other)):
                continue  # not all are for cars
            edge = self.edges[element.get("from")]
            junction = edge.get("to")[:LONGEST_NAME] or _junction_of(edge.get("id"))
            self.draft.links[one, via or other] = junction
            if not via and edge.get("function", "normal") != "internal":
                self.draft.open_links.add((one, other))
            if via and via not in continued:
                self.draft.links[via, other] = junction
            if k in of_link:
                found.setdefault(via or f"{one}->{other}", set()).add(of_link[k])
            if element.get("tl"):
                ways = lights.setdefault((element.get("tl"), one), {})
                ways[via or one] = self._program_of(element)
        # A way over a junction can be interrupted by an internal junction: it stays one link.
        for element, (one, _) in zip(self.connections, ends, strict=True):
            if one in found and element.get("via"):
                found.setdefault(element.get("via"), set()).update(found[one])
        self._add_right_of_way(found)
        place = {lane.id: lane.points[-1] for road in self.draft.roads for lane in road.lanes}
        for (light, lane), ways in lights.items():
            x, y = place[lane][:2].tolist()
            if len(programs := {*ways.values()}) == 1:
                ways = {lane: programs.pop()}
            for each, program in ways.items():
                self.draft.signals.append(Signal(light, "light", x, y, "", (each,), program))

    def _program_of(self, connection: Element) -> Program:
        """The program of a link; empty if the network states none that is read."""
        element = self.programs.get(connection.get("tl"))
        if element is None:
            return ()
        number, phases = connection.whole("linkIndex"), []
        for phase in element.every("phase"):
            state = phase.get("state")
            if not 0 <= number < len(state):
                raise phase.fault(
                    f"state is {state[:40]!r}, without the link {number} of {connection.named()} "
                    f"on line {connection.line}"
                )
            phases.append((phase.number("duration", low=0.0), state[number] in GREEN))
        if not sum(seconds for seconds, _ in phases):
            raise element.fault("has no phase that lasts; expected a duration above 0")
        return program_of(phases, element.number("offset", 0.0))

    def _links_of_junctions(self, starts: list[str]) -> dict[int, Link]:
        """Which link of its junction each connection is, for those that `<request>` rows describe.

        [`Node.getLinkIndex` of sumolib]
        """
        after: dict[str, list[int]] = {}
        for k, (element, one) in enumerate(zip(self.connections, starts, strict=True)):
            functions = [self.edges[element.get(end)].get("function") for end in ("from", "to")]
            is_of_walkers = functions[0] == "walkingarea" and functions[1] != "crossing"
            if not is_of_walkers and functions[1] != "walkingarea":
                after.setdefault(one, []).append(k)
        found: dict[int, Link] = {}
        for name, junction in self.junctions.items():
            several = [k for lane in junction.get("incLanes").split() for k in after.get(lane, ())]
            if len(several) == len(junction.every("request")):
                found |= {k: (name, number) for number, k in enumerate(several)}
        return found

    def _lane(self, element: Element, edge: str, lane: str) -> str:
        name, number = element.word(edge), element.whole(lane)
        if name not in self.lanes:
            raise element.fault(f"{edge} is {name!r}, an edge that the file does not have")
        if not 0 <= number < len(self.lanes[name]):
            count = len(self.lanes[name])
            raise element.fault(
                f"{lane} is {number}, but edge {name!r} has {count} lanes from 0 on"
            )
        return self.lanes[name][number]

    def _add_right_of_way(self, links: dict[str, set[Link]]) -> None:
        lanes: dict[Link, list[str]] = {}
        for lane, several in links.items():
            for link in several:
                lanes.setdefault(link, []).append(lane)
        for name, junction in self.junctions.items():
            for request in junction.every("request"):
                number, bits = request.whole("index"), request.get("response")
                if bits.strip("01"):
                    raise request.fault(f"response is {bits[:40]!r}; expected digits 0 and 1")
                # The last digit is that of link 0.
                for k in (k for k, bit in enumerate(reversed(bits)) if bit == "1"):
                    self.draft.gives_way |= {
                        (one, other)
                        for one in lanes.get((name, number), ())
                        for other in lanes.get((name, k), ())
                    }


def read_sumo(root: Element, children: Iterator[Element]) -> Draft:
    """What a network of SUMO describes; raises a `MapError`."""
    reader = _Reader(root)
    known = {
        "edge": reader.edge,
        "connection": reader.connection,
        "junction": reader.junction,
        "tlLogic": reader.program,
        "roundabout": reader.roundabout,
    }
    for element in children:
        if element.tag in known:
            known[element.tag](element)
    return reader.finished()


def _junction_of(edge: str) -> str:
    """The junction in which an internal edge is, whose name is `:JUNCTION_NUMBER`."""
    return edge.removeprefix(":").rpartition("_")[0]


def _is_for_cars(lane: Element) -> bool:
    """Whether cars may drive on a lane [Vehicle_Type_Parameter_Defaults, vClasses]."""
    allowed, forbidden = lane.get("allow").split(), lane.get("disallow").split()
    if allowed:
        return CAR in allowed or "all" in allowed
    return not (CAR in forbidden or "all" in forbidden)


def _points(lane: Element) -> Floats:
    """The points of a lane's centre line."""
    texts = lane.get("shape").split()
    numbers = [[lane.parsed(each, "shape") for each in text.split(",")] for text in texts]
    if len(numbers) < 2 or any(len(each) not in (2, 3) for each in numbers):
        raise lane.fault("its shape is not a list of at least two points x,y or x,y,z")
    width = lane.number("width", WIDTH_M, high=100.0)
    width = WIDTH_M if width == -1 else width  # SUMO's way to state none
    if width <= 0:
        raise lane.fault(f"width is {width:g}; expected more than 0")
    points = np.array([(*each, 0.0)[:3] for each in numbers])
    return without_repeated(np.column_stack([points, np.full(len(points), width)]))
