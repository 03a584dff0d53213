"""Who is at fault for collisions on roads with junctions, in scenes made by hand.

Verdicts are those of the Vienna Convention on Road Traffic, as `roads.fault` states it: first
whether the first vehicle is at fault, then the other one. A vehicle is described by what it does
until the contact; all are 5 m long, 2 m wide, and the y-axis points to the right of the x-axis.
"""

import math
from collections.abc import Callable

import numpy as np
import pytest

from charms_bench.engine.endings import ENDINGS, OFF_ROAD, REAR_END, SIDE
from charms_bench.engine.simulation import Simulation
from charms_bench.plugins.registry import make_agent
from charms_bench.plugins.specs import TrafficSpec
from charms_bench.roads.fault import MOMENT, NO_RANK, Track, at_fault
from charms_bench.roads.settings import on_road
from charms_bench.runs.shard import engine_on
from charms_bench.world.named_road import NamedRoad
from charms_bench.world.road import closest_lane
from charms_bench.world.road_network import Network, StraightLane, network_of
from charms_bench.world.scene import SceneSettings

DT = 0.1
STEPS = 50
TWO_LANES = network_of(
    ("a", "b", StraightLane(start=(-300.0, y), end=(300.0, y))) for y in (0.0, 4.0)
)
"""Two lanes to the right of each other, in the direction of x."""
TWO_WAYS = network_of(
    [
        ("a", "b", StraightLane(start=(-300.0, 4.0), end=(300.0, 4.0))),
        ("b", "a", StraightLane(start=(300.0, 0.0), end=(-300.0, 0.0))),
    ]
)
CROSSING = network_of(
    [
        ("west", "east", StraightLane(start=(-300.0, 0.0), end=(300.0, 0.0))),
        ("south", "north", StraightLane(start=(0.0, 300.0), end=(0.0, -300.0))),
    ]
)
"""Lane 0 to the east and lane 1 to the north, from the right of lane 0."""
NOBODY = np.array([NO_RANK, NO_RANK])
Verdict = tuple[bool, bool] | None
FIRST, OTHER, BOTH = (True, False), (False, True), (True, True)


def drive(
    road: Network,
    speed: float,
    x: float,
    y: float,
    heading: float = 0.0,
    aside: Callable[[float], float] = lambda t: 0.0,
) -> Track:
    """A vehicle with constant speed along its heading, at (x, y) at the contact, at t = 0.

    Args:
        road: The lanes.
        speed: m/s.
        x: m.
        y: m.
        heading: rad.
        aside: How far to the left of (x, y) it is, by the time before the contact, m.
    """
    moments = np.zeros(STEPS, MOMENT)
    for k, moment in enumerate(moments):
        t = (STEPS - 1 - k) * DT
        left, rate = aside(t), (aside(t) - aside(t + DT)) / DT
        back = speed * t
        moment["x"] = x - back * math.cos(heading) + left * math.sin(heading)
        moment["y"] = y - back * math.sin(heading) - left * math.cos(heading)
        moment["heading"] = heading - math.atan2(rate, speed) if speed else heading
        moment["speed"] = speed
        place = float(moment["x"]), float(moment["y"]), float(moment["heading"])
        moment["lane"] = closest_lane(road, *place)
    return Track(moments, 5.0, 2.0)


def since(duration: float, start: float) -> Callable[[float], float]:
    """At `start` m to the left until so many seconds before the contact, then steadily to 0."""
    return lambda t: start * min(t / duration, 1.0)


def after(moment: float, start: float) -> Callable[[float], float]:
    """At `start` m to the left until 1 s before that moment, and at 0 from then on."""
    return lambda t: start * min(max(t - moment, 0.0), 1.0)


@pytest.mark.parametrize(
    ("one", "other", "verdict"),
    [
        pytest.param((20, 0, 0), (10, 4.9, 0), FIRST, id="strikes a slower vehicle ahead"),
        pytest.param((10, 4.9, 0), (20, 0, 0), OTHER, id="is struck from behind"),
        pytest.param((15, 4.9, 0, 0, after(0.5, -3.0)), (25, 0, 0), FIRST, id="cuts in sharply"),
        pytest.param(
            (15, 4.9, 0, 0, after(1.5, -3.0)), (16, 0, 0), OTHER, id="cuts in with room to brake"
        ),
        pytest.param(
            (15, 4.9, 0, 0, after(3.0, -3.0)), (25, 0, 0), OTHER, id="has come long before"
        ),
        pytest.param(
            (30, 0, 1.8, 0, after(0.0, 3.0)),
            (15, 4.9, 1.8),
            FIRST,
            id="moves behind a vehicle that keeps beside the middle of its lane",
        ),
        pytest.param((20, 0, 1.0, 0, since(2.0, 1.0)), (20, 1, 2.9), FIRST, id="drifts aside"),
        pytest.param(
            (20, 0, 1.0, 0, since(1.0, 1.0)),
            (20, 1, 2.9, 0, since(2.0, -1.0)),
            FIRST,
            id="drifts aside later than the other one",
        ),
        pytest.param(
            (20, 0, 1.0, 0, since(1.0, 1.0)),
            (20, 1, 3.0, 0, since(1.0, -1.0)),
            BOTH,
            id="both drift at once",
        ),
        pytest.param((20, 0, 0), (20, 1, 1.9), None, id="nobody moves out of a lane"),
    ],
)
def test_on_lanes_side_by_side(one: tuple, other: tuple, verdict: Verdict) -> None:  # type: ignore[type-arg]
    tracks = (drive(TWO_LANES, *each) for each in (one, other))
    assert at_fault(TWO_LANES, NOBODY, *tracks, DT) == verdict


def test_who_meets_traffic_on_its_side_of_the_road_is_at_fault() -> None:
    oncoming = drive(TWO_WAYS, 15, 4.9, 0, math.pi)
    overtaking = drive(TWO_WAYS, 20, 0, 0.5)
    assert at_fault(TWO_WAYS, NOBODY, overtaking, oncoming, DT) == FIRST
    assert at_fault(TWO_WAYS, NOBODY, oncoming, overtaking, DT) == OTHER


def test_who_overtakes_on_a_lane_of_both_directions_is_at_fault() -> None:
    ahead = StraightLane(start=(-300.0, 0.0), end=(300.0, 0.0))
    right = StraightLane(start=(-300.0, 4.0), end=(300.0, 4.0))
    back = StraightLane(start=(300.0, 0.0), end=(-300.0, 0.0))
    road = network_of([("a", "b", ahead), ("a", "b", right), ("b", "a", back)])
    nobody = np.full(3, NO_RANK)
    tracks = drive(road, 20, 0, 0.5), drive(road, 15, 4.9, 0, math.pi)
    assert at_fault(road, nobody, *tracks, DT) == FIRST


def test_who_drives_backwards_is_at_fault() -> None:
    tracks = drive(TWO_LANES, 5, 0, 0), drive(TWO_LANES, -3, 4.9, 0)
    assert at_fault(TWO_LANES, NOBODY, *tracks, DT) == OTHER


def test_who_turns_into_a_stationary_vehicle_is_at_fault() -> None:
    tracks = drive(TWO_LANES, 8, 0, 1.5, math.pi / 6), drive(TWO_LANES, 0, 2.0, 4.1)
    assert at_fault(TWO_LANES, NOBODY, *tracks, DT) == FIRST


NORTH = -math.pi / 2
CROSSES = {
    "strikes the side": ((15, 0, 0), (15, 3.4, 1, NORTH)),
    "is struck at its side": ((15, 3.4, -1), (15, 0, 3.4, NORTH)),
}


@pytest.mark.parametrize("contact", CROSSES)
@pytest.mark.parametrize(
    ("ranks", "verdict"),
    [((3, 1), OTHER), ((1, 3), FIRST), ((2, 2), FIRST)],
    ids=["over the other", "under the other", "equal, and the other one comes from the right"],
)
def test_who_has_to_yield_at_a_crossing_is_at_fault_whoever_strikes(
    contact: str, ranks: tuple[int, int], verdict: Verdict
) -> None:
    tracks = [drive(CROSSING, *each) for each in CROSSES[contact]]
    assert at_fault(CROSSING, np.array(ranks), *tracks, DT) == verdict


def test_who_could_have_braked_for_a_vehicle_on_the_crossing_is_at_fault() -> None:
    waiting = drive(CROSSING, 0.5, 0, 0.5, NORTH)  # on the other's way for about 5 s
    tracks = drive(CROSSING, 10, -3.4, 0), waiting
    assert at_fault(CROSSING, np.array([3, 1]), *tracks, DT) == FIRST
    fast = drive(CROSSING, 30, -3.4, 0), drive(CROSSING, 4, 0, 0.5, NORTH)
    assert at_fault(CROSSING, np.array([3, 1]), *fast, DT) == OTHER


@pytest.mark.parametrize("road", ["merge-v1", "roundabout-v1"])
def test_every_crash_of_an_episode_on_a_road_is_judged(road: str) -> None:
    profile = {"name": "charms", "speed_min_mps": 0.0, "target_speed_min_mps": 0.0}
    settings = on_road(
        SceneSettings.model_validate({"profile": profile, "duration_s": 45.0}), NamedRoad(name=road)
    )
    traffic = TrafficSpec.model_validate("environment").make()
    agents = {"imitation": make_agent("imitation")}
    simulation = Simulation(settings, 30, "imitation", traffic, agents, engine_on(settings))
    simulation.reset(np.arange(30, dtype=np.uint64))
    while simulation.scene.active.any():
        simulation.step()
    found = simulation.engine.measures["at_fault_on_road"]
    has_crashed = np.isin(simulation.ending, (REAR_END, SIDE))
    assert has_crashed.sum() > 5, ENDINGS[OFF_ROAD]
    assert np.isnan(found[~has_crashed]).all()
    assert np.isin(found[has_crashed], (0.0, 1.0)).mean() >= 0.95
