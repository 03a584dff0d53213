"""Drivers who give way: when they stop, by hand, and that they are the same elsewhere."""

import math

import numpy as np
import pytest
from charms_baselines.human import Human
from charms_baselines.idm_mobil import IdmMobil
from charms_baselines.mutant import Mutant
from charms_baselines.yielding_human import YieldingHuman
from charms_baselines.yielding_idm_mobil import YieldingIdmMobil

from charms_bench import DriverModel
from charms_bench.engine.simulation import Simulation
from charms_bench.errors import InputError
from charms_bench.plugins.traffic import OneAgent
from charms_bench.roads.engine import RoadEngine
from charms_bench.roads.settings import on_road
from charms_bench.world.named_road import NamedRoad
from charms_bench.world.road import heading_at, position
from charms_bench.world.scene import SceneSettings

PROFILE = {"name": "charms", "speed_min_mps": 0.0, "target_speed_min_mps": 0.0}
EGO = np.array([0]), np.array([0])


def crossing(own_m: float, other_m: float, other_mps: float) -> Simulation:
    """An ego at 10 m/s that drives north, and a vehicle from the east, before the intersection.

    Both distances are from the centres to the first point where they can meet; the ego has to give
    way. The vehicle can turn left: on an arc with the radius 13 m and the centre (11, 11), which
    begins at (11, -2) and crosses the ego's line x = 2 at y = 11 - sqrt(13^2 - 9^2). The ego enters
    at y = 11.
    """
    settings = SceneSettings.model_validate({"profile": PROFILE})
    road = on_road(settings, NamedRoad(name="intersection-v1", configuration={"destination": "o2"}))
    driver = YieldingHuman()
    simulation = Simulation(road, 1, "ego", OneAgent("ego"), {"ego": driver}, RoadEngine)
    simulation.reset(np.zeros(1, dtype=np.uint64))
    engine = simulation.engine
    assert isinstance(engine, RoadEngine)
    scenes, names = engine.episodes.scenes, engine.episodes.task.lanes
    vehicles = scenes.vehicles
    vehicles["kind"][0, 2:] = 0
    for i, lane, s, speed in (
        (0, names["o0", "ir0", 0], 100 + math.sqrt(13**2 - 9**2) - own_m, 10.0),
        (1, names["o3", "ir3", 0], 100 + 13 * math.asin(9 / 13) - other_m, other_mps),
    ):
        vehicles["kind"][0, i] = 6 if i else vehicles["kind"][0, 0]
        vehicles["x"][0, i], vehicles["y"][0, i] = position(scenes.road, lane, s, 0.0)
        vehicles["heading"][0, i] = heading = heading_at(scenes.road, lane, s)
        vehicles["direction_x"][0, i] = math.cos(heading)
        vehicles["direction_y"][0, i] = math.sin(heading)
        vehicles["speed"][0, i], vehicles["lane"][0, i] = speed, lane
        vehicles["target_lane"][0, i] = lane
    engine.episodes.scenes.ways["lanes"][:] = -1
    engine._moved[:] = True
    return simulation


@pytest.mark.parametrize(
    ("own_m", "other_m", "other_mps", "expected_m"),
    [
        # The stop line is 4 m before the point and 2.5 m before the centre: 1.35 s at 10 m/s.
        (20.0, 78.0, 10.0, 13.5),  # arrives after 7.8 s, 6.45 s later: too early
        (20.0, 79.0, 10.0, math.inf),  # 6.55 s later
        (20.0, 8.0, 10.0, math.inf),  # is 5 m beyond the point after 1.3 s
        (20.0, 8.0, 8.0, 13.5),  # after 1.6 s
        (40.0, 15.0, 10.0, math.inf),  # has passed after 2 s, and the ego needs 3.35 s
        (5.0, 30.0, 10.0, math.inf),  # the front is beyond the line
        (7.0, 30.0, 10.0, 0.5),
    ],
)
def test_a_driver_waits_for_the_critical_headway(
    own_m: float, other_m: float, other_mps: float, expected_m: float
) -> None:
    simulation = crossing(own_m, other_m, other_mps)
    driver = YieldingHuman()
    stop = driver.stops(*simulation.engine.seen_by(EGO))
    assert stop[0] == pytest.approx(expected_m, abs=0.01)  # arcs are polylines


@pytest.mark.parametrize(
    ("critical", "waits"),
    [(1.0, True), (0.9, False)],  # it arrives 6.45 s later, and 0.9 of 6.5 s are 5.85 s
)
def test_idm_mobil_brakes_before_the_line_as_behind_a_stationary_leader(
    critical: float, waits: bool
) -> None:
    scene, ego = crossing(20.0, 78.0, 10.0).engine.seen_by(EGO)
    found, _ = YieldingIdmMobil(critical=critical, acceleration_mps2=2.0).drive(scene, ego)
    p, at = scene.constants.idm_mobil, (0, 0)
    exponent = p.exponent_low + scene.temperament[at] * (p.exponent_high - p.exponent_low)
    free = 2 * (1 - (10 / min(scene.target_speed[at], scene.road.speed_limit)) ** exponent)
    wanted = p.jam_distance_m + 10 * p.time_headway_s + 10 * 10 / (2 * math.sqrt(2 * 5))
    stopping = free - 2 * (wanted / (p.jam_distance_m + 13.5)) ** 2
    assert found[0] == pytest.approx(stopping if waits else free, abs=0.01)


def test_a_scene_with_other_arrays_is_at_the_same_junctions() -> None:
    scene, ego = crossing(20.0, 78.0, 10.0).engine.seen_by(EGO)
    stops = [
        YieldingHuman().stops(each._replace(x=scene.x.copy()), ego)[0]
        for each in (scene, scene.at(None))
    ]
    assert stops == pytest.approx([13.5, math.inf], abs=0.01)


def test_a_faulty_driver_gives_way_if_it_is_asked_to() -> None:
    scene, ego = crossing(20.0, 78.0, 10.0).engine.seen_by(EGO)
    found = [
        driver.drive(scene, ego)[0][0]
        for driver in (YieldingIdmMobil(), Mutant(critical=1.0), IdmMobil(), Mutant())
    ]
    assert found[0] == found[1] < found[2] == found[3]


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"critical": -1.0}, "critical is -1.0; expected 0 to 10"),
        ({"headway": 1.0}, "headway: "),
        ({"time_headway_s": math.nan}, "time_headway_s: "),
        ({"acceleration_mps2": 0.0}, "acceleration_mps2: "),
    ],
)
def test_wrong_options_are_named(options: dict[str, float], said: str) -> None:
    with pytest.raises(InputError, match=f"yielding_idm_mobil: {said}"):
        YieldingIdmMobil(**options)


@pytest.mark.parametrize(
    ("one", "other"), [(Human(), YieldingHuman()), (IdmMobil(), YieldingIdmMobil())]
)
def test_on_a_straight_road_a_driver_who_gives_way_is_the_same_one(
    one: DriverModel, other: DriverModel
) -> None:
    rows = []
    for driver in (one, other):
        simulation = Simulation(SceneSettings(), 5, "ego", OneAgent("ego"), {"ego": driver})
        simulation.reset(np.arange(5, dtype=np.uint64))
        for _ in range(9):
            simulation.step()
        rows.append(simulation.scene.x.copy())
    np.testing.assert_array_equal(*rows)
