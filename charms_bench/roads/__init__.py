"""highway-env's environments, seed for seed and bit for bit.

On most of their roads, vehicles have no common order and no common direction, by which the engine
of the straight road is fast. Here, each vehicle asks the lanes, one after the other, as in
highway-env. So networks have a small engine of their own, which shares the lanes (`world.road`),
the portable mathematics, the random generator, the constants and the collision test. A vehicle is a
row of a table (`scenes.VEHICLE`), because compiled code passes a row as one pointer.

Lanes, obstacles and default configurations are data here, equal to those of highway-env, which is
not imported.
"""

_VERSIONS = {
    "highway": (1, "highway:Highway"),
    "highway-fast": (1, "highway:FastHighway"),
    "merge": (2, "merge:Merge"),
    "merge-generic": (2, "merge:GenericMerge"),
    "two-way": (1, "two_way:TwoWay"),
    "exit": (2, "exit:Exit"),
    "u-turn": (2, "u_turn:UTurn"),
    "roundabout": (2, "roundabout:Roundabout"),
    "roundabout-generic": (2, "roundabout:GenericRoundabout"),
    "racetrack": (2, "racetrack:Racetrack"),
    "racetrack-large": (2, "racetrack:LargeRacetrack"),
    "racetrack-oval": (2, "racetrack:OvalRacetrack"),
    "parking": (1, "parking:Parking"),
    "parking-ActionRepeat": (1, "parking:Parking"),
    "parking-parked": (1, "parking:Parking"),
    "lane-keeping": (1, "lane_keeping:LaneKeeping"),
    "intersection": (3, "intersection:Intersection"),
    "intersection-multi-agent": (3, "intersection:Intersection"),
}
TASKS = {f"{name}-v{k}": task for name, (count, task) in _VERSIONS.items() for k in range(count)}
"""The modules and classes of the environments by highway-env's names."""
OF_FILES = "road_from_file:FileRoad"
"""Those of roads in files."""

OF_SEVERAL_EGOS = tuple(name for name in TASKS if name.startswith("intersection-multi-agent"))
"""Those on whose roads the ego's agent drives several egos."""
_WITHOUT_TRAFFIC = ("parking", "lane-keeping")
OF_SUITES = tuple(
    name for name in TASKS if not (name in OF_SEVERAL_EGOS or name.startswith(_WITHOUT_TRAFFIC))
)
"""The environments on whose roads agents of the straight road drive one ego, by default."""
