"""A replayed episode in commonroad-io and commonroad-crime; run by `tox -e crime`.

The TTC that a run reports is that of vehicles which keep their speeds. commonroad-crime goes on to
accelerate as a trajectory does, unless the vehicles' accelerations differ by at most 0.1 m/s2. So
the TTC of the file itself is compared in those steps, and in all steps that of vehicles which have
the positions and speeds of the file and keep the speeds. commonroad-crime takes v sqrt(1 + sin2 h)
for the speed of a vehicle with heading h that commonroad-io has read.
"""

import math
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pytest

import charms_bench
from charms_bench.episodes.ego_view import ego_view
from charms_bench.episodes.replay import Replay
from charms_bench.maps.joining import joined
from charms_bench.maps.reading import read_road
from charms_bench.metrics.rows import join_rows

pytest.importorskip("commonroad_crime", reason="run by tox -e crime")

from commonroad.common.file_reader import CommonRoadFileReader
from commonroad.common.writer.file_writer_xml import XMLFileWriter
from commonroad.prediction.prediction import TrajectoryPrediction
from commonroad.scenario.obstacle import DynamicObstacle
from commonroad.scenario.scenario import Scenario
from commonroad.scenario.state import CustomState, InitialState
from commonroad.scenario.trajectory import Trajectory
from commonroad_crime.data_structure.configuration import CriMeConfiguration
from commonroad_crime.measure import TTC

SUITE = """\
suite: small
episodes: 2
seed: 900000000
scene: {duration_s: 8.0, traffic_vehicles: 10, density: 1.5}
egos: [{agent: level_0}, {agent: idm_mobil}]
traffic_models: [{traffic: idm_mobil}]
"""
PLACES = Path(__file__).parents[2] / "suites" / "places"
MAPS = Path(__file__).parents[3] / "shared" / "data" / "maps"
ON_A_MAP = """\
suite: on-a-map
episodes: 1
seed: 0
scene: {{profile: roads, duration_s: 5.0}}
egos: [{{agent: idm_mobil}}]
roads: [{{file: {}}}]
"""
FIRST_VEHICLE = 1001
ROUNDING_S = 0.00501
GAP_ERROR_M = 0.00501
CONSTANT_MPS2 = 0.1
"""Accelerations that differ by no more are equal for commonroad-crime."""
WITHIN_M, LENGTH_ERROR, NEAR_M = 0.01, 5e-3, 7.0
ORIENTATION = 1e-9
"""commonroad-crime takes an orientation of exactly 0 for a missing one."""
Episode = tuple[Replay, Path]


@pytest.fixture(scope="module")
def episodes(tmp_path_factory: pytest.TempPathFactory) -> list[Episode]:
    folder = tmp_path_factory.mktemp("small")
    (folder / "suite.yaml").write_text(SUITE)
    run = charms_bench.run(folder / "suite.yaml", folder / "run", workers=1)
    found = []
    for agent in ("level_0", "idm_mobil"):
        for seed in (900_000_000, 900_000_001):
            replay, path = run.replay(seed, agent), folder / f"{agent}-{seed}.xml"
            replay.write_commonroad(path)
            found.append((replay, path))
    return found


def read(path: Path) -> Scenario:
    scenario, _ = CommonRoadFileReader(path).open(lanelet_assignment=True)
    return scenario


def ttc_of(scenario: Scenario, ego: int) -> TTC:
    configuration = CriMeConfiguration()
    configuration.update(ego_id=ego, sce=scenario)
    return TTC(configuration)


def keeping_speeds(scenario: Scenario, frame: int, numbers: list[int]) -> Scenario:
    """Some vehicles of a scenario, which keep the speeds that they have in a frame."""
    made = Scenario(scenario.dt)
    made.add_objects(scenario.lanelet_network)
    for number in numbers:
        obstacle = scenario.obstacle_by_id(number)
        now = obstacle.state_at_time(frame)
        states = [
            (CustomState if step else InitialState)(
                time_step=step,
                position=now.position + np.array([now.velocity * scenario.dt * step, 0.0]),
                orientation=ORIENTATION,
                velocity=now.velocity,
                acceleration=0.0,
                yaw_rate=0.0,
                slip_angle=0.0,
            )
            for step in range(3)
        ]
        shape = obstacle.obstacle_shape
        prediction = TrajectoryPrediction(Trajectory(1, states[1:]), shape)
        made.add_objects(
            DynamicObstacle(number, obstacle.obstacle_type, shape, states[0], prediction)
        )
    made.assign_obstacles_to_lanelets()
    return made


def test_commonroad_finds_the_file_valid(episodes: list[Episode]) -> None:
    for _, path in episodes:
        assert XMLFileWriter.check_validity_of_commonroad_file(path.read_bytes())


def test_commonroad_io_reads_the_trajectories_of_the_replay(episodes: list[Episode]) -> None:
    for replay, path in episodes:
        scenario = read(path)
        assert scenario.dt == 1 / 15
        assert len(scenario.lanelet_network.lanelets) == 3
        assert len(scenario.dynamic_obstacles) == len(replay.agents)
        for vehicle in range(len(replay.agents)):
            obstacle = scenario.obstacle_by_id(FIRST_VEHICLE + vehicle)
            states = [obstacle.state_at_time(frame) for frame in range(len(replay.t_s))]
            positions = np.array([state.position for state in states])
            np.testing.assert_array_equal(positions[:, 0], replay.x[:, vehicle])
            np.testing.assert_array_equal(positions[:, 1], -replay.y[:, vehicle])
            for name, values in (
                ("velocity", replay.speed),
                ("orientation", -replay.heading),
                ("acceleration", replay.acceleration),
            ):
                read_back = [getattr(state, name) for state in states]
                np.testing.assert_array_equal(read_back, values[:, vehicle])


@pytest.mark.parametrize(
    "path",
    [
        *sorted(PLACES.glob("*.json")),
        *(MAPS / name for name in ("sumo/mcity.net.xml", "opendrive/carla_town04.xodr")),
        *sorted((MAPS / "commonroad").glob("*.xml")),
    ],
    ids=lambda path: path.name,
)
def test_commonroad_io_reads_the_lanes_and_vehicles_of_an_episode_on_a_map(
    path: Path, tmp_path: Path
) -> None:
    if not path.is_file():
        pytest.skip("needs ../shared/data/maps, road maps")
    (tmp_path / "suite.yaml").write_text(ON_A_MAP.format(path))
    run = charms_bench.run(tmp_path / "suite.yaml", tmp_path / "run", workers=1)
    plan = run.replay(0).plan
    run.replay(0).write_commonroad(tmp_path / "episode.xml")
    root = ElementTree.parse(tmp_path / "episode.xml").getroot()
    for obstacle in root.findall("dynamicObstacle"):  # the schema has none that comes later
        if obstacle.findtext("initialState/time/exact") != "0":
            root.remove(obstacle)
    assert XMLFileWriter.check_validity_of_commonroad_file(ElementTree.tostring(root))
    scenario = read(tmp_path / "episode.xml")
    lanes, network = list(joined(read_road(path)).lanes), scenario.lanelet_network
    assert len(network.lanelets) == len(lanes)
    names = {}  # lanelets by the lane that starts and ends there
    for lanelet in network.lanelets:
        ends = lanelet.center_vertices[[0, -1]]
        away = [np.abs(lane.points[[0, -1], :2] * (1, -1) - ends).max() for lane in lanes]
        names[lanelet.lanelet_id] = lanes[int(np.argmin(away))]
        assert min(away) < WITHIN_M
    for lanelet in network.lanelets:
        lane = names[lanelet.lanelet_id]
        assert {names[each].id for each in lanelet.successor} == {*lane.successors}
        assert lanelet.distance[-1] == pytest.approx(lane.length, rel=LENGTH_ERROR)
        limits = {
            float(element.additional_values[0])
            for sign in lanelet.traffic_signs
            for element in network.find_traffic_sign_by_id(sign).traffic_sign_elements
        }
        assert limits == ({lane.speed_limit} if lane.speed_limit else set())
    shown: list[list[tuple[float, ...]]] = [[] for _ in plan.present]
    for obstacle in scenario.dynamic_obstacles:
        first, last = obstacle.initial_state.time_step, obstacle.prediction.final_time_step
        for frame in range(first, last + 1):
            state = obstacle.state_at_time(frame)
            shown[frame].append((*state.position, state.velocity, state.orientation))
    last = len(plan.present) - 1
    for frame, present in enumerate(plan.present & ~plan.is_obstacle):
        stays = np.zeros_like(present)  # who is there for one frame only has no trajectory
        for other in {max(frame - 1, 0), min(frame + 1, last)} - {frame}:
            moves = np.hypot(plan.x[other] - plan.x[frame], plan.y[other] - plan.y[frame])
            stays |= plan.present[other] & (moves < NEAR_M)
        signs = {"x": 1, "y": -1, "speed": 1, "heading": -1}
        kept = present & stays
        rows = zip(
            *(sign * getattr(plan, k)[frame, kept] for k, sign in signs.items()), strict=True
        )
        assert sorted(shown[frame]) == sorted(rows)


def test_each_vehicle_is_on_the_lanelet_of_its_lane(episodes: list[Episode]) -> None:
    for replay, path in episodes:
        scenario = read(path)
        network, frame = scenario.lanelet_network, min(60, len(replay.t_s) - 1)
        for vehicle in range(len(replay.agents)):
            state = scenario.obstacle_by_id(FIRST_VEHICLE + vehicle).state_at_time(frame)
            (found,) = network.find_lanelet_by_position([state.position])
            assert int(replay.lane[frame, vehicle]) + 1 in found


def test_commonroad_crime_computes_the_ttc_that_the_run_reports(episodes: list[Episode]) -> None:
    closing_steps = others = 0
    for replay, path in episodes:
        scenario, view = read(path), ego_view(replay)
        ego = FIRST_VEHICLE + replay.ego
        rows = join_rows(replay.episodes, replay.steps, replay.settings)
        for row in rows.filter(rows["gap_m"].is_not_null()).iter_rows(named=True):
            frame = replay.frame_of(row["step"])
            leader = FIRST_VEHICLE + int(view.leader[frame])
            held = keeping_speeds(scenario, frame, [ego, leader])
            found = ttc_of(held, ego).compute(leader, 0, verbose=False)
            if row["ttc_s"] is None:
                assert found > 1e6
                others += 1
                continue
            closing = row["gap_m"] / row["ttc_s"]
            assert row["ttc_s"] == pytest.approx(found, abs=ROUNDING_S + GAP_ERROR_M / closing)
            closing_steps += 1
    assert closing_steps > 20
    assert others > 5


def test_so_it_does_on_the_file_where_it_assumes_constant_speeds(episodes: list[Episode]) -> None:
    compared = tight = 0
    for replay, path in episodes:
        ego, view = replay.ego, ego_view(replay)
        ttc = ttc_of(read(path), FIRST_VEHICLE + ego)
        for frame in np.flatnonzero(~np.isnan(view.ttc)):
            leader = int(view.leader[frame])
            found = ttc.compute(FIRST_VEHICLE + leader, int(frame), verbose=False)
            pair = (ttc.ego_vehicle, ttc.other_vehicle)
            states: list[Any] = [each.state_at_time(frame) for each in pair]
            mine, other = (math.hypot(each.acceleration, each.acceleration_y) for each in states)
            signed = math.copysign(mine, states[0].acceleration)
            if abs(other - signed) > CONSTANT_MPS2 - 0.01:
                continue
            gap, expected = view.gap_ahead[frame], view.ttc[frame]
            too_fast = sum(
                replay.speed[frame, v] * (math.hypot(1, math.sin(replay.heading[frame, v])) - 1)
                for v in (ego, leader)
            )
            closing = gap / expected
            if too_fast > closing / 2:
                continue
            blur = (GAP_ERROR_M + expected * too_fast) / (closing - too_fast)
            assert expected == pytest.approx(found, abs=ROUNDING_S + blur)
            compared += 1
            tight += blur < 0.1
    assert compared > 50
    assert tight > 20
