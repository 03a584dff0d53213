"""Lanes, directions, links, speed limits and junctions of OpenDRIVE."""

from pathlib import Path

import numpy as np
import pytest
from handmade_maps import lane, lanes_of, opendrive, polynomial, read, road, section

FORTH = (0.0, 0.0, 0.0, 100.0)
"""x, y, heading and length."""


def names(found: object) -> list[list[str]]:
    return [[lane.id for lane in road.lanes] for road in found.roads]  # type: ignore[attr-defined]


@pytest.mark.parametrize(
    ("rule", "expected"),
    [
        ("RHT", {"1.0.1": (100, -1.75, 0), "1.0.-1": (0, 1.75, 100), "1.0.-2": (0, 5.25, 100)}),
        ("LHT", {"1.0.1": (0, -1.75, 100), "1.0.-1": (100, 1.75, 0), "1.0.-2": (100, 5.25, 0)}),
    ],
)
def test_lanes_lead_where_traffic_drives_and_y_is_to_the_right(
    tmp_path: Path, rule: str, expected: dict[str, tuple[float, ...]]
) -> None:
    lanes = section(lane(1), lane(-1) + lane(-2) + lane(-3, 1.5, "shoulder"))
    text = opendrive(road("1", FORTH, lanes, attributes=f'rule="{rule}"'))
    found = read(tmp_path, text)
    ends = {
        name: (*each.points[0, :2], each.points[-1, 0]) for name, each in lanes_of(found).items()
    }
    assert ends.keys() == expected.keys()
    for name, each in ends.items():
        assert each == pytest.approx(expected[name], abs=1e-9)
    # From the left: lane -1 is beside the centre, which is on the left in right-hand traffic.
    right = ["1.0.-1", "1.0.-2"]
    assert names(found) == [["1.0.1"], right if rule == "RHT" else right[::-1]]
    assert found.left_hand_traffic == (rule == "LHT")
    assert found.left_out == {"of type 'shoulder'": 1}


def test_a_lane_of_another_kind_separates_lanes(tmp_path: Path) -> None:
    lanes = section(right=lane(-1) + lane(-2, 1.0, "median") + lane(-3))
    found = read(tmp_path, opendrive(road("1", FORTH, lanes)))
    assert names(found) == [["1.0.-1"], ["1.0.-3"]]


def test_widths_offsets_heights_and_banks_move_the_centre_line(tmp_path: Path) -> None:
    widths = polynomial("width", "sOffset", 0, 3.0) + polynomial("width", "sOffset", 50, 3.0, 0.02)
    others = f"<elevationProfile>{polynomial('elevation', 's', a=2.0, b=0.05)}</elevationProfile>"
    others += f"<lateralProfile>{polynomial('superelevation', 's', a=0.1)}</lateralProfile>"
    lanes = polynomial("laneOffset", "s", a=1.0) + section(right=lane(-1, widths))
    found = lanes_of(read(tmp_path, opendrive(road("1", FORTH, lanes, others=others))))["1.0.-1"]
    # At the end the lane is 4 m wide, so its centre is 1 m to the right of the reference line.
    cosine, sine = np.cos(0.1), np.sin(0.1)
    assert found.points[0] == pytest.approx((0, 0.5 * cosine, 2 - 0.5 * sine, 3 * cosine), abs=1e-6)
    assert found.points[-1] == pytest.approx((100, cosine, 7 - sine, 4 * cosine), abs=1e-6)


def test_lanes_follow_each_other_over_sections_and_roads(tmp_path: Path) -> None:
    first = section(lane(1, after=1), lane(-1, after=-1))
    second = section(lane(1, before=1), lane(-1, before=-1) + lane(-2, after=1), s=60.0)
    link = '<successor elementType="road" elementId="{}" contactPoint="end"/>'
    one = road("1", FORTH, first + second, link=link.format(2))
    # The other road comes from the opposite direction: its left is on the same side as their right.
    two = road(
        "2", (200.0, -3.5, np.pi, 100.0), section(left=lane(1, after=-2)), link=link.format(1)
    )
    lanes = lanes_of(read(tmp_path, opendrive(one, two)))
    assert {name: each.successors for name, each in lanes.items()} == {
        "1.0.1": (),
        "1.0.-1": ("1.1.-1",),
        "1.1.1": ("1.0.1",),
        "1.1.-1": (),
        "1.1.-2": ("2.0.1",),
        "2.0.1": (),
    }


def test_speed_limits_are_metres_per_second_and_divide_lanes(tmp_path: Path) -> None:
    kmh = '<type s="0" type="town"><speed max="36" unit="km/h"/></type>'
    mph = '<type s="40" type="town"><speed max="10" unit="mph"/></type>'
    none = '<type s="70" type="motorway"><speed max="no limit"/></type>'
    own = '<speed sOffset="90" max="7" unit="m/s"/>'
    text = opendrive(road("1", FORTH, section(right=lane(-1, others=own)), others=kmh + mph + none))
    lanes = list(read(tmp_path, text).lanes)
    assert [each.speed_limit for each in lanes] == [10.0, pytest.approx(4.4704), None, 7.0]
    assert [each.length for each in lanes] == [40, 30, 20, 10]
    assert [each.successors for each in lanes] == [("1.1.-1",), ("1.2.-1",), ("1.3.-1",), ()]


def test_a_junction_links_roads_and_knows_who_gives_way(tmp_path: Path) -> None:
    to = '<{} elementType="{}" elementId="{}" contactPoint="{}"/>'
    straight, ends = (0.0, 0.0, 0.0, 50.0), to.format("successor", "junction", 9, "start")
    incoming = [
        road("1", straight, section(right=lane(-1)), link=ends),
        road("2", (75.0, -75.0, np.pi / 2, 50.0), section(right=lane(-1)), link=ends),
    ]
    across = [
        road("3", (50.0, 0.0, 0.0, 50.0), section(right=lane(-1, before=-1)), junction="9",
             link=to.format("predecessor", "road", 1, "end")),
        road("4", (75.0, -25.0, np.pi / 2, 50.0), section(right=lane(-1, before=-1)), junction="9",
             link=to.format("predecessor", "road", 2, "end")),
    ]  # fmt: skip
    connect = '<connection id="{0}" incomingRoad="{0}" connectingRoad="{1}" contactPoint="start">'
    links = "".join(
        connect.format(*pair) + '<laneLink from="-1" to="-1"/></connection>'
        for pair in ((1, 3), (2, 4))
    )
    junction = f'<junction id="9">{links}<priority high="3" low="4"/></junction>'
    found = read(tmp_path, opendrive(*incoming, *across, junction))
    assert lanes_of(found)["1.0.-1"].successors == ("3.0.-1",)
    (conflict,) = found.conflicts
    # Lane 4.0.-1 drives north at x = 76.75, and lane 3.0.-1 east at y = -1.75 of the map.
    assert conflict.lanes == ("3.0.-1", "4.0.-1")
    assert conflict.at == pytest.approx((26.75, 23.25))
    assert (conflict.kind, conflict.gives_way) == ("crossing", "4.0.-1")
    assert found.junctions == ("9",)


def test_a_direct_junction_splits_a_road(tmp_path: Path) -> None:
    there = '<successor elementType="junction" elementId="9"/>'
    back = '<predecessor elementType="junction" elementId="9"/>'
    roads = [
        road("1", FORTH, section(right=lane(-1) + lane(-2)), link=there),
        road("2", (100.0, 0.0, 0.0, 50.0), section(right=lane(-1)), link=back),
        road("3", (100.0, -3.5, 0.0, 50.0), section(right=lane(-1)), link=back),
    ]
    connections = "".join(
        f'<connection id="{k}" incomingRoad="1" linkedRoad="{k}" contactPoint="start">'
        f'<laneLink from="-{k - 1}" to="-1"/></connection>'
        for k in (2, 3)
    )
    junction = f'<junction id="9" type="direct">{connections}</junction>'
    lanes = lanes_of(read(tmp_path, opendrive(*roads, junction)))
    assert lanes["1.0.-1"].successors == ("2.0.-1",)
    assert lanes["1.0.-2"].successors == ("3.0.-1",)


def test_a_loop_closes_and_is_cut_so_that_positions_are_found(tmp_path: Path) -> None:
    link = "".join(
        f'<{tag} elementType="road" elementId="1" contactPoint="{contact}"/>'
        for tag, contact in (("predecessor", "end"), ("successor", "start"))
    )
    circle = '<geometry s="0" x="0" y="0" hdg="0" length="{0!r}"><arc curvature="0.02"/></geometry>'
    lanes = section(right=lane(-1, before=-1, after=-1))
    text = opendrive(road("1", circle.format(2 * np.pi * 50), lanes, link=link))
    found = read(tmp_path, text)
    lane_of = lanes_of(found)
    here, seen = "1.0.-1/1", []
    while here not in seen:
        seen.append(here)
        (here,) = lane_of[here].successors
    assert here == seen[0]
    assert len(seen) == len(lane_of) >= 2
    assert sum(each.length for each in lane_of.values()) == pytest.approx(
        2 * np.pi * 51.75, rel=1e-3
    )


def test_signals_stand_beside_the_lanes_for_which_they_are(tmp_path: Path) -> None:
    signals = (
        '<signals><signal id="7" s="90" t="-6" dynamic="yes" orientation="+" type="1000001"/>'
        '<signal id="8" s="10" t="6" dynamic="no" orientation="-" type="274" subtype="30"/>'
        "</signals>"
    )
    text = opendrive(road("1", FORTH, section(lane(1), lane(-1)), others=signals))
    light, sign = read(tmp_path, text).signals
    assert (light.kind, light.x, light.y, light.lanes) == ("light", 90, 6, ("1.0.-1",))
    assert (sign.kind, sign.x, sign.y, sign.lanes) == ("sign", 10, -6, ("1.0.1",))
    assert sign.code == "274-30"


def test_large_coordinates_are_moved_and_lose_no_digits(tmp_path: Path) -> None:
    x, y = 691000.123456, 5334000.654321
    found = read(tmp_path, opendrive(road("1", (x, y, 0.0, 10.0), section(right=lane(-1)))))
    start = lanes_of(found)["1.0.-1"].points[0]
    assert abs(start[:2]).max() < 10
    assert found.origin[0] + start[0] == pytest.approx(x, abs=1e-6)
    assert found.origin[1] - start[1] == pytest.approx(y - 1.75, abs=1e-6)


def test_sections_shorter_than_a_centimetre_are_passed_over(tmp_path: Path) -> None:
    sections = [
        section(right=lane(-1, after=-1)),
        section(right=lane(-1, before=-1, after=-1), s=50.0),
        section(right=lane(-1, before=-1), s=50.001),
    ]
    lanes = lanes_of(read(tmp_path, opendrive(road("1", FORTH, "".join(sections)))))
    assert {name: each.successors for name, each in lanes.items()} == {
        "1.0.-1": ("1.2.-1",),
        "1.2.-1": (),
    }


def test_borders_are_measured_from_the_centre(tmp_path: Path) -> None:
    lanes = (lane(-k, polynomial("border", "sOffset", a=a)) for k, a in ((1, -3.0), (2, -7.0)))
    found = lanes_of(read(tmp_path, opendrive(road("1", FORTH, section(right="".join(lanes))))))
    assert [each.points[0, [1, 3]].tolist() for each in found.values()] == [[1.5, 3], [5, 4]]


def test_a_section_of_one_side_leaves_the_other_side_whole(tmp_path: Path) -> None:
    first = section(lane(1), lane(-1, after=-1))
    second = section(right=lane(-1, before=-1), s=60.0).replace(" s=", ' singleSide="true" s=')
    found = lanes_of(read(tmp_path, opendrive(road("1", FORTH, first + second))))
    assert {name: each.length for name, each in found.items()} == {
        "1.0.1": 100,
        "1.0.-1": 60,
        "1.1.-1": 40,
    }
    assert found["1.0.-1"].successors == ("1.1.-1",)


@pytest.mark.parametrize(
    ("kind", "attributes", "reason"),
    [
        ("bidirectional", "", "of type 'bidirectional'"),
        ("driving", 'direction="reversed"', "of direction 'reversed'"),
        ("bus", "", "of type 'bus'"),
    ],
)
def test_lanes_that_cars_do_not_drive_as_others_are_left_out(
    tmp_path: Path, kind: str, attributes: str, reason: str
) -> None:
    odd = lane(-2, kind=kind).replace("<lane ", f"<lane {attributes} ")
    found = read(tmp_path, opendrive(road("1", FORTH, section(right=lane(-1) + odd))))
    assert list(lanes_of(found)) == ["1.0.-1"]
    assert found.left_out == {reason: 1}
