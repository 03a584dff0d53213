"""Lanelets of CommonRoad."""

from pathlib import Path

import pytest
from handmade_maps import commonroad, lanelet, lanes_of, read

HERE = [(0, 4), (50, 4)], [(0, 0), (50, 0)]
BESIDE = [(0, 0), (50, 0)], [(0, -3), (50, -3)]
ON = [(50, 4), (100, 5)], [(50, 0), (100, 0)]
SIGN = (
    '<trafficSign id="7"><trafficSignElement><trafficSignID>{}</trafficSignID>'
    "<additionalValue>13.5</additionalValue></trafficSignElement></trafficSign>"
)


def test_neighbours_are_lanes_of_a_road_and_the_middle_is_the_centre_line(tmp_path: Path) -> None:
    text = commonroad(
        lanelet(1, *BESIDE, '<adjacentLeft ref="2" drivingDir="same"/>'),
        lanelet(2, *HERE, '<successor ref="3"/><adjacentRight ref="1" drivingDir="same"/>'),
        lanelet(3, *ON, '<predecessor ref="2"/>'),
    )
    found = read(tmp_path, text)
    assert [[lane.id for lane in road.lanes] for road in found.roads] == [["2", "1"], ["3"]]
    lanes = lanes_of(found)
    assert lanes["3"].points.tolist() == [[50, -2, 0, 4], [100, -2.5, 0, 5]]
    assert {name: lane.successors for name, lane in lanes.items()} == {
        "2": ("3",),
        "1": (),
        "3": (),
    }
    assert found.roads[0].end == found.roads[1].start


def test_lanelets_in_the_other_direction_are_another_road(tmp_path: Path) -> None:
    back = [each[::-1] for each in reversed(BESIDE)]
    text = commonroad(
        lanelet(1, *HERE, '<adjacentRight ref="2" drivingDir="opposite"/>'),
        lanelet(2, *back, '<adjacentRight ref="1" drivingDir="opposite"/>'),
    )
    assert [len(road.lanes) for road in read(tmp_path, text).roads] == [1, 1]


@pytest.mark.parametrize(
    ("others", "reason"),
    [
        ("<laneletType>sidewalk</laneletType>", "of type 'sidewalk'"),
        ("<laneletType>urban</laneletType><laneletType>busLane</laneletType>", "of type 'busLane'"),
        ("<userOneWay>bicycle</userOneWay>", "not for cars"),
        ("<userBidirectional>vehicle</userBidirectional>", "driven in both directions"),
    ],
)
def test_lanelets_without_cars_are_left_out(tmp_path: Path, others: str, reason: str) -> None:
    found = read(tmp_path, commonroad(lanelet(1, *HERE), lanelet(2, *ON, others)))
    assert list(lanes_of(found)) == ["1"]
    assert found.left_out == {reason: 1}


@pytest.mark.parametrize(("code", "limit"), [("R2-1", 13.5), ("274", 13.5), ("R3-4", None)])
def test_signs_of_speed_limits_apply_to_the_lanelets_that_name_them(
    tmp_path: Path, code: str, limit: float | None
) -> None:
    light = (
        '<trafficLight id="8"><position><point><x>49</x><y>5</y></point></position></trafficLight>'
    )
    names = '<trafficSignRef ref="7"/><trafficLightRef ref="8"/>'
    text = commonroad(lanelet(1, *HERE, names), lanelet(2, *ON), SIGN.format(code), light)
    found = read(tmp_path, text)
    assert [lane.speed_limit for lane in found.lanes] == [limit, None]
    places = [(each.kind, each.x, each.y, each.lanes) for each in found.signals]
    assert places == [("light", 49, -5, ("1",)), ("sign", 50, -2, ("1",))]


def test_the_format_of_2018_states_speed_limits_in_lanelets(tmp_path: Path) -> None:
    text = commonroad(lanelet(1, *HERE, "<speedLimit>27.78</speedLimit>")).replace("2020a", "2018b")
    found = read(tmp_path, text)
    assert found.format == "CommonRoad 2018b"
    assert [lane.speed_limit for lane in found.lanes] == [27.78]


def test_a_light_for_one_direction_is_before_the_ways_in_it(tmp_path: Path) -> None:
    cycle = "".join(
        f"<cycleElement><duration>{steps}</duration><color>{colour}</color></cycleElement>"
        for steps, colour in ((200, "green"), (30, "yellow"), (170, "red"))
    )
    lights = "".join(
        f'<trafficLight id="{name}"><cycle>{cycle}<timeOffset>50</timeOffset></cycle>'
        f"<direction>{direction}</direction></trafficLight>"
        for name, direction in ((8, "straightRight"), (9, "all"))
    )
    ways = '<successor ref="2"/><successor ref="3"/>'
    left = [(50, 4), (90, 30)], [(50, 0), (94, 27)]
    text = commonroad(
        lanelet(1, *HERE, ways, '<trafficLightRef ref="8"/><trafficLightRef ref="9"/>'),
        lanelet(2, *ON),
        lanelet(3, *left),
        lights,
        '<intersection id="5"><incoming id="6"><incomingLanelet ref="1"/>'
        '<successorsStraight ref="2"/><successorsLeft ref="3"/></incoming></intersection>',
    ).replace(">", ' timeStepSize="0.1">', 1)
    program = ((5, "red"), (20, "green"), (15, "red"))
    assert [(each.lanes, each.program) for each in read(tmp_path, text).signals] == [
        (("2",), program),
        (("1",), program),
    ]
