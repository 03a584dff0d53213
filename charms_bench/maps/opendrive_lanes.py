"""The lanes of an OpenDRIVE road: its sections, its surface and the borders of its lanes."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from charms_bench.foundation.arrays import Floats
from charms_bench.maps.draft import without_repeated
from charms_bench.maps.elements import Element
from charms_bench.maps.reference_line import GAP_M, Polynomials, ReferenceLine, polynomials
from charms_bench.maps.sampling import TooManyPointsError, lengths_of, stations
from charms_bench.world.road_network import CircularLane

UNITS = {"m/s": 1.0, "km/h": 1 / 3.6, "mph": 0.44704, "": 1.0}
"""By what a speed is multiplied to be in m/s."""
LEAST_WIDTH_M = -0.1
"""Widths below 0 by less are errors of rounding, and are 0."""
STEEPEST_ROLL = 1.2
"""Of a superelevation, rad."""
_SHORT_M = 1e-4
"""Distances that are closer than this are one."""
_EVEN_M = 1e-9
_WIDEST_ARC = 2.8
"""Longer arcs, rad, are polylines: beyond half a turn, a position on an arc has no one distance."""
Speeds = list[tuple[float, float | None]]
"""Where speed limits start, and what they are; None where there is none."""


@dataclass
class Stretch:
    """A part of a road, of one side, with one set of lanes and speed limits."""

    section: Element
    number: int
    start: float
    end: float
    lanes: dict[int, Element]


def stretches(
    sections: Sequence[Element],
    side: int,
    length: float,
    speeds: Speeds,
) -> Iterator[Stretch]:
    """The parts of a road on the left (1) or on the right (-1), each with its lanes."""
    tag = "left" if side > 0 else "right"
    own = [
        each for each in sections if each.get("singleSide") != "true" or each.first(tag) is not None
    ]
    number = 0
    for k, section in enumerate(own):
        start = section.number("s", low=0.0)
        end = own[k + 1].number("s") if k + 1 < len(own) else length
        if start > length + GAP_M:
            raise section.fault(f"starts at s={start:g}, but the road ends at s={length:g}")
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
            yield Stretch(section, number, low, high, lanes)
            number += 1


def speeds_of(road: Element) -> Speeds:
    """Where the speed limits of a road change, and what they are from there on."""
    found: Speeds = []
    for each in sorted(road.every("type"), key=lambda each: each.number("s", 0.0)):
        speed = each.first("speed")
        limit = None if speed is None else _speed(speed)
        if not found or found[-1][1] != limit:
            found.append((each.number("s", 0.0), limit))
    return found


def limit_of(lane: Element, section: Element, s: float, speeds: Speeds) -> float | None:
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
class Surface:
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


class Borders:
    """The borders of the lanes of a stretch, from the centre lane outwards."""

    def __init__(self, stretch: Stretch, ids: list[int], side: int) -> None:
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
        return np.concatenate([[low], np.unique(inner), [high]])

    def widest(self, k: int) -> float:
        """The largest of the widths of a lane at a few distances."""
        breaks = self.breaks([])
        parts = np.linspace(0.0, 1.0, 5)
        s = (breaks[:-1, None] + np.diff(breaks)[:, None] * parts).ravel()
        offsets = self.offsets(s)
        return float((offsets[:, k + 1] - offsets[:, k]).max())

    def lines(
        self, surface: Surface, lanes: list[int], road: Element
    ) -> dict[int, tuple[Floats, CircularLane | None]]:
        """The points of lanes' centre lines, in the direction of the road, and their arcs."""
        places = np.array(lanes)
        end = self.stretch.end

        def curves(s: Floats) -> Floats:
            offsets = self.offsets(s)
            inner, outer = offsets[:, places], offsets[:, places + 1]
            t = surface.offset.at(s, end)[:, None] + self.side * (inner + outer) / 2
            points = surface.at(s, t, end)
            width = (outer - inner) * np.cos(surface.roll.at(s, end))[:, None]
            return np.concatenate([points, width[..., None]], axis=-1)

        breaks = self.breaks([surface.roll.starts])
        roll = surface.roll.at(np.append(breaks, (breaks[1:] + breaks[:-1]) / 2), end)
        if np.abs(roll).max() > STEEPEST_ROLL:
            raise road.fault(
                f"<superelevation> is {np.abs(roll).max():.2f} rad somewhere between "
                f"s={self.stretch.start:g} and {end:g}; expected at most {STEEPEST_ROLL:g}"
            )
        others = (surface.line, surface.offset, surface.elevation, surface.roll)
        try:
            s = stations(curves, self.breaks([each.starts for each in others]))
        except TooManyPointsError as error:
            raise road.fault(f"from s={self.stretch.start:g} to {end:g}, it {error}") from error
        found = curves(s)
        arc = self._arc(surface)
        lines = {}
        for k, lane in enumerate(lanes):
            points = _straightened(without_repeated(found[:, k]))
            width = points[:, 3]
            is_exact = arc is not None and (np.abs(width - width[0]) < 1e-9).all()
            lines[lane] = points, self._circular(arc, points) if is_exact and arc else None
        return lines

    def _arc(self, surface: Surface) -> tuple[float, float, float, float] | None:
        """The centre, the curvature and the heading at the start of the arc of a stretch."""
        if not (surface.roll.is_zero and surface.elevation.is_zero):
            return None
        for each in (surface.offset, *self.widths):
            if each.coefficients[:, 1:].any() or len(np.unique(each.coefficients[:, 0])) > 1:
                return None
        line = surface.line
        first, last = (
            int(np.searchsorted(line.starts, s)) - 1
            for s in (self.stretch.start + _SHORT_M, self.stretch.end - _SHORT_M)
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
        out_x, out_y = points[0, 0] - x, points[0, 1] - y
        radius, start = float(np.hypot(out_x, out_y)), heading - np.sign(curvature) * np.pi / 2
        # A lane beyond the centre is on the other side of it.
        is_beyond = out_x * np.cos(start) + out_y * np.sin(start) < 0
        if abs(turn) > _WIDEST_ARC or is_beyond:
            return None
        return CircularLane(
            center=(x, y),
            radius=radius,
            start_phase=float(start),
            end_phase=float(start + turn),
            clockwise=bool(curvature > 0),
            width=float(points[0, 3]),
        )


def _straightened(points: Floats) -> Floats:
    """The two ends of a straight line of one width that rises evenly; other lines as they are.

    The lanes of a section have points at the same distances, where one of them needs them.
    """
    along = lengths_of(points)
    if along[-1] == 0:
        return points
    even = points[0] + np.outer(along / along[-1], points[-1] - points[0])
    is_straight = np.abs(points - even).max() < _EVEN_M and np.ptp(points[:, 3]) < _EVEN_M
    return points[[0, -1]] if is_straight else points


def reversed_arc(arc: CircularLane) -> CircularLane:
    """The same arc in the opposite direction."""
    return CircularLane(
        center=arc.center,
        radius=arc.radius,
        start_phase=arc.end_phase,
        end_phase=arc.start_phase,
        clockwise=not arc.clockwise,
        width=arc.width,
    )
