"""The road file: what is written is read again, and what does not fit together is named."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from handmade_maps import connection, edge, lanes_of, opendrive, read, road, same, section, sumo
from handmade_maps import lane as opendrive_lane
from hypothesis import example, given, settings
from hypothesis import strategies as st

from charms_bench.errors import MapError
from charms_bench.maps.reading import read_road
from charms_bench.maps.road_file import write_road
from charms_bench.roads.layout import Layout
from charms_bench.world.road_network import CircularLane, SineLane, StraightLane

HANDMADE: dict[str, Any] = {
    "charms_bench_road": 1,
    "roads": [
        {
            "start": "a",
            "end": "b",
            "lanes": [
                {"id": "in", "kind": "straight", "start": [0, 0], "end": [50, 0],
                 "successors": ["on"]}
            ],
        },
        {
            "start": "b",
            "end": "c",
            "lanes": [
                {"id": "on", "kind": "sine", "start": [50, 0], "end": [90, 0], "amplitude": 2,
                 "pulsation": 0.15708, "phase": 0, "successors": ["out"], "speed_limit": 12.5}
            ],
        },
        {
            "start": "c",
            "end": "d",
            "lanes": [
                {"id": "out", "kind": "circular", "center": [90, 10], "radius": 10,
                 "start_phase": -1.5708, "end_phase": 0, "clockwise": True},
                {"id": "by", "kind": "polyline", "x": [90, 105], "y": [3, 10], "width": [3, 4]},
            ],
        },
    ],
    "conflicts": [{"lanes": ["out", "by"], "at": [1, 2], "kind": "crossing", "gives_way": "by"}],
    "signals": [{"id": "1", "kind": "light", "x": 1, "y": 2, "lanes": ["in"]}],
}  # fmt: skip


numbers = st.floats(-1000, 1000).map(lambda value: round(value, 3))
steps = st.tuples(st.floats(0.5, 30), st.floats(-5, 5), st.floats(-0.5, 0.5))


@settings(max_examples=40, deadline=None)
@example(
    start=(0.0, 0.0, 0.0), ways=[[(8.0, 0.5, 0.0)], [(1.0, 0.0, 0.0)]], width=1.0, links={(1, 0)}
)
@given(
    start=st.tuples(numbers, numbers, numbers),
    ways=st.lists(st.lists(steps, min_size=1, max_size=5), min_size=1, max_size=4),
    width=st.floats(0.5, 20).map(lambda value: round(value, 2)),
    links=st.sets(st.tuples(st.integers(0, 3), st.integers(0, 3)), max_size=6),
)
def test_what_is_written_is_read_again(
    tmp_path_factory: pytest.TempPathFactory,
    start: tuple[float, float, float],
    ways: list[list[tuple[float, float, float]]],
    width: float,
    links: set[tuple[int, int]],
) -> None:
    folder = tmp_path_factory.mktemp("written")
    shapes = [np.cumsum([start, *way], axis=0) for way in ways]
    texts = [" ".join(",".join(f"{v:.3f}" for v in point) for point in each) for each in shapes]
    edges = [
        edge(f"e{k}", text, ends=(f"{k}", f"{k} end"), lane=f'width="{width}"')
        for k, text in enumerate(texts)
    ]
    far = {
        (a, b)
        for a, b in links
        if max(a, b) >= len(ways) or np.hypot(*(shapes[a][-1] - shapes[b][0])[:2]) > 99
    }
    connections = [connection(f"e{a}", f"e{b}") for a, b in sorted(links - far)]
    first = read(folder, sumo(*edges, *connections))
    write_road(first, folder / "road.json")
    assert same(first, read_road(folder / "road.json"))


@pytest.mark.parametrize("place", [(0.0, 0.0), (7e5, 5e6)])
def test_arcs_signals_and_what_was_left_out_are_kept(
    tmp_path: Path, place: tuple[float, float]
) -> None:
    arc = '<geometry s="0" x="{}" y="{}" hdg="1" length="90"><arc curvature="-0.01"/></geometry>'
    lanes = section(opendrive_lane(1), opendrive_lane(-1) + opendrive_lane(-2, kind="parking"))
    signal = '<signals><signal id="s" s="0" t="0" dynamic="yes"/></signals>'
    # A space without a width in a name is shown as a question mark.
    text = opendrive(road("1\u200b", arc.format(*place), lanes, others=signal))
    first = read(tmp_path, text)
    write_road(first, tmp_path / "road.json")
    assert {type(each.exact) for each in first.lanes} == {CircularLane}
    assert {lane.id for lane in first.lanes} == {"1?.0.1", "1?.0.-1"}
    assert same(first, read_road(tmp_path / "road.json"))


def test_a_file_written_by_hand_is_the_network_that_it_describes(tmp_path: Path) -> None:
    found = read(tmp_path, json.dumps(HANDMADE), "hand.json")
    shapes = [type(each.exact) for each in found.lanes]
    assert shapes == [StraightLane, SineLane, CircularLane, type(None)]
    network = Layout(found.edges()).network
    assert network.lanes["kind"].tolist() == [0, 1, 2, 3]
    assert network.lanes["length"].tolist() == pytest.approx([50, 40, 15.708, np.hypot(15, 7)])
    assert network.lanes["speed_limit"].tolist() == [20, 12.5, 20, 20]
    # A sine of 2 m with a period of 40 m.
    sine = lanes_of(found)["on"].points
    assert sine[:, 1] == pytest.approx(2 * np.sin(0.15708 * (sine[:, 0] - 50)))


def change(*keys: Any, to: Any) -> Callable[[Any], None]:
    def apply(value: Any) -> None:
        for key in keys[:-1]:
            value = value[key]
        value[keys[-1]] = to

    return apply


HAIRPIN = {"id": "by", "kind": "polyline", "x": [90, 140, 140, 90], "y": [3, 3, 13, 13],
           "width": [3, 3, 3, 3]}  # fmt: skip
IN, OUT = ("roads", 0, "lanes", 0), ("roads", 2, "lanes", 0)


@pytest.mark.parametrize(
    ("faulty", "what"),
    [
        (change("charms_bench_road", to=2), "charms_bench_road: Input should be 1, found 2"),
        (change("road", to=[]), "road: unknown key. Did you mean 'roads'?"),
        (change("roads", to=[]), "roads: expected at least 1"),
        (
            change(*IN, "successors", to=["onn"]),
            "roads.0.lanes.0.successors: there is no lane 'onn'",
        ),
        (change(*IN, "successors", to=["out"]), "starts at node 'c'; expected 'b'"),
        (change(*IN, "id", to="out"), "roads.2.lanes.0.id: another lane is named 'out'"),
        (change(*IN, "end", to=[0, 0]), "roads.0.lanes.0: starts where it ends"),
        (
            change(*IN, "end", to=[0, "x"]),
            "roads.0.lanes.0.straight.end.1: Input should be a valid number",
        ),
        (change(*IN, "end", to=[0, float("nan")]), "roads.0.lanes.0.straight.end.1"),
        (change(*IN, "start", to=[-1e8, 0]), "roads.0.lanes.0: is 1e+08 m long"),
        (change(*IN, "width", to=101), "less than or equal to 100, found 101"),
        (change(*IN, "kind", to="spline"), "roads.0.lanes.0"),
        (change(*IN, "speed_limit", to=0), "greater than 0, found 0"),
        (change(*OUT, "end_phase", to=4), "roads.2.lanes.0: turns by 5.5708 rad"),
        (change(*OUT, "clockwise", to=False), "roads.2.lanes.0: turns by -1.5708 rad"),
        (change("roads", 2, "lanes", 1, "width", to=[3]), "at least 2"),
        (
            change("roads", 2, "lanes", 1, to=HAIRPIN),
            "roads.2.lanes.1: turns back, so that positions along it are not found",
        ),
        (change("roads", 2, "lanes", 1, "x", to=[1, 2, 3]), "have 3, 2, 3, 2 numbers"),
        (change(*IN, "end", to=[50, 7]), "lane 'on' starts at (50, 0); expected (50, 7)"),
        (change("roads", 1, "start", to="a"), "lane 'on' starts at node 'a'; expected 'b'"),
        (
            change("conflicts", 0, "at", to=[99, 0]),
            "conflicts.0.at: 99 m, but lane 'out' is 15.708 m long",
        ),
        (change("conflicts", 0, "lanes", to=["out", "of"]), "conflicts.0: there is no lane 'of'"),
        (change("conflicts", 0, "gives_way", to="in"), "gives_way: is not one of the two lanes"),
        (change("signals", 0, "lanes", to=["x"]), "signals.0: there is no lane 'x'"),
    ],
)
def test_parts_that_do_not_fit_together_are_named(
    tmp_path: Path, faulty: Callable[[Any], None], what: str
) -> None:
    text = json.loads(json.dumps(HANDMADE))
    faulty(text)
    with pytest.raises(MapError) as error:
        read(tmp_path, json.dumps(text), "road.json")
    assert what in str(error.value)
    assert str(error.value).startswith(f"{tmp_path / 'road.json'}: ")
    assert "\n" not in str(error.value)


def test_a_name_that_is_given_twice_is_a_fault(tmp_path: Path) -> None:
    text = json.dumps(HANDMADE).replace('"start": "b"', '"start": "x", "start": "b"')
    with pytest.raises(MapError, match=r"twice\.json: 'start' is given twice$"):
        read(tmp_path, text, "twice.json")


def test_conflicts_are_looked_for_if_a_file_has_none(tmp_path: Path) -> None:
    text = {**HANDMADE, "conflicts": []}
    assert read(tmp_path, json.dumps(text), "none.json").conflicts == ()
    del text["conflicts"]
    lane = {"id": "across", "kind": "straight", "start": [20, -5], "end": [20, 5]}
    text["roads"] = [*text["roads"], {"start": "x", "end": "y", "lanes": [lane]}]
    (found,) = read(tmp_path, json.dumps(text), "found.json").conflicts
    assert (found.lanes, found.at, found.kind) == (("in", "across"), (20, 5), "crossing")


def test_two_roads_between_the_same_nodes_are_a_fault(tmp_path: Path) -> None:
    text = json.loads(json.dumps(HANDMADE))
    lane = {"id": "beside", "kind": "straight", "start": [0, 4], "end": [50, 4]}
    text["roads"].append({"start": "a", "end": "b", "lanes": [lane]})
    with pytest.raises(MapError, match=r"roads\.3: leads from node 'a' to 'b' as roads\.0 does"):
        read(tmp_path, json.dumps(text), "road.json")


def test_a_map_is_cut_around_a_point_of_the_map(tmp_path: Path) -> None:
    def far(k: int) -> str:
        return f"{20000 + 100 * k},0 {20000 + 100 * (k + 1)},0"

    edges = [edge(f"e{k}", far(k), ends=(f"{k}", f"{k + 1}")) for k in range(4)]
    links = [connection(f"e{k}", f"e{k + 1}") for k in range(3)]
    path = tmp_path / "map.xml"
    path.write_text(sumo(*edges, *links))
    found = read_road(path, around=(20150.0, 30.0), radius=60.0)
    assert {name: each.successors for name, each in lanes_of(found).items()} == {
        "e0_0": ("e1_0",),
        "e1_0": ("e2_0",),
        "e2_0": (),
    }
    with pytest.raises(
        MapError, match=r"no lane is within 5 m of \(0, 0\); the nearest is 20,000 m"
    ):
        read_road(path, around=(0.0, 0.0), radius=5.0)
