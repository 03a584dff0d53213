"""Recorded scenes of CommonRoad on their own roads."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pytest

import charms_bench.envs  # noqa: F401  # registers the environments
from charms_bench.engine.endings import ENDINGS
from charms_bench.engine.simulation import Simulation
from charms_bench.envs.ego_env import made_traffic
from charms_bench.errors import InputError, MapError
from charms_bench.humans.in_scenes import AsRecorded, drive_in_scene
from charms_bench.maps.commonroad_scene import read_scene
from charms_bench.plugins.registry import make_agent
from charms_bench.plugins.traffic import OneAgent, Traffic
from charms_bench.roads.engine import RoadEngine
from charms_bench.roads.goal_states import goal_states, is_in_area
from charms_bench.roads.recorded_scenes import facts_of
from charms_bench.roads.settings import on_road
from charms_bench.world.named_road import NamedRoad
from charms_bench.world.scene import Floats, SceneSettings

DATA = Path(__file__).parents[3] / "shared" / "data"
LANELET = (
    '<lanelet id="{}"><leftBound>{}</leftBound><rightBound>{}</rightBound>{}'
    "<speedLimit>15</speedLimit></lanelet>"
)
GOAL = (
    "<rectangle><length>4</length><width>3</width><orientation>0</orientation>"
    "<center><x>{}</x><y>-2</y></center></rectangle>"
)


def points(y: float) -> str:
    return "".join(f"<point><x>{x}</x><y>{y}</y></point>" for x in (0, 150, 300))


def state(tag: str, x: float, y: float, speed: float, frame: int) -> str:
    return (
        f"<{tag}><position><point><x>{x}</x><y>{y}</y></point></position>"
        f"<orientation><exact>0</exact></orientation><time><exact>{frame}</exact></time>"
        f"<velocity><exact>{speed}</exact></velocity></{tag}>"
    )


def vehicle(name: int, x: float, y: float, speed: float, first: int, last: int) -> str:
    """A vehicle that is at x in its first frame and drives to the right."""
    states = [
        state("state", x + speed * k / 10, y, speed, first + k) for k in range(last - first + 1)
    ]
    initial = states[0].replace("<state>", "<initialState>").replace("</state>", "</initialState>")
    return (
        f'<dynamicObstacle id="{name}"><type>car</type><shape><rectangle><length>4</length>'
        f"<width>2</width></rectangle></shape>{initial}"
        f"<trajectory>{''.join(states[1:])}</trajectory></dynamicObstacle>"
    )


LEADER, FOLLOWER = vehicle(10, 60, 2, 10, 0, 40), vehicle(11, 40, 2, 10, 0, 40)
LATE, BESIDE = vehicle(12, 10, -2, 8, 5, 15), vehicle(13, 10, 40, 8, 0, 40)
PROBLEM = (
    f'<planningProblem id="9">{state("initialState", 20, -2, 10, 0)}'
    f"<goalState><position>{GOAL.format(50)}</position><time><intervalStart>20</intervalStart>"
    "<intervalEnd>40</intervalEnd></time></goalState></planningProblem>"
)


def scenario(*parts: str) -> str:
    """Two lanes of 300 m to the right, in the file above and below y = 0, and what is on them."""
    left = LANELET.format(1, points(4), points(0), '<adjacentRight ref="2" drivingDir="same"/>')
    right = LANELET.format(2, points(0), points(-4), '<adjacentLeft ref="1" drivingDir="same"/>')
    return (
        '<commonRoad commonRoadVersion="2020a" timeStepSize="0.1">'
        + "".join((left, right, *parts))
        + "</commonRoad>"
    )


Make = Callable[..., Simulation]


@pytest.fixture
def simulated(tmp_path: Path) -> Make:
    """Makes the simulation of a scenario."""

    def make(
        text: str,
        start: str,
        ego: str | None = "recorded",
        traffic: str | Traffic = "recorded",
        hz: int = 30,
        scenes: int = 1,
    ) -> Simulation:
        path = tmp_path / "scene.xml"
        path.write_text(text)
        return simulation_of(path, start, ego, traffic, hz, scenes)

    return make


def simulation_of(
    path: Path,
    start: str,
    ego: str | None,
    traffic: str | Traffic,
    hz: int,
    scenes: int,
) -> Simulation:
    road = NamedRoad.model_validate({"file": path, "configuration": {"start": start}})
    plain = SceneSettings(profile="roads", simulation_hz=hz, decision_hz=5)
    made, agents = made_traffic(traffic)
    agents |= {} if ego is None else {ego: make_agent(ego)}
    found = Simulation(on_road(plain, road), scenes, ego, made, agents, RoadEngine)
    found.reset(np.arange(scenes, dtype=np.uint64))
    return found


def test_between_frames_replayed_vehicles_are_between_their_recorded_places(
    simulated: Make,
) -> None:
    simulation = simulated(scenario(LEADER, FOLLOWER), "recorded")
    for step in range(1, 91):
        simulation.advance()
        at = simulation.engine.state
        expected = sorted((60 + 10 * step / 30, 40 + 10 * step / 30))
        assert sorted(at.x[0].tolist()) == pytest.approx(expected, abs=1e-9)
        assert at.y[0].tolist() == pytest.approx([-2, -2], abs=1e-9)
        if step % 6 == 0:
            simulation.finish_step()


def test_a_vehicle_is_there_from_its_first_frame_to_its_last(simulated: Make) -> None:
    simulation = simulated(scenario(LEADER, FOLLOWER, LATE), "recorded", hz=10)
    there = []
    for step in range(1, 20):
        simulation.advance()
        at = simulation.engine.state
        there += [step] * bool(at.present[0, 2])
        if at.present[0, 2]:
            assert (at.x[0, 2], at.y[0, 2]) == pytest.approx((10 + 0.8 * (step - 5), 2))
            assert at.length[0, 2] == 4
        if step % 2 == 0:
            simulation.finish_step()
    assert there == list(range(5, 16))


def test_the_recorded_ego_reaches_its_goal_and_is_on_a_lane(simulated: Make) -> None:
    simulation = simulated(scenario(LEADER, FOLLOWER, BESIDE), "recorded", scenes=2)
    assert sorted(simulation.engine.moments.names) == ["vehicle 10", "vehicle 11"]
    while simulation.scene.active.any():
        simulation.step()
    assert [ENDINGS[each] for each in simulation.ending] == ["goal", "goal"]
    assert simulation.steps.tolist() == [16, 16]  # four fifths of 4 s


def test_replayed_vehicles_react_only_once_the_ego_deviates(simulated: Make) -> None:
    text = scenario(vehicle(10, 60, 2, 10, 0, 100), vehicle(11, 50, 2, 10, 0, 100))
    for traffic, has_crashed in (("recorded", True), ("recorded_until_deviation", False)):
        simulation = simulated(text, "recorded", ego=None, traffic=traffic, scenes=2)
        leader = int(np.argmax(simulation.engine.state.x[:, 0]))
        drivers = []
        while simulation.scene.active[leader]:
            simulation.step(np.full(2, 4))  # SLOWER
            drivers.append(simulation.drivers[leader, 1])
        assert bool(simulation.engine.state.crashed[leader, 1]) == has_crashed
        assert drivers[0] == "recorded"
        assert (drivers[-1] == "idm_mobil") != has_crashed


def test_reactive_vehicles_start_where_they_were_recorded(simulated: Make) -> None:
    simulation = simulated(scenario(LEADER, FOLLOWER), "recorded", "recorded", "idm_mobil")
    state = simulation.engine.state
    assert sorted(state.x[0].tolist()) == [40, 60]
    assert state.target_speed[0, 1] == 10
    simulation.step()
    assert simulation.drivers[0, 1] == "idm_mobil"


def test_an_agent_drives_from_the_start_of_a_planning_problem_to_its_goal(simulated: Make) -> None:
    text = scenario(LEADER, FOLLOWER, PROBLEM)
    simulation = simulated(text, "planning_problem", "idm_mobil")
    state = simulation.engine.state
    assert (state.x[0, 0], state.y[0, 0], state.speed[0, 0]) == (20, 2, 10)
    while simulation.scene.active.any():
        simulation.step()
    assert ENDINGS[simulation.ending[0]] == "goal"
    # The goal begins at 48 m; the ego sees it after a decision, each of 0.2 s.
    assert 48 <= state.x[0, 0] <= 48 + 0.2 * 15


WHOLE_GOAL = PROBLEM.replace(
    "</time></goalState>",
    "</time><orientation><intervalStart>-0.2</intervalStart><intervalEnd>0.1</intervalEnd>"
    "</orientation><velocity><intervalStart>5</intervalStart><intervalEnd>12</intervalEnd>"
    "</velocity></goalState>",
)


@pytest.mark.parametrize(
    ("change", "is_met"),
    [
        ({}, True),
        ({"x": 47.9}, False),  # the area is 4 m long and 3 m wide, around (50, 2)
        ({"x": 51.9, "y": 3.4}, True),
        ({"y": 3.6}, False),
        ({"time": 1.9}, False),  # frames 20 to 40, at 10 Hz
        ({"time": 2.0}, True),
        ({"time": 4.0}, True),
        ({"time": 4.1}, False),
        ({"speed": 12.1}, False),
        ({"speed": 4.9}, False),
        ({"heading": 0.15}, True),  # -0.15 rad in the file, where y points to the left of x
        ({"heading": -0.15}, False),
        ({"heading": 0.15 - 2 * np.pi}, True),
    ],
)
def test_a_goal_is_met_in_its_area_at_its_time_with_its_speed_and_its_orientation(
    whole_goal: Simulation, change: dict[str, float], is_met: bool
) -> None:
    episodes = whole_goal.engine.episodes
    values = {"x": 50.0, "y": 2.0, "time": 3.0, "speed": 10.0, "heading": 0.0} | change
    episodes.scenes.time[0] = values.pop("time")
    for name, value in values.items():
        episodes.scenes.vehicles[name][0, 0] = value
    lanes = np.zeros(1, dtype=np.int64)
    assert episodes.task.has_reached_goal(episodes.scenes, lanes).tolist() == [is_met]


@pytest.fixture(scope="module")
def whole_goal(tmp_path_factory: pytest.TempPathFactory) -> Simulation:
    path = tmp_path_factory.mktemp("scene") / "scene.xml"
    path.write_text(scenario(LEADER, FOLLOWER, WHOLE_GOAL))
    return simulation_of(path, "planning_problem", "idm_mobil", "recorded", 30, 1)


@pytest.mark.parametrize(
    ("shape", "inside", "outside"),
    [
        # Turned by 30 degrees, a corner is at (50 + 2 cos 30 - sin 30, 2 - 2 sin 30 - cos 30),
        # which is (51.23, 0.13).
        (
            GOAL.format(50)
            .replace("<width>3", "<width>2")
            .replace("<orientation>0", f"<orientation>{np.pi / 6}"),
            (51.2, 0.2),
            (51.5, 0.1),
        ),
        (
            "<circle><radius>5</radius><center><x>50</x><y>-2</y></center></circle>",
            (52.9, 5.9),
            (53.1, 6.1),
        ),
        ('<lanelet ref="2"/>', (299.0, 3.9), (150.0, -0.1)),
    ],
)
def test_areas_are_rectangles_circles_and_lanelets(
    tmp_path: Path, shape: str, inside: tuple[float, float], outside: tuple[float, float]
) -> None:
    path = tmp_path / "scene.xml"
    turned = "<orientation><exact>0</exact></orientation>"
    text = PROBLEM.replace(GOAL.format(50), shape).replace("</goalState>", turned + "</goalState>")
    path.write_text(scenario(LEADER, text))
    scene = read_scene(path, (0.0, 0.0))
    assert scene is not None
    goals = goal_states(scene.problems)
    assert [is_in_area(goals, 0, *each) for each in (inside, outside)] == [True, False]


def test_nobody_deviates_from_a_recording_that_does_not_exist(simulated: Make) -> None:
    text = scenario(LEADER, FOLLOWER, PROBLEM)
    with pytest.raises(InputError, match="vehicle of a planning problem is not recorded"):
        simulated(text, "planning_problem", "idm_mobil", "recorded_until_deviation")


def test_a_recorded_ego_is_described_once_per_second_until_its_scene_ends(simulated: Make) -> None:
    simulation = simulated(scenario(LEADER, FOLLOWER), "recorded")
    agents = {"recorded": AsRecorded()}
    found = drive_in_scene(simulation.settings, "recorded", OneAgent("recorded"), agents, 1)
    assert found.shape == (2, 1, 5, 6)  # two egos for 4 s
    x, y, stands, speed, gap, ahead = np.moveaxis(found[:, 0], -1, 0)
    second = np.arange(5)
    assert sorted(x[:, 0].tolist()) == [40, 60]
    assert (x - x[:, :1]).tolist() == pytest.approx(np.stack([10.0 * second] * 2))
    assert (y == -2).all()
    assert (np.stack([stands, speed, ahead]) == 10).all()
    gaps = gap[np.argsort(x[:, 0])]
    assert gaps[0].tolist() == pytest.approx([16.0] * 5)  # 20 m less a length of 4 m
    assert np.isinf(gaps[1]).all()


def test_an_environment_drives_in_a_recorded_scene(tmp_path: Path) -> None:
    path = tmp_path / "scene.xml"
    path.write_text(scenario(LEADER, FOLLOWER, PROBLEM))
    scene = {"road": {"file": path, "configuration": {"start": "planning_problem"}}}
    env: Any = gymnasium.make("charms_bench/Ego-v0", scene=scene, traffic="recorded")
    env.reset(seed=0)
    is_over = False
    while not is_over:
        *_, is_over, is_truncated, info = env.step(1)  # IDLE
        is_over |= is_truncated
    assert info["ending"] == "goal"


def test_a_file_says_what_is_recorded_and_what_is_beside_its_lanes(tmp_path: Path) -> None:
    path = tmp_path / "scene.xml"
    walker = LATE.replace("car", "pedestrian").replace('id="12"', 'id="14"')
    path.write_text(scenario(LEADER, BESIDE, walker, PROBLEM))
    assert facts_of(path) == {
        "vehicles": 2,
        "states": 82,
        "rate_hz": 10,
        "duration_s": 4,
        "in_lane": 0.5,
        "states_beside_lanes": {"13": 41},
        "planning_problems": 1,
        "left_out": {"of type 'pedestrian'": 1},
    }


@pytest.mark.parametrize(
    ("old", "new", "what"),
    [
        ("<exact>7</exact>", "<exact>8</exact>", "<state> in <dynamicObstacle id='10'>: is of the"),
        ("velocity>", "speed>", "<initialState> in <dynamicObstacle id='10'>: has no <velocity>"),
        ("<length>4</length><width>2", "<length>-4</length><width>2", "length is '-4'; expected"),
        (
            "<velocity><exact>10",
            "<velocity><exact>nan",
            "velocity is 'nan'; expected a number from",
        ),
        (' timeStepSize="0.1"', "", "<commonRoad>: has no 'timeStepSize'; expected a number"),
        (GOAL.format(50), '<lanelet ref="5"/>', "refers to lanelet '5', which the file does not"),
    ],
)
def test_a_faulty_scene_is_rejected_with_its_element(
    tmp_path: Path, old: str, new: str, what: str
) -> None:
    text = scenario(LEADER, PROBLEM)
    assert old in text
    path = tmp_path / "scene.xml"
    path.write_text(text.replace(old, new))
    with pytest.raises(MapError) as raised:
        read_scene(path, (0.0, 0.0))
    assert what in str(raised.value)


def test_a_road_without_recorded_vehicles_has_no_recorded_start(simulated: Make) -> None:
    with pytest.raises(InputError, match="has no recorded vehicles; expected a CommonRoad"):
        simulated(scenario(PROBLEM), "recorded")


def recorded_files() -> list[Path]:
    folders = DATA / "ngsim_commonroad", DATA / "maps" / "commonroad"
    return sorted(path for folder in folders for path in folder.glob("*.xml"))


on_all_scenes = pytest.mark.parametrize("path", recorded_files(), ids=lambda path: str(path.stem))
needs_scenes = pytest.mark.skipif(not recorded_files(), reason="needs ../shared/data, scenes")


def from_recorded(simulation: Simulation) -> Floats | None:
    """How far vehicles (N,) are from their recorded places, m; None between two frames.

    It is not a number for those that are not there or not recorded now.
    """
    moments, tracks = simulation.engine.moments, simulation.engine.moments.tracks
    frame = moments.frame[0] + simulation.frames[0] / 2
    if frame % 1:
        return None
    track, state = moments.vehicles[0], simulation.engine.state
    known = (tracks.first[track] <= frame) & (frame <= tracks.last[track]) & (track >= 0)
    found = np.full(track.size, np.nan)
    rows = (tracks.row + int(frame) - tracks.first)[track[known]]
    x, y = state.x[0, known] - tracks.x[rows], state.y[0, known] - tracks.y[rows]
    found[known] = np.where(state.present[0, known], np.hypot(x, y), np.nan)
    return found


@needs_scenes
@pytest.mark.slow
@on_all_scenes
def test_recorded_scenes_are_replayed_on_their_own_lanes(path: Path) -> None:
    facts = facts_of(path)
    assert facts is not None
    assert facts["in_lane"] >= 0.93
    hz = round(2 * facts["rate_hz"])
    simulation = simulation_of(path, "recorded", "recorded", "recorded", hz, 1)
    compared = 0
    while simulation.scene.active.any():
        for _ in range(simulation.settings.steps_per_decision):
            simulation.advance()
            apart = from_recorded(simulation)
            if apart is None:
                continue
            there = simulation.engine.state.present[0]
            assert np.isfinite(apart).tolist() == there.tolist()
            assert apart[there].max() <= 1e-9
            compared += int(there.sum())
        simulation.finish_step()
    assert compared


@needs_scenes
@pytest.mark.slow
@on_all_scenes
def test_an_agent_drives_in_each_scene_in_three_modes_of_reaction(path: Path) -> None:
    facts = facts_of(path)
    assert facts is not None
    hz = round(2 * facts["rate_hz"])
    for traffic in ("recorded", "recorded_until_deviation", "idm_mobil"):
        simulation = simulation_of(path, "recorded", "idm_mobil", traffic, hz, 1)
        drivers, apart = set(simulation.drivers[0, 1:].tolist()), from_recorded(simulation)
        assert apart is not None
        assert np.nanmax(apart) == 0.0
        while simulation.scene.active.any():
            before = drivers
            simulation.step()
            state, apart = simulation.engine.state, from_recorded(simulation)
            drivers = set(simulation.drivers[0, 1:][state.present[0, 1:]].tolist())
            assert np.isfinite([state.x, state.y, state.speed]).all()
            if apart is not None and before | drivers == {"recorded"}:
                # A vehicle that the ego has just hit is a wreck.
                replayed = apart[1:][~state.crashed[0, 1:]]
                assert np.nanmax(replayed, initial=0.0) <= 1e-9
        assert ENDINGS[simulation.ending[0]] in ("time", "goal", "rear_end", "side")
        expected = {"recorded": {"recorded"}, "idm_mobil": {"idm_mobil"}}.get(traffic)
        assert expected is None or drivers <= expected
