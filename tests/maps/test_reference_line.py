"""Curves of OpenDRIVE and their polylines, against integrals by SciPy."""

from pathlib import Path

import numpy as np
import pytest
from handmade_maps import lane, lanes_of, opendrive, polynomial, read, road, section
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import cumulative_simpson, quad

from charms_bench.foundation.arrays import Floats
from charms_bench.maps.elements import elements
from charms_bench.maps.reference_line import ReferenceLine
from charms_bench.maps.shapes import straight
from charms_bench.world.road_network import StraightLane

WITHIN_M, LENGTH_ERROR = 0.01, 1e-3
"""What the page on maps promises."""
PLACE = (3.0, -2.0, 0.7)


def geometry(
    shape: str, length: float, place: tuple[float, float, float] = PLACE, s: float = 0.0
) -> str:
    x, y, heading = place
    return (
        f'<geometry s="{s!r}" x="{x!r}" y="{y!r}" hdg="{heading!r}" length="{length!r}">{shape}'
        "</geometry>"
    )


def line_of(folder: Path, *geometries: str) -> ReferenceLine:
    path = folder / "line.xodr"
    path.write_text(opendrive(road("1", "".join(geometries), section(right=lane(-1)))))
    (element,) = (each for each in elements(path) if each.tag == "road")
    return ReferenceLine(element)


@pytest.mark.parametrize(
    ("start", "end"), [(0.02, 0.02), (0.0, 0.05), (-0.03, 0.01), (0.04, 0.04 + 1e-9), (0.1, -0.1)]
)
def test_arcs_and_spirals_are_the_integrals_of_their_headings(
    tmp_path: Path, start: float, end: float
) -> None:
    length = 80.0
    shape = f'<spiral curvStart="{start!r}" curvEnd="{end!r}"/>'
    if start == end:
        shape = f'<arc curvature="{start!r}"/>'
    line = line_of(tmp_path, geometry(shape, length))
    x0, y0, heading0 = PLACE

    def heading(s: float) -> float:
        return heading0 + start * s + (end - start) / length * s * s / 2

    for s in (0.0, 12.5, 80.0):
        x, y, theta = (float(each[0]) for each in line.at(np.array([s]), length))
        assert x == pytest.approx(x0 + quad(lambda u: np.cos(heading(u)), 0, s)[0], abs=1e-6)
        assert y == pytest.approx(y0 + quad(lambda u: np.sin(heading(u)), 0, s)[0], abs=1e-6)
        assert theta == pytest.approx(heading(s), abs=1e-12)


def test_a_cubic_is_followed_by_its_length(tmp_path: Path) -> None:
    b, c, d = 0.1, 0.01, -1e-4

    def speed(u: float) -> float:
        return float(np.hypot(1.0, b + 2 * c * u + 3 * d * u * u))

    u, length = 30.0, quad(speed, 0, 40)[0]
    line = line_of(tmp_path, geometry(f'<poly3 a="0" b="{b}" c="{c}" d="{d}"/>', length, (0, 0, 0)))
    x, y, heading = (float(each[0]) for each in line.at(np.array([quad(speed, 0, u)[0]]), length))
    assert (x, y) == pytest.approx((u, b * u + c * u**2 + d * u**3), abs=1e-6)
    assert heading == pytest.approx(np.arctan(b + 2 * c * u + 3 * d * u * u), abs=1e-7)


@pytest.mark.parametrize(("kind", "parameter"), [("arcLength", 25.0), ("normalized", 0.25)])
def test_a_parametric_cubic_has_its_parameter_by_the_length(
    tmp_path: Path, kind: str, parameter: float
) -> None:
    p, scale = parameter, 100.0 if kind == "normalized" else 1.0
    u, v = (0.0, 1.0 * scale, 0.0, 0.0), (0.0, 0.0, 1e-3 * scale**2, 0.0)
    numbers = [f'{n}{axis}="{each!r}"' for axis, all_ in zip("UV", (u, v), strict=True)
               for n, each in zip("abcd", all_, strict=True)]  # fmt: skip
    shape = f'<paramPoly3 pRange="{kind}" {" ".join(numbers)}/>'
    line = line_of(tmp_path, geometry(shape, 100.0, (0, 0, 0)))
    x, y, _ = (float(each[0]) for each in line.at(np.array([25.0]), 100.0))
    assert (x, y) == pytest.approx((u[1] * p, v[2] * p * p))


def distances_to(polyline: Floats, points: Floats) -> Floats:
    """How far each point is from a polyline."""
    start, way = polyline[:-1], np.diff(polyline, axis=0)
    aside = points[:, None] - start
    along = np.clip((aside * way).sum(axis=2) / (way * way).sum(axis=1), 0, 1)
    return np.hypot(*(aside - along[..., None] * way).transpose(2, 0, 1)).min(axis=1)


curvatures = st.floats(-0.08, 0.08)


@settings(max_examples=40, deadline=None)
@given(
    bends=st.lists(st.tuples(curvatures, curvatures, st.floats(5, 80)), min_size=1, max_size=3),
    width=st.tuples(st.floats(2.5, 5), st.floats(-0.005, 0.01), st.floats(0, 1e-4)),
    offset=st.floats(-3, 3),
)
def test_a_polyline_is_within_a_centimetre_of_its_curve(
    tmp_path_factory: pytest.TempPathFactory,
    bends: list[tuple[float, float, float]],
    width: tuple[float, float, float],
    offset: float,
) -> None:
    folder = tmp_path_factory.mktemp("curves")
    total, pieces, place = 0.0, [], (0.0, 0.0, 0.3)
    records, truth, lengths = [], [], 0.0
    for first, last, length in bends:
        s = np.linspace(0.0, length, 4001)
        heading = place[2] + first * s + (last - first) / length * s * s / 2
        x = place[0] + cumulative_simpson(np.cos(heading), x=s, initial=0)
        y = place[1] + cumulative_simpson(np.sin(heading), x=s, initial=0)
        shape = f'<spiral curvStart="{first!r}" curvEnd="{last!r}"/>'
        records.append(geometry(shape, length, place, total))
        along = s + total
        t = offset - (width[0] + width[1] * along + width[2] * along**2) / 2
        pieces.append(np.stack([x - np.sin(heading) * t, y + np.cos(heading) * t], axis=1))
        place, total = (float(x[-1]), float(y[-1]), float(heading[-1])), total + length
    truth = np.concatenate(pieces)
    lengths = float(np.hypot(*np.diff(truth, axis=0).T).sum())
    widths = polynomial("width", "sOffset", 0.0, *width)
    sections = polynomial("laneOffset", "s", a=offset) + section(right=lane(-1, widths))
    found = read(folder, opendrive(road("1", "".join(records), sections)))
    points = np.concatenate([lane.points[:, :2] for lane in found.lanes]) * (1, -1)
    points = points[np.append(True, np.hypot(*np.diff(points, axis=0).T) > 0)]
    assert distances_to(points, truth[::7]).max() <= WITHIN_M
    assert sum(lane.length for lane in found.lanes) == pytest.approx(lengths, rel=LENGTH_ERROR)


def test_an_arc_is_kept_as_an_arc(tmp_path: Path) -> None:
    text = opendrive(road("1", geometry('<arc curvature="0.01"/>', 100.0), section(right=lane(-1))))
    found = lanes_of(read(tmp_path, text))["1.0.-1"]
    # To the right of a curve to the left with a radius of 100 m.
    assert found.length == pytest.approx(101.75, rel=1e-12)
    assert found.exact is not None
    assert not found.exact.clockwise  # type: ignore[union-attr]


@pytest.mark.parametrize(
    ("end", "width"), [((10.0, 4.0, 1.5, 3.5), 3.5), ((10.0, 4.0, 0.0, 4.0), None)]
)
def test_two_points_of_one_width_are_a_straight_lane_however_high(
    end: tuple[float, ...], width: float | None
) -> None:
    found = straight(np.array([(0.0, 1.0, 0.0, 3.5), end]))
    expected = width and StraightLane(start=(0.0, 1.0), end=(10.0, 4.0), width=width)
    assert found == expected
