"""Writes the roads of suites/places.yaml: `python tools/make_places.py`.

Roads are built by formulas, their conflicts are found by charms-bench, and who gives way is added.
"""

import json
import math
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from charms_bench.maps.reading import read_road
from charms_bench.maps.road_file import write_road
from charms_bench.maps.road_map import Conflict

PLACES = Path(__file__).parents[1] / "suites" / "places"
WIDTH = 3.5
Road = dict[str, Any]
Point = tuple[float, float]


def place(
    name: str,
    roads: list[Road],
    gives_way: Callable[[Conflict], str] = lambda conflict: "",
    signals: list[dict[str, Any]] | None = None,
) -> None:
    """Writes a place with its conflicts."""
    junctions = sorted({road["junction"] for road in roads if "junction" in road})
    content = {"charms_bench_road": 1, "name": name, "junctions": junctions, "roads": roads}
    with TemporaryDirectory() as folder:
        path = Path(folder, "road.json")
        path.write_text(json.dumps(content | {"signals": signals or []}), encoding="utf-8")
        road = read_road(path)
    conflicts = tuple(replace(each, gives_way=gives_way(each)) for each in road.conflicts)
    PLACES.mkdir(exist_ok=True)
    write_road(replace(road, conflicts=conflicts), PLACES / f"{name.replace(' ', '-')}.json")


def straight(lane: str, start: Point, end: Point, limit: float, *after: str, **more: Any) -> Road:
    return {
        "id": lane,
        "kind": "straight",
        "start": [*map(rounded, start)],
        "end": [*map(rounded, end)],
        "width": WIDTH,
        "speed_limit": limit,
        "successors": list(after),
    } | more


def arc(
    lane: str, center: Point, radius: float, phases: Point, limit: float, *after: str, **more: Any
) -> Road:
    return {
        "id": lane,
        "kind": "circular",
        "center": [*map(rounded, center)],
        "radius": rounded(radius),
        "start_phase": round(phases[0], 12),
        "end_phase": round(phases[1], 12),
        "clockwise": phases[1] > phases[0],
        "width": WIDTH,
        "speed_limit": limit,
        "successors": list(after),
    } | more


def rounded(value: float) -> float:
    return round(value, 6) + 0.0


def turned(quarter: int) -> Callable[[float, float], Point]:
    """A rotation by quarters, to the right."""
    cosine, sine = ((1, 0), (0, 1), (-1, 0), (0, -1))[quarter % 4]
    return lambda x, y: (cosine * x - sine * y, sine * x + cosine * y)


def motorway() -> list[Road]:
    """Three lanes with an on-ramp and, 600 m later, an off-ramp."""
    at = [0.0, 500.0, 750.0, 1150.0, 1400.0, 1900.0]
    counts = (3, 4, 3, 4, 3)
    roads = []
    for k, count in enumerate(counts):
        after = counts[k + 1] if k < 4 else 0
        lanes = []
        for n in range(count):
            following = [f"m{k + 1}.{n}"] if n < min(after, 3) else []
            if (k, n) == (3, 3):
                following = ["off"]
            y = n * WIDTH
            lanes.append(straight(f"m{k}.{n}", (at[k], y), (at[k + 1], y), 33.3, *following))
        roads.append({"start": f"m{k}", "end": f"m{k + 1}", "lanes": lanes})
    y, away = 3 * WIDTH, 60.0
    on = straight("on", (at[1] - 250, y + away), (at[1], y), 22.2, "m1.3")
    off = straight("off", (at[4], y), (at[4] + 250, y + away), 22.2)
    roads.append({"start": "on", "end": "m1", "lanes": [on]})
    roads.append({"start": "m4", "end": "off", "lanes": [off]})
    return roads


def cloverleaf() -> list[Road]:
    """Two motorways with two lanes a side, one above the other, joined by eight ramps."""
    roads: list[Road] = []
    loop, ramp, far = 40.0, 350.0, 600.0
    outer = 2.5 * WIDTH
    inner = outer + loop
    at = (-far, -ramp, -inner, inner, ramp, far)
    for q in range(4):
        turn, right, left = turned(q), (q + 1) % 4, (q + 3) % 4
        top = 6.0 if q % 2 else 0.0
        heights = ((0.0, 0.0), (0.0, top), (top, top), (top, 0.0), (0.0, 0.0))
        for k in range(5):
            lanes = []
            for n in range(3 if k == 2 else 2):
                following = [f"{q}.{k + 1}.{n}"] if k < 4 and n < 2 else []
                following += [f"{q}.right"] if (k, n) == (0, 1) else []
                following += [f"{q}.loop.1"] if (k, n) == (2, 2) else []
                y = (n + 0.5) * WIDTH
                lane = straight(
                    f"{q}.{k}.{n}", turn(at[k], y), turn(at[k + 1], y), 27.8, *following
                )
                lanes.append(lane | ({"z": heights[k]} if any(heights[k]) else {}))
            roads.append({"start": f"{q}.{k}", "end": f"{q}.{k + 1}", "lanes": lanes})
        phase, y = q * math.pi / 2 - math.pi / 2, 1.5 * WIDTH
        # From the right lane into that of the road to the right.
        curve = arc(
            f"{q}.right",
            turn(-ramp, ramp),
            ramp - y,
            (phase, phase + math.pi / 2),
            16.7,
            f"{right}.4.1",
        )
        roads.append({"start": f"{q}.1", "end": f"{right}.4", "lanes": [curve]})
        # Three quarters of a circle to the right lead to the left.
        below = 6.0 if left % 2 else 0.0
        for half in (1, 2):
            after = f"{q}.loop.2" if half == 1 else f"{left}.2.2"
            begin = phase + (half - 1) * 3 * math.pi / 4
            middle = (top + below) / 2
            lane = arc(
                f"{q}.loop.{half}",
                turn(inner, inner),
                loop,
                (begin, begin + 3 * math.pi / 4),
                11.1,
                after,
                z=[top, middle] if half == 1 else [middle, below],
            )
            start, end = (f"{q}.3", f"{q}.loop") if half == 1 else (f"{q}.loop", f"{left}.2")
            roads.append({"start": start, "end": end, "lanes": [lane]})
    return roads


def crossing(
    name: str, middle: Point, half: float, count: int, ends: list[str], starts: list[str]
) -> Iterator[Road]:
    """The lanes in a junction of four arms with so many lanes a side.

    Arm k is where vehicles with heading k quarters come from; `starts` and `ends` are the nodes at
    which the arms' roads end and start, whose lanes are named `NODE.n`.
    """
    for q in range(4):
        turn = turned(q)

        def at(x: float, y: float, turn: Callable[[float, float], Point] = turn) -> Point:
            dx, dy = turn(x, y)
            return middle[0] + dx, middle[1] + dy

        common = {"start": starts[q], "junction": name}
        lanes = [
            straight(
                f"{name}.{q}.ahead.{n}",
                at(-half, (n + 0.5) * WIDTH),
                at(half, (n + 0.5) * WIDTH),
                13.9,
                f"{ends[q]}.{n}",
            )
            for n in range(count)
        ]
        yield common | {"end": ends[q], "lanes": lanes}
        phase, outer = q * math.pi / 2, (count - 0.5) * WIDTH
        right = arc(
            f"{name}.{q}.right",
            at(-half, half),
            half - outer,
            (phase - math.pi / 2, phase),
            13.9,
            f"{ends[(q + 1) % 4]}.{count - 1}",
        )
        yield common | {"end": ends[(q + 1) % 4], "lanes": [right]}
        left = arc(
            f"{name}.{q}.left",
            at(-half, -half),
            half + WIDTH / 2,
            (phase + math.pi / 2, phase),
            13.9,
            f"{ends[(q + 3) % 4]}.0",
        )
        yield common | {"end": ends[(q + 3) % 4], "lanes": [left]}


def signalised() -> tuple[list[Road], list[dict[str, Any]]]:
    """A junction of four arms with two lanes a side, and its lights."""
    half, length = 16.0, 150.0
    starts, ends = [f"in{q}" for q in range(4)], [f"out{q}" for q in range(4)]
    roads, signals = [*crossing("j", (0.0, 0.0), half, 2, ends, starts)], []
    for q in range(4):
        turn, ys = turned(q), (0.5 * WIDTH, 1.5 * WIDTH)
        turns = (f"j.{q}.left", f"j.{q}.right")
        to = [
            straight(
                f"to{q}.{n}",
                turn(-half - length, y),
                turn(-half, y),
                13.9,
                f"j.{q}.ahead.{n}",
                turns[n],
            )
            for n, y in enumerate(ys)
        ]
        away = [
            straight(f"out{q}.{n}", turn(half, y), turn(half + length, y), 13.9)
            for n, y in enumerate(ys)
        ]
        roads.append({"start": f"from{q}", "end": f"in{q}", "lanes": to})
        roads.append({"start": f"out{q}", "end": f"end{q}", "lanes": away})
        x, y = turn(-half, 2.5 * WIDTH)
        program = (
            [[20, "green"], [25, "red"]] if q % 2 else [[23, "red"], [19, "green"], [3, "red"]]
        )
        signals.append(
            {
                "id": f"light{q}",
                "kind": "light",
                "x": rounded(x),
                "y": rounded(y),
                "lanes": [f"to{q}.0", f"to{q}.1"],
                "program": program,
            }
        )
    return roads, signals


def left_gives_way(conflict: Conflict) -> str:
    """Vehicles that turn to the left give way to those that come from ahead."""
    for one, other in (conflict.lanes, conflict.lanes[::-1]):
        turns, comes = one.split("."), other.split(".")
        from_ahead = (int(turns[1]) - int(comes[1])) % 4 == 2
        if turns[2] == "left" and comes[2] != "left" and from_ahead:
            return one
    return ""


def roundabout() -> list[Road]:
    """A roundabout with two lanes and four arms."""
    inner, apart, length, reach = 24.0, math.radians(22.0), 120.0, 48.0
    roads: list[Road] = []
    for q in range(4):
        turn, phase = turned(q), q * math.pi / 2 + math.pi
        # Vehicles with the heading q come from the arm at this phase, on its left side.
        enters, leaves = phase - apart, phase + apart
        radii = (inner, inner + WIDTH)
        nodes = f"ring{q}", f"ring{q}.out"
        before = f"ring{(q + 3) % 4}.out"
        part = [
            arc(
                f"ring{q}.{n}",
                (0.0, 0.0),
                radius,
                (enters, leaves - math.pi / 2),
                8.3,
                f"ring{(q + 3) % 4}.past.{n}",
                f"ring{(q + 3) % 4}.exit.{n}",
            )
            for n, radius in enumerate(radii)
        ]
        ring = {"junction": "ring", "roundabout": True}
        roads.append(ring | {"start": nodes[0], "end": before, "lanes": part})
        past = [
            arc(f"ring{q}.past.{n}", (0.0, 0.0), radius, (leaves, enters), 8.3, f"ring{q}.{n}")
            for n, radius in enumerate(radii)
        ]
        roads.append(ring | {"start": nodes[1], "end": nodes[0], "lanes": past})
        to, entry, leave, away = [], [], [], []
        for n, radius in enumerate(radii):
            y = (n + 0.5) * WIDTH
            come, gone = turn(-reach, y), turn(-reach, -y)
            there = (radius * math.cos(enters), radius * math.sin(enters))
            back = (radius * math.cos(leaves), radius * math.sin(leaves))
            heading = q * math.pi / 2
            in_curve = curve(come, heading, there, enters - math.pi / 2)
            out_curve = curve(back, leaves - math.pi / 2, gone, heading + math.pi)
            far = turn(-reach - length, y)
            to.append(straight(f"to{q}.{n}", far, come, 13.9, f"ring{q}.entry.{n}"))
            entry.append(polyline(f"ring{q}.entry.{n}", in_curve, 8.3, f"ring{q}.{n}"))
            leave.append(polyline(f"ring{q}.exit.{n}", out_curve, 8.3, f"out{q}.{n}"))
            away.append(straight(f"out{q}.{n}", gone, turn(-reach - length, -y), 13.9))
        roads.append({"start": f"from{q}", "end": f"in{q}", "lanes": to})
        roads.append({"start": f"in{q}", "end": nodes[0], "junction": "ring", "lanes": entry})
        roads.append({"start": nodes[1], "end": f"out{q}", "junction": "ring", "lanes": leave})
        roads.append({"start": f"out{q}", "end": f"end{q}", "lanes": away})
    return roads


def curve(start: Point, heading: float, end: Point, end_heading: float) -> list[Point]:
    """A cubic Hermite curve, about 3 m between points."""
    size = math.dist(start, end)
    count = max(round(size / 3), 2)
    one = (math.cos(heading) * size, math.sin(heading) * size)
    other = (math.cos(end_heading) * size, math.sin(end_heading) * size)
    points = []
    for k in range(count + 1):
        t = k / count
        weights = 2 * t**3 - 3 * t**2 + 1, t**3 - 2 * t**2 + t, 3 * t**2 - 2 * t**3, t**3 - t**2
        points.append(
            tuple(
                rounded(
                    sum(w * p[axis] for w, p in zip(weights, (start, one, end, other), strict=True))
                )
                for axis in (0, 1)
            )
        )
    return points  # type: ignore[return-value]


def polyline(lane: str, points: list[Point], limit: float, *after: str) -> Road:
    x, y = ([each[axis] for each in points] for axis in (0, 1))
    width = [WIDTH] * len(points)
    return {
        "id": lane,
        "kind": "polyline",
        "x": x,
        "y": y,
        "width": width,
        "speed_limit": limit,
        "successors": list(after),
    }


def entry_gives_way(conflict: Conflict) -> str:
    """Vehicles give way to those in the ring, and from its inner lane to those in the outer one."""
    for part in (".entry.", ".exit.0"):
        found = [lane for lane in conflict.lanes if part in lane]
        if len(found) == 1:
            return found[0]
    return ""


def town(blocks: int = 3, block: float = 110.0, half: float = 12.0) -> list[Road]:
    """A grid of streets with a lane a side; at its edges, streets end."""
    roads: list[Road] = []
    for i in range(blocks):
        for j in range(blocks):
            middle = (i * block, j * block)
            starts, ends = [], []
            for q in range(4):
                dx, dy = turned(q)(1, 0)
                starts.append(f"{i},{j},{q}")
                ends.append(f"{int(i + dx)},{int(j + dy)},{q}<")
            roads += crossing(f"{i},{j}", middle, half, 1, ends, starts)
    known = {road["start"] for road in roads}
    wanted = {road["end"] for road in roads}
    for node in sorted({each.removesuffix("<") for each in wanted} | known):
        i, j, q = map(int, node.split(","))
        turn, y = turned(q), WIDTH / 2
        start, end = (
            (i * block + dx, j * block + dy) for dx, dy in (turn(half - block, y), turn(-half, y))
        )
        following = [
            lane["id"] for road in roads if road["start"] == node for lane in road["lanes"]
        ]
        lane = straight(f"{node}<.0", start, end, 13.9, *following)
        roads.append({"start": f"{node}<", "end": node, "lanes": [lane]})
    return roads


if __name__ == "__main__":
    place("motorway", motorway())
    place(
        "cloverleaf",
        cloverleaf(),
        lambda each: next((lane for lane in each.lanes if "right" in lane), ""),
    )
    roads, signals = signalised()
    place("signalised crossing", roads, left_gives_way, signals)
    place("roundabout", roundabout(), entry_gives_way)
    place("town", town())
