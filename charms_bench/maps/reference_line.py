"""The geometry of an OpenDRIVE road: its reference line, and polynomials along it.

Sources: ASAM OpenDRIVE 1.8, chapters 8 (geometry), 9.4 (elevation) and 11 (lanes). Lengths are m,
angles rad; x points to the east, y to the north, and a lateral offset t to the left.
"""

from collections.abc import Sequence
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from charms_bench.foundation.arrays import Floats, Ints
from charms_bench.maps.elements import Element

GAP_M = 0.5
"""Records of one reference line that are further apart than this are a fault of the file."""
_TOUCH_M = 1e-6
_ARC_STEPS = 256
"""Intervals in which the arc length of a `poly3` is inverted."""
_STRAIGHT = 1e-12
"""A spiral whose curvature changes by less per metre, 1/m2, is an arc."""


class Frames(NamedTuple):
    """Points of a curve and its heading there, each (N,)."""

    x: Floats
    y: Floats
    heading: Floats


class Record(NamedTuple):
    """A piece of a reference line."""

    s: float
    x: float
    y: float
    heading: float
    length: float
    kind: str
    numbers: tuple[float, ...]
    """Of an arc: its curvature; a spiral: curvatures at its ends; `poly3`: a to d; `paramPoly3`: aU
    to dU, aV to dV, and by what a distance is multiplied to get its parameter."""


class Polynomials(NamedTuple):
    """Cubic polynomials, each from its start on, of the distance from there."""

    starts: Floats
    """(K,) in ascending order."""
    coefficients: Floats
    """(K, 4)."""

    def at(self, s: Floats, until: float) -> Floats:
        """The values (N,) at distances that belong to a stretch that ends at `until`."""
        which = _which(self.starts, s, until)
        a, b, c, d = self.coefficients[which].T
        ds = s - self.starts[which]
        return np.asarray(a + ds * (b + ds * (c + ds * d)))

    @property
    def is_zero(self) -> bool:
        """Whether all values are 0."""
        return not self.coefficients.any()


def _which(starts: Floats, s: Floats, until: float) -> Ints:
    """The record of each distance; one that starts where the stretch ends does not count."""
    inner = np.minimum(s, until - 1e-9 * (1.0 + abs(until)))
    return np.maximum(np.searchsorted(starts, inner, side="right") - 1, 0)


def polynomials(elements: Sequence[Element], offset: str = "s", start: float = 0.0) -> Polynomials:
    """The polynomials that elements describe; 0 without elements.

    Args:
        elements: Each has the coefficients a, b, c and d, and its distance in the attribute
            `offset`.
        offset: The name of that attribute.
        start: What the distances are counted from.
    """
    rows = []
    for each in elements:
        s = start + each.number(offset, low=-1e-3)
        rows.append((s, *(each.number(name) for name in "abcd")))
    if not rows or min(rows)[0] > start + _TOUCH_M:
        rows.append((start, 0.0, 0.0, 0.0, 0.0))
    table = np.array(sorted(rows, key=lambda row: row[0]))
    return Polynomials(table[:, 0], table[:, 1:])


class ReferenceLine:
    """The reference line of a road.

    Args:
        road: The element, with its `planView`.
    """

    def __init__(self, road: Element) -> None:
        self.records = [_record(each) for each in road.needed("planView").every("geometry")]
        if not self.records:
            raise road.fault("its <planView> has no <geometry>; expected at least one")
        self.records.sort(key=lambda record: record.s)
        self.starts = np.array([record.s for record in self.records])
        last = self.records[-1]
        self.length = last.s + last.length
        stated = road.number("length", self.length, low=0.0)
        if self.length <= 0:
            raise road.fault("is 0 m long; expected a length above 0 m")
        if abs(stated - self.length) > GAP_M + 1e-3 * self.length:
            raise road.fault(
                f"length is {stated:g}, but its <geometry> elements end at {self.length:g}"
            )
        for one, other in pairwise(self.records):
            end = _along(one, np.array([one.length]))
            gap = float(np.hypot(end.x[0] - other.x, end.y[0] - other.y))
            if gap > GAP_M or abs(one.s + one.length - other.s) > GAP_M:
                raise road.fault(
                    f"its <geometry> at s={other.s:g} starts {gap:.2f} m from where the one at "
                    f"s={one.s:g} ends; expected one line without gaps"
                )

    def at(self, s: Floats, until: float) -> Frames:
        """The line at distances (N,) that belong to a stretch that ends at `until`."""
        found = Frames(*np.empty((3, s.size)))
        which = _which(self.starts, s, until)
        for number in np.unique(which).tolist():
            there = which == number
            record = self.records[number]
            for to, values in zip(found, _along(record, s[there] - record.s), strict=True):
                to[there] = values
        return found


def _record(geometry: Element) -> Record:
    s, x, y, heading = (geometry.number(name) for name in ("s", "x", "y", "hdg"))
    length = geometry.number("length", low=0.0)
    shapes = [each for each in geometry.children if each.tag in _SHAPES]
    if len(shapes) != 1:
        found = ", ".join(f"<{each.tag[:40]}>" for each in geometry.children) or "nothing"
        raise geometry.fault(f"has {found}; expected one of {', '.join(_SHAPES)}")
    shape = shapes[0]
    numbers = tuple(shape.number(name) for name in _SHAPES[shape.tag])
    if shape.tag == "paramPoly3":
        ranges = {"arcLength": 1.0, "normalized": 1.0 / max(length, _TOUCH_M)}
        given = shape.get("pRange", "normalized")
        if given not in ranges:
            raise shape.fault(f"pRange is {given[:40]!r}; expected arcLength or normalized")
        numbers += (ranges[given],)
    return Record(s, x, y, heading, length, shape.tag, numbers)


_SHAPES = {
    "line": (),
    "arc": ("curvature",),
    "spiral": ("curvStart", "curvEnd"),
    "poly3": tuple("abcd"),
    "paramPoly3": ("aU", "bU", "cU", "dU", "aV", "bV", "cV", "dV"),
}
"""The kinds of geometry with the names of their numbers."""


def _along(record: Record, ds: Floats) -> Frames:
    """A record at distances (N,) from its start."""
    u, v, turned = _LOCAL[record.kind](record, ds)
    cosine, sine = np.cos(record.heading), np.sin(record.heading)
    x, y = record.x + u * cosine - v * sine, record.y + u * sine + v * cosine
    return Frames(x, y, record.heading + turned)


def _line(record: Record, ds: Floats) -> tuple[Floats, Floats, Floats]:
    return ds, np.zeros_like(ds), np.zeros_like(ds)


def _arc(record: Record, ds: Floats) -> tuple[Floats, Floats, Floats]:
    return _of_curvature(record.numbers[0], ds)


def _of_curvature(curvature: float, ds: Floats) -> tuple[Floats, Floats, Floats]:
    half = curvature * ds / 2
    # The chord of an arc, at half of its angle: no difference of nearly equal numbers.
    chord = ds * np.sinc(half / np.pi)
    return chord * np.cos(half), chord * np.sin(half), curvature * ds


def _spiral(record: Record, ds: Floats) -> tuple[Floats, Floats, Floats]:
    first, last = record.numbers
    rate = (last - first) / max(record.length, _TOUCH_M)
    if abs(rate) < _STRAIGHT:
        return _of_curvature((first + last) / 2, ds)
    from scipy.special import fresnel  # slow to import

    # first * s + rate * s^2 / 2 = sign * pi / 2 * (t^2 - t0^2) with t = (s + origin) / unit
    sign, unit = np.sign(rate), np.sqrt(np.pi / abs(rate))
    origin = first / rate
    sines, cosines = fresnel((np.append(ds, 0.0) + origin) / unit)
    along, aside = unit * (cosines[:-1] - cosines[-1]), sign * unit * (sines[:-1] - sines[-1])
    start = -rate * origin * origin / 2
    cosine, sine = np.cos(start), np.sin(start)
    return (
        along * cosine - aside * sine,
        along * sine + aside * cosine,
        ds * (first + rate * ds / 2),
    )


def _poly3(record: Record, ds: Floats) -> tuple[Floats, Floats, Floats]:
    a, b, c, d = record.numbers
    # u at a distance along the curve: the length up to u is integrated and then inverted.
    u = np.linspace(0.0, record.length, _ARC_STEPS + 1)
    nodes, weights = np.polynomial.legendre.leggauss(5)
    inner = (u[:-1, None] + u[1:, None]) / 2 + np.diff(u)[:, None] / 2 * nodes
    speed = np.hypot(1.0, b + inner * (2 * c + inner * 3 * d))
    lengths = np.concatenate([[0.0], np.cumsum((speed @ weights) * np.diff(u) / 2)])
    where = np.interp(ds, lengths, u)
    for _ in range(3):  # Newton's method, from a start that is nearly right
        step = np.clip(np.searchsorted(u, where, side="right") - 1, 0, _ARC_STEPS - 1)
        half = (where - u[step]) / 2
        inside = u[step, None] + half[:, None] * (1.0 + nodes)
        before = np.hypot(1.0, b + inside * (2 * c + inside * 3 * d)) @ weights * half
        slope = np.hypot(1.0, b + where * (2 * c + where * 3 * d))
        where = np.clip(where - (lengths[step] + before - ds) / slope, 0.0, record.length)
    v = a + where * (b + where * (c + where * d))
    return where, v, np.arctan(b + where * (2 * c + where * 3 * d))


def _param_poly3(record: Record, ds: Floats) -> tuple[Floats, Floats, Floats]:
    *coefficients, scale = record.numbers
    p = ds * scale
    (a, b, c, d), (e, f, g, h) = coefficients[:4], coefficients[4:]
    u, v = a + p * (b + p * (c + p * d)), e + p * (f + p * (g + p * h))
    du, dv = b + p * (2 * c + p * 3 * d), f + p * (2 * g + p * 3 * h)
    return u, v, np.arctan2(dv, du)


_LOCAL = {
    "line": _line,
    "arc": _arc,
    "spiral": _spiral,
    "poly3": _poly3,
    "paramPoly3": _param_poly3,
}
