"""Lanes, links, right of way and gaps of SUMO networks."""

from pathlib import Path

import numpy as np
import pytest
from handmade_maps import connection, edge, lanes_of, read, sumo

from charms_bench.errors import MapError

EAST = edge("east", "0,-4.8 90,-4.8", "0,-1.6 90,-1.6", ends=("a", "J"))
ON = edge("on", "110,-4.8 200,-4.8", "110,-1.6 200,-1.6", ends=("J", "b"))
NORTH = edge("north", "100,-100 100,-10", ends=("c", "J"))
UP = edge("up", "100,10 100,100", ends=("J", "d"))
OVER = edge(":J_0", "90,-4.8 110,-4.8", "90,-1.6 110,-1.6")
ACROSS = edge(":J_2", "100,-10 100,-3.2") + "\n" + edge(":J_3", "100,-3.2 100,10")
LINKS = (
    connection("east", "on", (0, 0), ":J_0_0")
    + connection("east", "on", (1, 1), ":J_0_1")
    + connection("north", "up", (0, 0), ":J_2_0", others='tl="light" linkIndex="2"')
    + connection(":J_0", "on", (0, 0))
    + connection(":J_0", "on", (1, 1))
    + connection(":J_2", "up", (0, 0), ":J_3_0")
    + connection(":J_3", "up", (0, 0))
)
JUNCTION = (
    '<junction id="J" type="priority" incLanes="east_0 east_1 north_0">'
    '<request index="0" response="000"/><request index="1" response="000"/>'
    '<request index="2" response="011"/></junction>'
)
CROSSING = (EAST, ON, NORTH, UP, OVER, ACROSS, LINKS, JUNCTION)


def test_edges_are_roads_of_lanes_from_the_left_and_lead_over_internal_lanes(
    tmp_path: Path,
) -> None:
    found = read(tmp_path, sumo(*CROSSING))
    assert [lane.id for lane in found.roads[0].lanes] == ["east_1", "east_0"]
    assert {name: lane.successors for name, lane in lanes_of(found).items()} == {
        "east_1": (":J_0_1",),
        "east_0": (":J_0_0",),
        "on_1": (),
        "on_0": (),
        "north_0": (":J_2_0",),
        "up_0": (),
        ":J_0_1": ("on_1",),
        ":J_0_0": ("on_0",),
        ":J_2_0": (":J_3_0",),
        ":J_3_0": ("up_0",),
    }
    assert [road.junction for road in found.roads] == ["", "", "", "", "J", "J", "J"]
    assert [(each.id, each.lanes) for each in found.signals] == [("light", ("north_0",))]


def test_request_rows_say_who_gives_way_on_both_halves_of_a_way(tmp_path: Path) -> None:
    found = {each.lanes: each for each in read(tmp_path, sumo(*CROSSING)).conflicts}
    assert found.keys() == {(":J_0_1", ":J_3_0"), (":J_0_0", ":J_2_0")}
    assert found[":J_0_1", ":J_3_0"].gives_way == ":J_3_0"
    assert found[":J_0_0", ":J_2_0"].gives_way == ":J_2_0"
    assert found[":J_0_0", ":J_2_0"].at == pytest.approx((10.0, 5.2))


def test_lanes_without_cars_are_left_out_and_separate_lanes(tmp_path: Path) -> None:
    shapes = ("0,{0} 90,{0}".format(y) for y in (-8, -4.8, -1.6))  # noqa: UP032
    text = edge("e", *shapes, ends=("a", "b"))
    text = text.replace('index="1"', 'index="1" allow="bicycle"').replace(
        'index="0"', 'index="0" disallow="bus"'
    )
    found = read(
        tmp_path,
        sumo(text, edge(":b_c0", "0,0 1,0", attributes="").replace("internal", "crossing")),
    )
    assert [[lane.id for lane in road.lanes] for road in found.roads] == [["e_2"], ["e_0"]]
    assert found.left_out == {"not for cars": 1, "of a crossing": 1}


def test_gaps_without_internal_lanes_are_bridged_along_both_headings(tmp_path: Path) -> None:
    turn = connection("north", "on", (0, 0))
    found = read(tmp_path, sumo(NORTH, ON, turn))
    (gap,) = found.gaps
    lanes = lanes_of(found)
    (name,) = gap.bridge
    bridge = lanes[name].points
    assert gap.lanes == ("north_0", "on_0")
    assert gap.length == pytest.approx(np.hypot(10, 5.2), abs=1e-3)
    # y is to the right: the bridge starts to the north, and ends to the east.
    assert bridge[[0, -1], :2].tolist() == [[100, 10], [110, 4.8]]
    first, last = bridge[1] - bridge[0], bridge[-1] - bridge[-2]
    assert np.arctan2(first[1], first[0]) == pytest.approx(-np.pi / 2, abs=0.15)
    assert np.arctan2(last[1], last[0]) == pytest.approx(0, abs=0.15)
    assert lanes["north_0"].successors == (name,)
    assert lanes[name].successors == ("on_0",)


def test_two_ways_between_the_same_nodes_stay_two_roads(tmp_path: Path) -> None:
    wide = edge("wide", "0,0 0,50", "3,0 3,50", ends=("a", "b"))
    left = edge("left", "0,50 -20,75 0,100", ends=("b", "c"))
    right = edge("right", "3,50 20,75 3,100", ends=("b", "c"))
    end = edge("end", "0,100 0,150", "3,100 3,150", ends=("c", "d"))
    links = (
        connection("wide", "left", (0, 0))
        + connection("wide", "right", (1, 0))
        + connection("left", "end", (0, 0))
        + connection("right", "end", (0, 1))
    )
    roads = read(tmp_path, sumo(wide, left, right, end, links)).roads
    assert len({(road.start, road.end) for road in roads}) == len(roads) == 5
    lanes = [[lane.id for lane in road.lanes] for road in roads]
    assert lanes == [
        ["wide_1", "wide_0"],
        ["left_0"],
        ["right_0/1"],
        ["right_0/2"],
        ["end_1", "end_0"],
    ]
    assert roads[0].end == roads[1].start == roads[2].start
    assert roads[1].end == roads[3].end == roads[4].start


def test_left_hand_networks_count_lanes_from_the_left(tmp_path: Path) -> None:
    text = sumo(edge("e", "0,1.6 90,1.6", "0,-1.6 90,-1.6", ends=("a", "b")))
    found = read(tmp_path, text.replace("<net ", '<net lefthand="true" '))
    assert [lane.id for lane in found.roads[0].lanes] == ["e_0", "e_1"]
    assert found.left_hand_traffic


def test_roads_of_a_roundabout_are_marked(tmp_path: Path) -> None:
    found = read(tmp_path, sumo(EAST, ON, '<roundabout nodes="a J" edges="east"/>'))
    assert [road.roundabout for road in found.roads] == [True, False]


PROGRAM = (
    '<tlLogic id="light" type="{}" programID="0" offset="{}"><phase duration="20" state="rrG"/>'
    '<phase duration="3" state="rry"/><phase duration="17" state="GGr"/></tlLogic>'
)


@pytest.mark.parametrize(
    ("offset", "program"),
    [
        (0, ((20, "green"), (20, "red"))),
        (5, ((5, "red"), (20, "green"), (15, "red"))),
        (-30, ((10, "red"), (20, "green"), (10, "red"))),
    ],
)
def test_a_static_program_begins_at_its_offset_and_yellow_is_red(
    tmp_path: Path, offset: int, program: tuple[tuple[float, str], ...]
) -> None:
    found = read(tmp_path, sumo(PROGRAM.format("static", offset), *CROSSING))
    assert [(each.lanes, each.program) for each in found.signals] == [(("north_0",), program)]


def test_where_ways_from_a_lane_have_different_lights_each_is_before_the_junction(
    tmp_path: Path,
) -> None:
    others = 'tl="light" linkIndex="{}"'
    links = (
        connection("north", "up", (0, 0), ":J_2_0", others=others.format(2))
        + connection("north", "on", (0, 0), ":J_4_0", others=others.format(0))
        + connection(":J_2", "up", (0, 0))
        + connection(":J_4", "on", (0, 0))
    )
    ways = edge(":J_2", "100,-10 100,10"), edge(":J_4", "100,-10 102,-6 110,-4.8")
    text = sumo(PROGRAM.format("static", 0), ON, NORTH, UP, *ways, links)
    assert {each.lanes: each.program for each in read(tmp_path, text).signals} == {
        (":J_2_0",): ((20, "green"), (20, "red")),
        (":J_4_0",): ((23, "red"), (17, "green")),
    }


def test_programs_that_are_not_static_are_left_out(tmp_path: Path) -> None:
    found = read(tmp_path, sumo(PROGRAM.format("actuated", 0), *CROSSING))
    assert [each.program for each in found.signals] == [()]
    assert found.left_out == {"program of a traffic light of type 'actuated'": 1}


def test_a_program_without_a_link_is_a_fault(tmp_path: Path) -> None:
    text = sumo(PROGRAM.format("static", 0).replace("rrG", "rr"), *CROSSING)
    with pytest.raises(MapError, match=r"<phase> in <tlLogic id='light'>: state is 'rr', without"):
        read(tmp_path, text)
