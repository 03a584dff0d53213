"""Agents of the straight road drive the egos of highway-env's other roads."""

import pickle
from copy import deepcopy
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from charms_bench import Policy, load_state, save_state
from charms_bench.engine.endings import ENDINGS, GOAL
from charms_bench.engine.rollouts import Futures
from charms_bench.engine.simulation import Simulation
from charms_bench.errors import InputError
from charms_bench.plugins.agent import Agent
from charms_bench.plugins.registry import make_agent
from charms_bench.plugins.specs import TrafficSpec
from charms_bench.plugins.traffic import Mixture, OneAgent, Traffic
from charms_bench.report.suite_table import first_speeds
from charms_bench.roads import OF_SUITES
from charms_bench.roads.defaults import DEFAULTS
from charms_bench.roads.engine import RoadEngine
from charms_bench.roads.episodes import Episodes
from charms_bench.roads.packed_arrays import unpack
from charms_bench.roads.scenes import COMMANDED, IDM, OBSTACLE
from charms_bench.roads.settings import on_road
from charms_bench.runs.runner import plan
from charms_bench.runs.suite import Suite
from charms_bench.world.actions import FASTER, IDLE, SLOWER
from charms_bench.world.named_road import NamedRoad
from charms_bench.world.scenario import PRESCRIBED
from charms_bench.world.scene import SceneSettings

FREE = {"name": "charms", "speed_min_mps": 0.0, "target_speed_min_mps": 0.0}
FREE |= {"ego_control_rate": "simulation"}


class Sequence(Policy):
    """Repeats three meta-actions, by the number of its decisions."""

    decision_hz = 1.0
    memory_width = 1

    def decide(self, observations: Any, *given: Any) -> Any:
        memory = given[0]
        actions = np.array((IDLE, FASTER, SLOWER))[memory[:, 0].astype(int) % 3]
        return actions, memory + 1


def simulation(
    road: str,
    agent: str | Agent,
    scenes: int,
    traffic: Traffic = OneAgent(PRESCRIBED),  # noqa: B008  # immutable
    **scene: Any,
) -> Simulation:
    """Scenes that have been started with the seeds 0, 1, ..."""
    named = NamedRoad(name=road)
    settings = on_road(SceneSettings.model_validate({"profile": FREE, **scene}), named)
    made = make_agent(agent) if isinstance(agent, str) else agent
    agents = {name: make_agent(name) for name in traffic.agents if name != PRESCRIBED}
    agents["ego"] = made
    simulation = Simulation(settings, scenes, "ego", traffic, agents, RoadEngine)
    simulation.reset(np.arange(scenes, dtype=np.uint64))
    return simulation


@pytest.mark.parametrize("traffic", [PRESCRIBED, "idm_mobil"])
def test_a_copy_of_a_simulation_continues_like_its_original(traffic: str) -> None:
    ours = simulation("merge-v0", "idm_mobil", 2, OneAgent(traffic))
    ours.step()
    others = deepcopy(ours), pickle.loads(pickle.dumps(ours))
    for each in (*others, ours):
        for _ in range(6):
            each.step()
    for other in others:
        assert other.state() == ours.state()


def on_network(simulation: Simulation) -> Any:
    """The vehicles (B, N) on the network."""
    assert isinstance(simulation.engine, RoadEngine)
    return simulation.engine.episodes.scenes.vehicles


def test_a_state_has_the_vehicles_where_they_are_on_the_network() -> None:
    made = simulation("merge-v0", "idm_mobil", 2)
    made.step()
    for each in (made, deepcopy(made), pickle.loads(pickle.dumps(made))):
        state, vehicles = each.state(), on_network(each)
        for name in ("x", "y", "heading", "speed", "target_lane", "crashed"):
            np.testing.assert_array_equal(getattr(state, name), vehicles[name], name)
        assert (state.present == (vehicles["kind"] > OBSTACLE)).all()
        assert repr(each.engine.state).endswith(f"{each.engine.state.road.lanes.size} lanes>")
        faster = state.speed + 1.0
        each.restore(state.with_arrays({"speed": faster}))
        assert (on_network(each)["speed"] == faster).all()
        assert each.scene.speed[:, 0] == pytest.approx(faster[:, 0])


@pytest.mark.parametrize("road", ["exit-v1", "roundabout-v1", "intersection-v2"])
@pytest.mark.parametrize("rate", ["decision", "simulation"])
def test_looking_at_scenes_in_every_step_changes_nothing(road: str, rate: str) -> None:
    profile = {**FREE, "ego_control_rate": rate}
    ours, watched = (
        simulation(road, Sequence(), 6, OneAgent("charms"), profile=profile, decision_hz=3)
        for _ in range(2)
    )
    watched.step_watchers.append(lambda: watched.scene.x.sum())
    for _ in range(12):
        ours.step()
        watched.step()
        assert ours.state() == watched.state()
        seen = ours.scene.present
        assert (seen == watched.scene.present).all()
        for name in ("x", "y", "heading", "speed", "lane", "target_lane", "timer_s"):
            one, other = (getattr(each.scene, name)[seen] for each in (ours, watched))
            np.testing.assert_array_equal(one, other, name)


@pytest.mark.parametrize(
    "road",
    [
        *("merge-v0", "exit-v1", "u-turn-v0", "roundabout-v1"),
        *("highway-fast-v0", "two-way-v0", "intersection-v0", "intersection-v2"),
    ],
)
def test_with_meta_actions_all_vehicles_drive_exactly_as_in_the_environment(road: str) -> None:
    rates = {"simulation_frequency": 15, "duration": 8.0}
    theirs = Episodes(road, 6, {key: rates[key] for key in rates if key in DEFAULTS[road]})
    profile = {"name": "highway-env", "target_speeds_mps": theirs.actions.target_speeds.tolist()}
    ours = simulation(road, Sequence(), 6, decision_hz=1, duration_s=8.0, profile=profile)
    theirs.seed(theirs.everyone, np.arange(6, dtype=np.uint64))
    theirs.start(theirs.everyone)
    on_network(ours)["route_end"][:, 0] = theirs.scenes.vehicles["route_end"][:, 0]  # no exit
    names = theirs.actions.names
    for step in range(8):
        running = ours.scene.active.copy()
        ours.step()
        action = names.index(("IDLE", "FASTER", "SLOWER")[step % 3])
        theirs.step(np.full(6, action))
        for name in ("x", "y", "heading", "speed", "lane", "crashed"):
            np.testing.assert_array_equal(
                on_network(ours)[name][running], theirs.scenes.vehicles[name][running], name
            )
    assert ours.steps.sum() > 20


class Steering(Policy):
    """Keeps its speed and steers to the left and to the right in turn."""

    decision_hz = 5.0
    memory_width = 1
    actions = "continuous"

    def decide(self, observations: Any, *given: Any) -> Any:
        memory = given[0]
        steering = 0.02 * (-1.0) ** memory[:, 0]
        return np.stack((np.zeros(steering.size), steering), axis=1), memory + 1


@pytest.mark.parametrize("road", ["racetrack-v0", "racetrack-large-v1", "racetrack-oval-v0"])
def test_with_steering_all_vehicles_drive_exactly_as_on_the_racetrack(road: str) -> None:
    theirs = Episodes(road, 6)
    profile = {"name": "highway-env"}
    ours = simulation(road, Steering(), 6, decision_hz=5, duration_s=4.0, profile=profile)
    theirs.seed(theirs.everyone, np.arange(6, dtype=np.uint64))
    theirs.start(theirs.everyone)
    for step in range(20):
        running = ours.scene.active.copy()
        ours.step()
        theirs.step(np.full((6, 1), 0.02 * (-1.0) ** step))
        for name in ("x", "y", "heading", "speed", "lane", "crashed"):
            np.testing.assert_array_equal(
                on_network(ours)[name][running], theirs.scenes.vehicles[name][running], name
            )
    assert ours.steps.sum() > 60


def test_vehicles_that_enter_an_intersection_have_numbers_and_drivers_of_their_own() -> None:
    made = simulation("intersection-v0", "idm_mobil", 20, Mixture({"human": 0.5, "charms": 0.5}))
    numbers: list[set[int]] = [set() for _ in range(20)]
    places = made.settings.vehicles
    drivers = set()
    for _ in range(39):
        made.step()
        state = made.engine.state
        entered = state.present & (state.entry >= places) & state.active[:, None]
        drivers |= set(made.drivers[entered])
        for b in range(20):
            there = state.entry[b, state.present[b]]
            assert np.unique(there).size == there.size
            numbers[b] |= set(there[there >= places].tolist())
    for found in numbers:
        assert found <= set(range(places, places + len(found)))  # none is left out
    assert max(map(len, numbers)) > 3
    assert drivers == {"human", "charms"}


def test_the_goal_of_a_racetrack_is_a_lap() -> None:
    made = simulation("racetrack-oval-v0", "idm_mobil", 10, duration_s=120.0)
    start = made.scene.x[:, 0].copy()
    while made.scene.active.any():
        made.step()
    assert (made.ending == GOAL).all()
    # Two straights of 101 and 105 m, two of 30 m, and four quarters of circles of 15 to 30 m; the
    # ego starts 20 to 50 m behind the beginning of its road.
    least = 100 + 105 + 2 * 30 + np.pi / 2 * (20 + 15 + 15 + 20) - 50
    assert (made.scene.x[:, 0] - start >= least - 20).all()
    assert (made.scene.x[:, 0] - start <= least + 4 * np.pi / 2 * 10 + 60).all()


def test_on_a_motorway_x_and_y_are_those_of_the_road() -> None:
    made = simulation("merge-v0", "idm_mobil", 5)
    while made.scene.active.any():
        made.step()
        scene, vehicles = made.scene, on_network(made)
        seen = scene.present & (vehicles["y"] < 6.0)  # those on the ramp swing about its line
        assert seen[:, 0].all()
        assert scene.x[seen] - scene.x[0, 0] == pytest.approx(
            vehicles["x"][seen] - scene.x[0, 0], abs=1e-9
        )
        assert scene.y[seen] == pytest.approx(vehicles["y"][seen], abs=1e-9)


@pytest.mark.parametrize("road", ["u-turn-v0", "roundabout-v0"])
def test_in_bends_x_grows_by_the_distance_that_the_ego_drives(road: str) -> None:
    made = simulation(road, "idm_mobil", 10, duration_s=20.0)
    start, driven = made.scene.x[:, 0].copy(), np.zeros(10)
    while made.scene.active.any():
        before = on_network(made)[["x", "y"]][:, 0].copy()
        made.advance()
        if made.phase == made.settings.steps_per_decision:
            made.finish_step()
        after = on_network(made)[:, 0]
        driven += np.hypot(after["x"] - before["x"], after["y"] - before["y"])
    # Beside the centre of a lane, arcs have other lengths.
    assert made.scene.x[:, 0] - start == pytest.approx(driven, rel=0.1)


def test_the_leader_is_the_vehicle_ahead_along_the_ring() -> None:
    made = simulation("roundabout-v0", "idm_mobil", 20, duration_s=20.0)
    found = 0
    for _ in range(20):
        made.step()
        scene, vehicles = made.scene, on_network(made)
        for b in np.nonzero(scene.active & (scene.leaders[:, 0, 0] >= 0))[0]:
            ego, leader = vehicles[b, 0], vehicles[b, scene.leaders[b, 0, 0]]
            if ego["lane"] != leader["lane"]:
                continue
            found += 1
            gap = scene.x[b, scene.leaders[b, 0, 0]] - scene.x[b, 0]
            chord = np.hypot(leader["x"] - ego["x"], leader["y"] - ego["y"])
            assert 0 < chord <= gap + 1.0 < 1.6 * chord + 2.0
    assert found > 5


@pytest.mark.parametrize("road", [each for each in OF_SUITES if "highway" not in each])
def test_idm_mobil_reaches_the_goal_of_every_road(road: str) -> None:
    made = simulation(road, "idm_mobil", 40, duration_s=60.0)
    while made.scene.active.any():
        made.step()
    assert (made.ending == GOAL).any(), np.array(ENDINGS)[made.ending]
    assert not made.failed[made.ending == GOAL].any()


def test_an_ego_that_takes_the_exit_is_on_the_ramp() -> None:
    made = simulation("exit-v0", "idm_mobil", 40, duration_s=60.0)
    while made.scene.active.any():
        made.step()
    ego = on_network(made)[made.ending == GOAL, 0]
    assert ego["x"].min() > 495.0  # the ramp begins at 500 m, beside the sixth lane
    assert ego["y"].min() > 22.0


def test_an_ego_that_leaves_a_roundabout_is_beyond_its_ring() -> None:
    made = simulation("roundabout-v1", "idm_mobil", 40, duration_s=60.0)
    while made.scene.active.any():
        made.step()
    ego = on_network(made)[made.ending == GOAL, 0]
    # The way out leaves the outer lane, of 24 m radius, 24 degrees before the north.
    assert ego["x"].max() < 24 * np.sin(np.radians(24))
    assert ego["y"].max() < -24 * np.cos(np.radians(24))


def suite(agent: str, *roads: str, traffic: str = "environment", **profile: object) -> Suite:
    return Suite.model_validate(
        {
            "suite": "roads",
            "episodes": 2,
            "scene": {"profile": {"name": "charms", **profile}},
            "egos": [{"agent": agent}],
            "roads": roads,
            "traffic_models": [{"traffic": traffic}],
        }
    )


@pytest.mark.parametrize(
    ("profile", "first", "lowest"), [("charms", 8.0, 8.0), ("highway-env", 10.0, 5.0)]
)
def test_target_speeds_begin_where_the_road_needs_it(
    profile: str, first: float, lowest: float
) -> None:
    """The ego starts at 8 m/s; the profiles' target speeds are 22 to 33, and 20, 25 and 30 m/s."""
    made = simulation("roundabout-v0", Slowing(), 1, profile={"name": profile})
    assert made.engine.state.target_speed[0, 0] == pytest.approx(first)
    made.step()
    assert made.engine.state.target_speed[0, 0] == pytest.approx(lowest)


def test_the_table_says_where_target_speeds_begin_lower() -> None:
    said = first_speeds(suite("charms", "roundabout-v0"))
    assert "of the profile: 8 m/s on roundabout-v0." in said
    assert not first_speeds(suite("charms", "roundabout-v0", target_speed_min_mps=0.0))


def test_an_unknown_road_is_rejected_by_name() -> None:
    with pytest.raises(InputError, match=r"no road named 'merge-v9'.*merge-v0"):
        plan(suite("idm_mobil", "merge-v9"))


HUMANS = OneAgent("human")
MIXED = Mixture({"human": 0.5, "charms": 0.5})


def test_a_state_without_its_last_bit_is_another_state() -> None:
    made = simulation("merge-v0", "idm_mobil", 1)
    before = made.state()
    on_network(made)["x"][0, 2] = np.nextafter(on_network(made)["x"][0, 2], np.inf)
    assert made.state() != before


def test_a_state_can_be_that_of_no_scene() -> None:
    made = simulation("merge-v0", "idm_mobil", 1)
    state = made.state(np.zeros(0, dtype=np.int64))
    assert len(state) == 0
    assert state.network.shape[1] == made.state().network.shape[1]


@pytest.mark.parametrize("road", ["merge-v1", "roundabout-v1", "intersection-v1", "exit-v0"])
def test_branches_of_saved_states_continue_exactly(road: str, tmp_path: Path) -> None:
    made = simulation(road, "charms", 5, Mixture({"human": 0.5, "charms": 0.5}))
    for _ in range(4):
        made.step()
    made.advance()
    save_state(made.state(), tmp_path / "state.json")
    state = load_state(tmp_path / "state.json")
    assert state == made.state()
    branches = simulation(road, "charms", 20, Mixture({"human": 0.5, "charms": 0.5}))
    branches.restore(state.take(np.repeat(np.arange(5), 4)))
    while made.scene.active.any():
        made.step()
        branches.step()
    assert branches.state() == made.state().take(np.repeat(np.arange(5), 4))


def test_a_state_of_another_road_is_rejected_by_the_names_of_both() -> None:
    merge, bend = (simulation(road, "idm_mobil", 1) for road in ("merge-v0", "u-turn-v1"))
    with pytest.raises(InputError, match="the state is of merge-v0, and this scene is on u-turn"):
        bend.restore(merge.state())


@pytest.mark.parametrize("column", ["lane", "route_roads", "order", "lanes of ways", "kind"])
def test_a_state_with_an_impossible_index_is_rejected(column: str) -> None:
    made = simulation("merge-v0", "idm_mobil", 1)
    assert isinstance(made.engine, RoadEngine)
    state = made.state()
    parts = unpack(state.network, made.engine._kept)
    start = sum(each.nbytes for each in [*parts.values()][: [*parts].index(column)])
    wrong = state.network.copy()
    wrong[0, start : start + 8] = np.frombuffer(np.int64(10_000).tobytes(), np.uint8)
    with pytest.raises(InputError, match=r"network: .*found 10000, expected"):
        made.restore(replace(state, network=wrong, is_from_file=True))
    assert made.state() == state


def test_the_traffic_of_the_environment_is_driven_by_no_agent() -> None:
    assert TrafficSpec.model_validate("environment").make().agents == (PRESCRIBED,)


@pytest.mark.parametrize("traffic", [HUMANS, OneAgent("idm_mobil"), OneAgent("stackelberg")])
@pytest.mark.parametrize("road", ["merge-v0", "exit-v0", "u-turn-v1"])
def test_driver_models_drive_the_traffic_without_many_collisions(
    road: str, traffic: Traffic
) -> None:
    made = simulation(road, "idm_mobil", 20, traffic, duration_s=15.0)
    while made.scene.active.any():
        made.step()
    vehicles = on_network(made)[:, 1:]
    is_vehicle = vehicles["kind"] == COMMANDED
    assert is_vehicle.sum() == (vehicles["kind"] > OBSTACLE).sum() > 20
    assert vehicles["crashed"][is_vehicle].mean() < 0.1


@pytest.mark.parametrize(("profile", "reverses"), [(FREE, False), ({"name": "highway-env"}, True)])
def test_vehicles_of_agents_reverse_only_if_those_of_the_profile_do(
    profile: dict[str, Any], reverses: bool
) -> None:
    # They start 10 m apart at 20 m/s, so most have to stop.
    made = simulation("exit-v0", "human", 10, HUMANS, profile=profile)
    least, is_vehicle = 0.0, on_network(made)["kind"] == COMMANDED
    for _ in range(30):
        made.step()
        least = min(least, on_network(made)["speed"][is_vehicle].min())
    assert (least < 0) == reverses


def test_the_vehicle_on_the_ramp_merges_whoever_drives_it() -> None:
    made = simulation("merge-v0", "idm_mobil", 20, OneAgent("stackelberg"), duration_s=15.0)
    ramp = on_network(made)["lane"][:, 4].copy()
    while made.scene.active.any():
        made.step()
    ended = on_network(made)[:, 4]
    assert (ramp == ramp[0]).all()
    # The ramp is at y = 6.5 + 4 + 4 m, its last lane at 8 m, and the motorway at 0 and 4 m.
    assert (ended["y"][~ended["crashed"]] < 6.0).all()
    assert ended["crashed"].mean() < 0.5


def test_on_a_motorway_the_views_of_two_vehicles_differ_by_a_shift_along_it() -> None:
    made = simulation("merge-v0", "human", 10, HUMANS)
    assert isinstance(made.engine, RoadEngine)
    for _ in range(6):
        made.step()
    everyone = np.nonzero(on_network(made)["kind"] == COMMANDED)
    seen, (views, places) = made.engine.seen_by(everyone)
    x = on_network(made)["x"]
    motorway = on_network(made)["y"] < 6.0
    for b, i, v in zip(*everyone, views, strict=True):
        others = seen.present[v] & motorway[b]
        if motorway[b, i]:
            shift = seen.x[v, others] - seen.x[v, i]
            assert shift == pytest.approx(x[b, others] - x[b, i], abs=1e-9)
    np.testing.assert_array_equal(places, everyone[1])


class Slowing(Policy):
    """Always wants the next lower target speed."""

    def decide(self, observations: Any, *given: Any) -> Any:
        return np.full(len(observations), SLOWER)


class Looking(Policy):
    """Carries out IDLE; it only looks ahead."""

    rollouts_with = "idm_mobil"

    def decide(self, observations: Any, *given: Any) -> Any:
        return np.full(len(observations), IDLE)


@pytest.mark.parametrize("place", [0, 1])
@pytest.mark.parametrize("road", ["merge-v1", "roundabout-v1", "intersection-v1", "two-way-v0"])
def test_a_rollout_on_a_road_is_what_then_happens(road: str, place: int) -> None:
    """IDM+MOBIL really drives the others, and has the temperament that planners assume."""
    scenes, hz = 6, 3
    made = simulation(road, Looking(), scenes, OneAgent("idm_mobil"), decision_hz=hz)
    made.step()
    made.step()
    made.scene.temperament[:] = 0.5
    plans = np.random.default_rng(2).integers(0, 5, (4, 6))
    vehicles = np.arange(scenes), np.full(scenes, place)
    state = made.state()
    found = Futures(made, Looking()).of(vehicles)(plans)
    assert made.state() == state
    agents: dict[str, Agent] = {"idm_mobil": make_agent("idm_mobil")}
    for k, actions in enumerate(plans):
        traffic = OneAgent("idm_mobil")
        alone = Simulation(made.settings, scenes, None, traffic, agents, RoadEngine)
        alone.egos_end_episodes = place == 0
        others = state.driven_by("idm_mobil", np.ones(state.drivers.shape, dtype=bool))
        alone.restore(others.seated(vehicles[1], ""))
        crashed = np.zeros(scenes, dtype=bool)
        for decision, action in enumerate(actions):
            alone.command(vehicles, np.full(scenes, action))
            alone.step()
            view, seats = alone.engine.seen_by(vehicles)
            for name in ("x", "y", "speed"):
                np.testing.assert_array_equal(
                    getattr(found, name)[:, k, decision], getattr(view, name)[seats], name
                )
            crashed |= alone.engine.state.crashed[vehicles]
            assert (found.failed[:, k, decision] >= crashed).all()


def test_the_ego_can_be_any_of_the_first_vehicles_and_the_scene_stays_the_same() -> None:
    columns = ["x", "y", "speed", "lane"]
    found = {}
    for slots in (1, 4):
        on = on_road(SceneSettings(profile="roads"), NamedRoad(name="roundabout-v1"))
        on, agents = on.model_copy(update={"ego_slots": slots}), {"a": make_agent("idm_mobil")}
        made = Simulation(on, 200, "a", OneAgent("a"), agents, RoadEngine)
        made.reset(np.arange(200, dtype=np.uint64))
        found[slots] = made.engine.episodes.scenes.vehicles[columns]
    first, drawn = found[1], found[4]
    np.testing.assert_array_equal(np.sort(first, axis=1), np.sort(drawn, axis=1))
    places = (first == drawn[:, :1]).argmax(axis=1)
    # 50 of 200 are expected at each of four places, with a standard deviation of 6.
    assert (np.abs(np.bincount(places, minlength=5)[:4] - 50) < 25).all()
    assert places.max() == 3
    rest = np.arange(1, 5)
    moved = np.where(rest == places[:, None], 0, rest)
    np.testing.assert_array_equal(drawn[:, 1:], np.take_along_axis(first, moved, axis=1))


def test_who_drives_at_the_egos_new_place_drives_the_vehicle_that_comes_there() -> None:
    on = on_road(SceneSettings(profile="roads"), NamedRoad(name="roundabout-v1"))
    on = on.model_copy(update={"ego_slots": 5})
    traffic, agents = OneAgent(PRESCRIBED), {"a": make_agent("idm_mobil")}
    made = Simulation(on, 200, "a", traffic, agents, RoadEngine)
    made.reset(np.arange(200, dtype=np.uint64))
    vehicles = made.engine.episodes.scenes.vehicles
    is_other = vehicles["kind"][:, 1:] > OBSTACLE
    assert is_other.any(axis=1).all()
    assert (vehicles["kind"][:, 1:][is_other] == IDM).all()
    assert (vehicles["kind"][:, 0] == COMMANDED).all()
    first = vehicles["speed"][:, 1:].copy()
    for _ in range(30):
        made.step()
    # The ego of this road starts with 8 m/s, and vehicles of the environment want to drive faster.
    displaced = is_other & (first == 8.0)
    assert displaced.sum() > 100
    assert (vehicles["speed"][:, 1:][displaced] != 8.0).all()


def test_on_the_motorway_with_an_exit_only_who_is_sent_there_reaches_a_goal_on_the_ramp() -> None:
    on = on_road(SceneSettings(profile="roads"), NamedRoad(name="exit-v1"), 30.0)
    sent = {}
    for slots in (1, 21):
        agents = {"a": make_agent("idm_mobil")}
        scene = on.model_copy(update={"ego_slots": slots})
        made = Simulation(scene, 40, "a", OneAgent("a"), agents, RoadEngine)
        made.reset(np.arange(40, dtype=np.uint64))
        lanes, ego = made.engine.episodes.task.lanes, made.engine.episodes.scenes.vehicles[:, 0]
        sent[slots] = int((ego["route_end"] == 2).sum())
        ego["lane"] = lanes["2", "exit", 0]
        found = made.engine.episodes.task.has_reached_goal(
            made.engine.episodes.scenes, np.full(40, -1)
        )
        np.testing.assert_array_equal(found, ego["route_end"] == 2)
    assert sent[1] == 40
    assert 0 < sent[21] < 10
