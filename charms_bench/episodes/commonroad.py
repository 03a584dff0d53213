"""A replayed episode as a CommonRoad scenario [Althoff et al. 2017], in the XML format 2020a.

The file is written here and not by commonroad-io, which pins protobuf to a version that onnx and
newer releases of onnxruntime rule out; a run is replayed with the onnxruntime that it was run with.
CommonRoad's y axis points to the left and its headings are positive to the left.
"""

from pathlib import Path
from xml.etree import ElementTree
from xml.etree.ElementTree import Element, SubElement

import numpy as np

from charms_bench.episodes.replay import Replay
from charms_bench.errors import InputError
from charms_bench.foundation.files import write_bytes
from charms_bench.world.vehicle_types import TRUCK_LENGTH_M

FIRST_VEHICLE = 1001
"""Identifier of the obstacle that is vehicle 0; lanelets are counted from 1."""
PLANNING_PROBLEM = 1_000_000
DATE = "1970-01-01"
"""The format requires a date; with this one, the same episode is always the same file."""
MARGIN_M = 100.0
POINT_DISTANCE_M = 10.0


def check_commonroad(path: Path) -> None:
    """Raises an `InputError` if a file name does not end in `.xml`."""
    if path.suffix != ".xml":
        raise InputError(f"{path}: expected the name of a CommonRoad scenario, ending in .xml")


def write_commonroad(replay: Replay, path: Path) -> None:
    """Writes an episode, one time step per simulation step; see `ShownReplay.write_commonroad`."""
    check_commonroad(path)
    replay.cell.scene.check_straight("CommonRoad scenarios are written of")
    root = Element(
        "commonRoad",
        commonRoadVersion="2020a",
        benchmarkID=f"ZAM_CharmsBench-{replay.settings.lanes}_{replay.episode + 1}_T-1",
        date=DATE,
        author="charms-bench",
        affiliation="",
        source=f"{replay.cell.title}, episode {replay.episode}",
        timeStepSize=_decimal(1 / replay.settings.simulation_hz),
    )
    # No place on Earth has these coordinates, which CommonRoad uses for an invented road.
    location = SubElement(root, "location")
    for name, value in (("geoNameId", "-999"), ("gpsLatitude", "999"), ("gpsLongitude", "999")):
        SubElement(location, name).text = value
    tags = SubElement(root, "scenarioTags")
    for tag in ("highway", "multi_lane", "no_oncoming_traffic", "simulated"):
        SubElement(tags, tag)
    _add_lanelets(root, replay)
    for vehicle in np.nonzero(replay.present.any(axis=0))[0].tolist():
        _add_vehicle(root, replay, vehicle)
    # The planning problem is the ego's start, and as its goal the time when the episode ends.
    problem = SubElement(root, "planningProblem", id=str(PLANNING_PROBLEM))
    _add_state(problem, "initialState", replay, replay.ego, 0)
    time = SubElement(SubElement(problem, "goalState"), "time")
    for name in ("intervalStart", "intervalEnd"):
        SubElement(time, name).text = str(len(replay.t_s) - 1)
    ElementTree.indent(root)
    write_bytes(path, ElementTree.tostring(root, "utf-8", xml_declaration=True))


def _add_lanelets(root: Element, replay: Replay) -> None:
    lanes, width = replay.settings.lanes, replay.settings.profile.lane_width_m
    x = replay.x[replay.present]
    start, end = x.min() - MARGIN_M, x.max() + MARGIN_M
    along = np.linspace(start, end, int((end - start) // POINT_DISTANCE_M) + 2)
    for lane in range(lanes):
        lanelet = SubElement(root, "lanelet", id=str(lane + 1))
        for name, edge, outer in (("leftBound", -0.5, 0), ("rightBound", 0.5, lanes - 1)):
            bound = SubElement(lanelet, name)
            for x in along:
                _add_point(bound, float(x), (lane + edge) * width)
            SubElement(bound, "lineMarking").text = "solid" if lane == outer else "dashed"
        for name, other in (("adjacentLeft", lane), ("adjacentRight", lane + 2)):
            if 1 <= other <= lanes:
                SubElement(lanelet, name, ref=str(other), drivingDir="same")
        SubElement(lanelet, "laneletType").text = "highway"
        SubElement(lanelet, "userOneWay").text = "vehicle"


def _add_vehicle(root: Element, replay: Replay, vehicle: int) -> None:
    obstacle = SubElement(root, "dynamicObstacle", id=str(FIRST_VEHICLE + vehicle))
    length, width = float(replay.length[0, vehicle]), float(replay.width[0, vehicle])
    SubElement(obstacle, "type").text = "car" if length < TRUCK_LENGTH_M else "truck"
    shape = SubElement(SubElement(obstacle, "shape"), "rectangle")
    SubElement(shape, "length").text = _decimal(length)
    SubElement(shape, "width").text = _decimal(width)
    first, *others = np.nonzero(replay.present[:, vehicle])[0].tolist()
    _add_state(obstacle, "initialState", replay, vehicle, first)
    trajectory = SubElement(obstacle, "trajectory")
    for frame in others:
        _add_state(trajectory, "state", replay, vehicle, frame)


def _add_state(parent: Element, kind: str, replay: Replay, vehicle: int, frame: int) -> None:
    state, place = SubElement(parent, kind), (frame, vehicle)
    _add_point(SubElement(state, "position"), replay.x[place], replay.y[place])
    values = {
        "orientation": _decimal(-replay.heading[place]),
        "time": str(frame),
        "velocity": _decimal(replay.speed[place]),
        "acceleration": _decimal(replay.acceleration[place]),
    }
    if kind == "initialState":  # a vehicle starts along the road
        values |= {"yawRate": "0.0", "slipAngle": "0.0"}
    for name, value in values.items():
        SubElement(SubElement(state, name), "exact").text = value


def _add_point(parent: Element, x: float, y: float) -> None:
    point = SubElement(parent, "point")
    SubElement(point, "x").text = _decimal(x)
    SubElement(point, "y").text = _decimal(-y)


def _decimal(value: float) -> str:
    """Returns the shortest decimal that gives this number again; the format has no exponents."""
    return np.format_float_positional(value + 0.0, trim="0")  # + 0.0 turns -0.0 into 0.0
