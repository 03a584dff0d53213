"""CommonRoad scenarios: the trajectories of a replay, in CommonRoad's axes.

commonroad-io reads them in `test_commonroad_against_crime.py`, which `tox -e crime` runs.
"""

from dataclasses import replace
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
from handmade_replay import replay_of

from charms_bench.episodes.commonroad import write_commonroad
from charms_bench.errors import InputError

REPLAY = replay_of(
    x=[[100.0, 130.0], [102.0, 131.5]],
    y=[[4.0, 0.0], [4.1, 0.0]],
    heading=[[0.0, 0.0], [0.05, 1e-7]],
    speed=[[30.0, 22.5], [30.0, 22.5]],
    acceleration=[[0.0, 0.0], [-1.5, 0.0]],
)


@pytest.fixture
def root(tmp_path: Path) -> ElementTree.Element:
    write_commonroad(REPLAY, tmp_path / "episode.xml")
    return ElementTree.parse(tmp_path / "episode.xml").getroot()


def test_positions_and_headings_are_positive_to_the_left(root: ElementTree.Element) -> None:
    ego = root.find("dynamicObstacle[@id='1001']")
    assert ego is not None
    state = ego.find("trajectory/state")
    assert state is not None
    found = {
        name: state.findtext(path)
        for name, path in {
            "x": "position/point/x",
            "y": "position/point/y",
            "orientation": "orientation/exact",
            "time": "time/exact",
            "velocity": "velocity/exact",
            "acceleration": "acceleration/exact",
        }.items()
    }
    assert found == {
        "x": "102.0",
        "y": "-4.1",
        "orientation": "-0.05",
        "time": "1",
        "velocity": "30.0",
        "acceleration": "-1.5",
    }


def test_no_number_has_an_exponent_or_loses_digits(root: ElementTree.Element) -> None:
    other = root.findall("dynamicObstacle")[1]
    assert other.findtext("trajectory/state/orientation/exact") == "-0.0000001"
    assert root.get("timeStepSize") == repr(1 / 15)


def test_lanelets_are_the_lanes_from_left_to_right(root: ElementTree.Element) -> None:
    lanelets = root.findall("lanelet")
    edges = [
        [float(lanelet.findtext(f"{side}Bound/point/y", "")) for side in ("left", "right")]
        for lanelet in lanelets
    ]
    assert edges == [[2.0, -2.0], [-2.0, -6.0], [-6.0, -10.0]]
    along = [float(x.text or "") for x in lanelets[0].iterfind("leftBound/point/x")]
    assert (along[0], along[-1]) == (0.0, 231.5)
    assert max(np.diff(along)) <= 10.0
    middle = {side: lanelets[1].find(f"adjacent{side}") for side in ("Left", "Right")}
    assert {side: each.get("ref") for side, each in middle.items() if each is not None} == {
        "Left": "1",
        "Right": "3",
    }


def test_the_same_episode_is_always_the_same_file(tmp_path: Path) -> None:
    for name in ("one.xml", "two.xml"):
        write_commonroad(REPLAY, tmp_path / name)
    assert (tmp_path / "one.xml").read_bytes() == (tmp_path / "two.xml").read_bytes()


def test_another_name_is_rejected(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"episode\.json: expected .* ends in \.xml"):
        write_commonroad(REPLAY, tmp_path / "episode.json")


def test_a_truck_has_its_own_size_and_type(tmp_path: Path) -> None:
    replayed = replay_of(x=[[100.0, 130.0]] * 2, length=[[5.0, 16.0]] * 2, width=[[2.0, 2.5]] * 2)
    write_commonroad(replayed, tmp_path / "episode.xml")
    found = ElementTree.parse(tmp_path / "episode.xml").getroot().findall("dynamicObstacle")
    names = ("type", "shape/rectangle/length", "shape/rectangle/width")
    said = [tuple(each.findtext(name) for name in names) for each in found]
    assert said == [("car", "5.0", "2.0"), ("truck", "16.0", "2.5")]


@pytest.mark.parametrize("is_absent", [True, False])
def test_a_vehicle_that_comes_to_the_place_of_another_one_is_an_obstacle_of_its_own(
    is_absent: bool, tmp_path: Path
) -> None:
    x = [[100.0, 130.0], [102.0, 131.5], [104.0, 133.0], [106.0, 20.0], [108.0, 21.5]]
    there = np.array([[True, True]] * 2 + [[True, not is_absent]] + [[True, True]] * 2)
    write_commonroad(replace(replay_of(x=x), present=there), tmp_path / "episode.xml")
    root = ElementTree.parse(tmp_path / "episode.xml").getroot()
    times = {
        obstacle.get("id"): [each.findtext("exact") for each in obstacle.iter("time")]
        for obstacle in root.findall("dynamicObstacle")
    }
    first = ["0", "1"] if is_absent else ["0", "1", "2"]
    assert times == {"1001": ["0", "1", "2", "3", "4"], "1002": first, "500000": ["3", "4"]}
