"""Faulty maps give one line that names the element; nothing hangs, nothing is silently wrong."""

import random
import re
from pathlib import Path

import numpy as np
import pytest
from handmade_maps import (
    LINE,
    commonroad,
    connection,
    edge,
    lane,
    lanelet,
    opendrive,
    polynomial,
    read,
    road,
    section,
    sumo,
)

from charms_bench.errors import MapError
from charms_bench.maps.reading import read_road
from charms_bench.maps.road_map import RoadMap

FORTH = (0.0, 0.0, 0.0, 100.0)
LANES = section(lane(1, after=1), lane(-1, after=-1))
TO = '<successor elementType="road" elementId="2" contactPoint="start"/>'
TWO = [
    road("1", FORTH, LANES, link=TO),
    road("2", (100.0, 0.0, 0.0, 50.0), section(lane(1), lane(-1))),
]
BOMB = (
    '<?xml version="1.0"?><!DOCTYPE b [<!ENTITY a "ha"><!ENTITY b "&a;&a;&a;&a;">]>'
    "<OpenDRIVE>&b;</OpenDRIVE>"
)
SQUARE = [(0, 4), (50, 4)], [(0, 0), (50, 0)]
NET = [
    edge("a", "0,0 50,0", ends=("1", "2")),
    edge("b", "50,0 99,0", ends=("2", "3")),
    connection("a", "b"),
]


def alone(*parts: str, others: str = "") -> str:
    """A file of one road with such lanes on the right."""
    return opendrive(road("1", FORTH, section(right="".join(parts)), others=others))


NARROWING = polynomial("width", "sOffset", 0, 3, -0.1)
STEEP = f"<elevationProfile>{polynomial('elevation', 's', c=5.0)}</elevationProfile>"
KNOTS = '<type s="0"><speed max="30" unit="knots"/></type>'
APART = LINE.format(x=0, y=0, heading=0, length=10) + LINE.format(
    x=12, y=0, heading=0, length=10
).replace('s="0"', 's="10"')
IN_A_CIRCLE = [
    lanelet(one, *SQUARE, *(f'<adjacent{s} ref="{other}" drivingDir="same"/>' for s in sides))
    for one, other, sides in ((1, 2, ("Left", "Right")), (2, 1, ("Left", "Right")))
]
FAULTS = {
    "": "line 1: not XML: no element found; expected an OpenDRIVE file, a SUMO network, a",
    "lanes: 3": "line 1: not XML: syntax error",
    "{": "Invalid JSON",
    "<osm/>": "line 1: the root is <osm>, no known format. Known: OpenDRIVE, commonRoad, net",
    BOMB: "line 1: declares or uses the entity 'a'",
    "<net>" + "<a>" * 70: "nested 64 elements deep",
    opendrive(*TWO)[:-600]: "is it cut short?",
    opendrive(): "has no lane on which cars drive (it has no lanes)",
    alone(lane(-1, kind="sidewalk")): "has no lane on which cars drive (1 of type 'sidewalk')",
    opendrive(*TWO).replace('revMinor="6"', 'revMinor="9"'): "<header>: is OpenDRIVE 1.9",
    opendrive(TWO[0], TWO[1].replace('x="100.0"', 'x="110.0"')): "<lane id='1'> of road '2': ends "
    "10.00 m from where the following lane '1.0.1' starts; expected at most 0.5 m",
    opendrive(TWO[0]): "<successor> in <road id='1'>: leads to road '2', which the file does not",
    opendrive(*TWO).replace('<successor id="-1"/>', '<successor id="-3"/>'): "<successor id='-3'> "
    "in <road id='1'>: leads to lane -3 at the start of road '2', which does not have it; its "
    "lanes: -1, 1",
    opendrive(*TWO).replace('contactPoint="start"', 'contactPoint="end"'): "in which cars drive in "
    "the opposite direction; correct the link",
    opendrive(TWO[0], TWO[0]): "<road id='1'>: another road has this id; ids must differ",
    opendrive(road("1", (0.0, float("nan"), 0.0, 9.0), LANES)): "<geometry> in <road id='1'>: y is "
    "'nan'; expected a finite number",
    opendrive(road("1", (0.0, 0.0, 0.0, 0.0), LANES)): "<road id='1'>: is 0 m long",
    opendrive(
        road("1", (0.0, 0.0, 0.0, -3.0), LANES)
    ): "length is '-3.0'; expected a number from 0",
    opendrive(road("1", APART, LANES)): "its <geometry> at s=10 starts 2.00 m from where the one",
    alone(lane(-1, 0.0)): "has no lane on which cars drive (1 without a width)",
    alone(lane(-1, NARROWING)): "<lane id='-1'> in <road id='1'>: is -7.00 m wide somewhere",
    alone(lane(-1), others=KNOTS): "<speed> in <road id='1'>: unit is 'knots'; expected m/s, km/h",
    alone(lane(-1), others=STEEP): "its height goes from",
    alone(lane(-1) + lane(-1)): "another lane of the section has this id",
    alone(lane(1)): "is on the right, where ids are below 0",
    opendrive('<road id="1" length="5"/>'): "<road id='1'>: has no <lanes>",
    sumo(NET[0], NET[2]): "<connection>: to is 'b', an edge that the file does not have",
    sumo(*NET[:2], connection("a", "b", (0, 3))): "toLane is 3, but edge 'b' has 1 lanes",
    sumo(*NET[:2], connection("a", "b", via=":J_0")): "via is ':J_0', a lane that the file does",
    sumo(*NET).replace("0,0 50,0", "0,0"): "its shape is not a list of at least two points",
    sumo(*NET).replace("0,0 50,0", "0,0 5,inf"): "shape is 'inf'; expected a finite number",
    sumo(*NET).replace("50,0 99,0", "500,0 9,0"): "ends 450.00 m from where the following lane",
    sumo(edge("a", "0,0 9,0", ends=("1", "2"), lane='width="0"')): "width is 0; expected more",
    sumo(*NET).replace('index="0"', 'index="1"'): "indices of its lanes are not 0, 1, 2",
    commonroad(lanelet(1, *SQUARE)).replace("2020a", "2017"): "version '2017'; expected 2018b",
    commonroad(lanelet(1, SQUARE[0], SQUARE[0])): "its left bound is its right bound",
    commonroad(lanelet(1, SQUARE[0], SQUARE[1][:1])): "its bounds have 2 and 1 points",
    commonroad(lanelet(1, *SQUARE, '<successor ref="9"/>')): "line 4: <successor> in <lanelet "
    "id='1'>: refers to lanelet '9', which the file does not have",
    commonroad(*IN_A_CIRCLE): "is its own neighbour, by way of its neighbours",
    commonroad(lanelet(1, *SQUARE).replace("<x>50</x>", "<x>5O</x>")): "<x> in <lanelet id='1'>: x "
    "is '5O'; expected a finite number",
}
"""Faulty files, and what their errors say."""


@pytest.mark.parametrize(("text", "what"), FAULTS.items(), ids=FAULTS.values())
def test_a_fault_is_named_in_one_line(tmp_path: Path, text: str, what: str) -> None:
    with pytest.raises(MapError) as error:
        read(tmp_path, text)
    message = str(error.value)
    assert message.startswith(f"{tmp_path / 'map.xml'}: ")
    assert what in message
    assert "\n" not in message


def test_files_that_are_not_maps_are_rejected(tmp_path: Path) -> None:
    with pytest.raises(MapError, match=r"no\.xml: cannot be read: No such file"):
        read_road(tmp_path / "no.xml")
    (tmp_path / "zipped.xml").write_bytes(b"\x1f\x8b\x08\x00")
    with pytest.raises(MapError, match="is compressed; expected text"):
        read_road(tmp_path / "zipped.xml")
    with pytest.raises(MapError, match="cannot be read: is a folder"):
        read_road(tmp_path)


MAPS = {
    "OpenDRIVE": opendrive(*TWO, road("3", (0.0, 90.0, 0.3, 80.0), LANES)),
    "SUMO": sumo(
        *NET, '<junction id="2" incLanes="a_0"><request index="0" response="0"/></junction>'
    ),
    "CommonRoad": commonroad(
        lanelet(1, *SQUARE, "<laneletType>urban</laneletType>"), lanelet(2, *SQUARE)
    ),
}


@pytest.mark.parametrize("name", MAPS)
def test_mutated_maps_are_read_or_rejected(tmp_path: Path, name: str) -> None:
    rng = random.Random(name)
    for _ in range(60):
        text = MAPS[name]
        for _ in range(rng.choice((1, 1, 3))):
            text = mutated(text, rng)
        try:
            found = read(tmp_path, text)
        except MapError as error:
            lines = str(error).splitlines()
        else:
            lines = [""]
            check(found)
        assert len(lines) == 1


def check(found: RoadMap) -> None:
    for each in found.lanes:
        assert np.isfinite(each.points).all()
        assert each.length > 0
        assert (each.points[:, 3] >= 0).all()


def mutated(text: str, rng: random.Random) -> str:
    """The text with one fault: a number, an attribute, an element, a line or a character."""
    kind = rng.randrange(6)
    patterns = (r"-?\d+\.?\d*(?=[\"<, ])", r' \w+="[^"]*"', r"<\w+[^<>]*/>", r"<\w+>[^<>]*</\w+>")
    found = list(re.finditer(patterns[min(kind, 3)], text))
    if kind == 4 or not found:
        return text[: rng.randrange(len(text))]
    if kind == 5:
        at = rng.randrange(len(text))
        return text[:at] + chr(rng.randrange(32, 300)) + text[at + 1 :]
    match = rng.choice(found)
    new = (
        rng.choice(("nan", "1e308", "-1", "0", "", "x", "1e6"))
        if kind == 0
        else rng.choice(("", match[0] * 2))
    )
    return text[: match.start()] + new + text[match.end() :]
