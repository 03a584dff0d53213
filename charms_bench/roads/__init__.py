"""highway-env's environments, seed for seed and bit for bit.

On most of their roads, vehicles have no common order and no common direction, which is what the
engine of the straight road is fast by: it sorts vehicles by x, keeps tables of neighbours and
computes in loops over all vehicles. Here, each vehicle asks the lanes, one after the other, as in
highway-env. So networks have a small engine of their own, which shares the lanes (`world.road`),
the portable mathematics, the random generator, the constants and the collision test. A vehicle is a
row of a table (`scenes.VEHICLE`), because compiled code passes a row as one pointer.

Lanes, obstacles and default configurations are data here, equal to those of highway-env, which is
not imported.
"""

TASKS = {
    "highway-v0": "highway:Highway",
    "highway-fast-v0": "highway:FastHighway",
    "merge-v0": "merge:Merge",
    "merge-v1": "merge:Merge",
    "merge-generic-v0": "merge:GenericMerge",
    "merge-generic-v1": "merge:GenericMerge",
    "two-way-v0": "two_way:TwoWay",
    "exit-v0": "exit:Exit",
    "exit-v1": "exit:Exit",
    "u-turn-v0": "u_turn:UTurn",
    "u-turn-v1": "u_turn:UTurn",
    "roundabout-v0": "roundabout:Roundabout",
    "roundabout-v1": "roundabout:Roundabout",
    "roundabout-generic-v0": "roundabout:GenericRoundabout",
    "roundabout-generic-v1": "roundabout:GenericRoundabout",
    "racetrack-v0": "racetrack:Racetrack",
    "racetrack-v1": "racetrack:Racetrack",
    "racetrack-large-v0": "racetrack:LargeRacetrack",
    "racetrack-large-v1": "racetrack:LargeRacetrack",
    "racetrack-oval-v0": "racetrack:OvalRacetrack",
    "racetrack-oval-v1": "racetrack:OvalRacetrack",
    "parking-v0": "parking:Parking",
    "parking-ActionRepeat-v0": "parking:Parking",
    "parking-parked-v0": "parking:Parking",
    "lane-keeping-v0": "lane_keeping:LaneKeeping",
    "intersection-v0": "intersection:Intersection",
    "intersection-v1": "intersection:Intersection",
    "intersection-v2": "intersection:Intersection",
    "intersection-multi-agent-v0": "intersection:Intersection",
    "intersection-multi-agent-v1": "intersection:Intersection",
    "intersection-multi-agent-v2": "intersection:Intersection",
}
"""The modules and classes of the environments by highway-env's names."""
OF_FILES = "file_road:FileRoad"
"""Those of roads in files."""

OF_SEVERAL_EGOS = tuple(name for name in TASKS if name.startswith("intersection-multi-agent"))
"""Those on whose roads the ego's agent drives several egos."""
_WITHOUT_TRAFFIC = ("parking", "lane-keeping")
OF_SUITES = tuple(
    name for name in TASKS if not (name in OF_SEVERAL_EGOS or name.startswith(_WITHOUT_TRAFFIC))
)
"""The environments on whose roads agents of the straight road drive one ego, by default."""
