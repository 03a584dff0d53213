"""The observation `interaction`, and the conflicts between lanes that it is made of."""

import math
from typing import Any

import numpy as np
import pytest

from charms_bench.engine.simulation import Simulation
from charms_bench.envs.ego_env import ego_vector_env
from charms_bench.plugins.registry import make_agent
from charms_bench.plugins.traffic import OneAgent
from charms_bench.roads.conflicts import BEHIND, CROSSING, FIRST, MERGING, conflicts
from charms_bench.roads.engine import RoadEngine
from charms_bench.roads.episodes import Episodes
from charms_bench.roads.scenes import BEHIND as OWN_LANE
from charms_bench.roads.scenes import OBSTACLE
from charms_bench.roads.settings import on_road
from charms_bench.world.interaction_observation import CLEAR_M, FIRST_CONFLICT, Interaction
from charms_bench.world.named_road import NamedRoad
from charms_bench.world.observations import described, observation_described
from charms_bench.world.road import local_coordinates
from charms_bench.world.scenario import PRESCRIBED
from charms_bench.world.scene import SceneSettings

PROFILE = {"name": "charms", "speed_min_mps": 0.0, "target_speed_min_mps": 0.0}
Lane = tuple[str, str, int]


def found(road: str, one: Lane, other: Lane) -> list[tuple[float, float, int, int]]:
    """How far the conflicts of two lanes are along both, their kinds and priorities."""
    episodes = Episodes(road, 1)
    names, table = episodes.task.lanes, episodes.conflicts
    lane = names[one]
    return [
        (float(table.s[c]), float(table.other_s[c]), int(table.kind[c]), int(table.priority[c]))
        for c in range(table.first[lane], table.first[lane + 1])
        if table.other[c] == names[other]
    ]


def test_lanes_cross_where_their_lines_do() -> None:
    # From south to north at x = 2 and from west to east at y = 2, both from 11 m before the centre;
    # between east and west, vehicles have the right of way.
    north, east = ("ir0", "il2", 0), ("ir1", "il3", 0)
    assert found("intersection-v1", north, east) == [(9.0, 13.0, CROSSING, BEHIND)]
    assert found("intersection-v1", east, north) == [(13.0, 9.0, CROSSING, FIRST)]


def test_a_ramp_merges_at_its_end_and_gives_way() -> None:
    # The ramp is beside the right lane for 80 m and then ends.
    right, ramp = ("b", "c", 1), ("b", "c", 2)
    assert found("merge-v1", ramp, right) == [(80.0, 80.0, MERGING, BEHIND)]
    assert found("merge-v1", right, ramp) == [(80.0, 80.0, MERGING, FIRST)]
    assert found("merge-v1", ("b", "c", 0), ramp) == []


def test_the_right_hand_side_goes_first_where_priorities_are_equal() -> None:
    episodes = Episodes("intersection-v1", 1)
    names = episodes.task.lanes
    table = conflicts(episodes.scenes.road, np.zeros(len(names), dtype=np.int64))
    # Who drives north has those on the right who come from the east and drive west.
    for other, expected in ((("ir3", "il1", 0), BEHIND), (("ir1", "il3", 0), FIRST)):
        lane = names["ir0", "il2", 0]
        own = range(table.first[lane], table.first[lane + 1])
        assert [table.priority[c] for c in own if table.other[c] == names[other]] == [expected]


def driven(road: str, decisions: int, traffic: str = PRESCRIBED) -> Simulation:
    """20 scenes some decisions after their starts, driven by IDM+MOBIL."""
    settings = SceneSettings.model_validate({"profile": PROFILE})
    agents = {"ego": make_agent("idm_mobil")}
    if traffic != PRESCRIBED:
        agents[traffic] = make_agent(traffic)
    on = on_road(settings, NamedRoad(name=road))
    simulation = Simulation(on, 20, "ego", OneAgent(traffic), agents, RoadEngine)
    simulation.reset(np.arange(20, dtype=np.uint64))
    for _ in range(decisions):
        simulation.step()
    return simulation


def seen(simulation: Simulation) -> np.ndarray:
    egos = np.arange(20), np.zeros(20, dtype=np.int64)
    return Interaction()(*simulation.engine.seen_by(egos))


def plainly_met(engine: RoadEngine, b: int) -> list[tuple[float, float, float, int]]:
    """Both distances, speed and priority of the vehicles that an ego meets, the nearest first."""
    scenes, table = engine.episodes.scenes, engine.episodes.conflicts
    vehicles, road = scenes.vehicles[b], scenes.road
    lanes, starts = (scenes.ways[name][b, 0] for name in ("lanes", "starts"))
    at = float(vehicles["x"][0]), float(vehicles["y"][0])
    x = starts[OWN_LANE] + local_coordinates(road, int(lanes[OWN_LANE]), *at)[0]
    met = []
    for j in range(1, len(vehicles)):
        lane, options = int(vehicles["lane"][j]), []
        for k in range(OWN_LANE - 1, lanes.size):
            for c in range(*table.first[lanes[k] : lanes[k] + 2]) if lanes[k] >= 0 else ():
                own, after = starts[k] + table.s[c] - x, lanes[k + 1] if k + 1 < lanes.size else -1
                leads = table.kind[c] == CROSSING or after in (-1, table.into[c])
                feeds = slice(*table.first_feed[c : c + 2])
                place = float(vehicles["x"][j]), float(vehicles["y"][j])
                to_go = table.to_go[feeds][table.feed[feeds] == lane]
                other = to_go[0] - local_coordinates(road, lane, *place)[0] if to_go.size else None
                if leads and other is not None and all(-CLEAR_M <= d <= 100 for d in (own, other)):
                    options.append((own, other, float(vehicles["speed"][j]), table.priority[c]))
        if options and vehicles["kind"][j] > OBSTACLE:
            met.append(min(options, key=lambda each: each[0]))
    return sorted(met, key=lambda each: each[0] + each[1])


@pytest.mark.parametrize(("road", "decisions"), [("roundabout-v1", 6), ("merge-v1", 27)])
def test_rows_of_conflicts_are_those_of_a_plain_search(road: str, decisions: int) -> None:
    simulation, count = driven(road, decisions), 0
    engine, rows = simulation.engine, seen(simulation)[:, FIRST_CONFLICT:]
    assert isinstance(engine, RoadEngine)
    for b in range(20):
        met = plainly_met(engine, b)
        count += len(met)
        assert (rows[b, :, 0] == ([1] * len(met) + [0] * 6)[:6]).all()
        for row, (own, other, speed, first) in zip(rows[b], met, strict=False):
            expected = own / 100, other / 100, speed / 33
            assert row[1:4] == pytest.approx(expected, abs=1e-6)
            own_speed = max(float(engine.episodes.scenes.vehicles["speed"][b, 0]), 0.5)
            later = other / max(speed, 0.5) - own / own_speed
            assert row[4] == pytest.approx(min(max(later / 10, -1), 1), abs=1e-5)
            assert row[6] == first
    assert count > 5


@pytest.mark.parametrize("road", ["roundabout-v1", "intersection-v1", "exit-v1"])
def test_what_a_driver_cannot_see_changes_no_bit(road: str) -> None:
    simulation = driven(road, 4)
    engine = simulation.engine
    assert isinstance(engine, RoadEngine)
    before = seen(simulation)
    assert before[:, 2:, 0].any()
    others: Any = engine.episodes.scenes.vehicles[:, 1:]
    lanes = engine.episodes.scenes.road.lanes.size
    for name in ("route_roads", "route_numbers", "target_lane"):
        others[name] = (others[name] + 3) % lanes
    others["route_step"], others["route_end"] = 0, 5
    for name in ("target_speed", "timer_s", "exponent", "gains", "free_acceleration"):
        others[name] += 7.0
    others["is_yielding"] = ~others["is_yielding"]
    others["kind"] += (others["kind"] > OBSTACLE) & (others["kind"] < 6)
    engine.drivers[:, 1:] += 1
    engine.state.memory[:] += 1.0
    engine.state.parameters[:] += 1.0
    engine._moved[:] = True
    np.testing.assert_array_equal(seen(simulation), before)


@pytest.mark.parametrize(("aside_m", "is_hidden"), [(0.0, True), (1.9, True), (2.1, False)])
def test_a_vehicle_hides_what_is_behind_it(aside_m: float, is_hidden: bool) -> None:
    simulation = driven("intersection-v1", 2)
    engine = simulation.engine
    assert isinstance(engine, RoadEngine)
    vehicles: Any = engine.episodes.scenes.vehicles
    b, j = np.argwhere(vehicles["kind"][:, 1:] > OBSTACLE)[0] + [0, 1]
    ego = vehicles[b, 0]
    vehicles["kind"][b, 1:] = 0
    # A vehicle from the east, and one of 10 m by 4 m between both, whose long side is across.
    lane = engine.episodes.task.lanes["o3", "ir3", 0]
    places = [(60.0, -2.0), (60.0 + ego["x"], -2.0 + ego["y"])]
    way = np.array([60.0 - ego["x"], -2.0 - ego["y"]])
    along = way / np.hypot(*way)
    across = np.array([-along[1], along[0]])
    middle = np.array(places[1]) / 2 + aside_m * across
    for i, (x, y), (cosine, sine) in ((j, places[0], (-1.0, 0.0)), (j + 1, middle, along)):
        other = vehicles[b, i : i + 1]
        other["kind"], other["x"], other["y"], other["lane"] = 6, x, y, lane
        other["direction_x"], other["direction_y"] = cosine, sine
        other["heading"], other["length"], other["width"] = np.arctan2(sine, cosine), 10.0, 4.0
    vehicles["lane"][b, j + 1] = engine.episodes.task.lanes["il0", "o0", 0]  # leads nowhere
    engine._moved[:] = True
    egos = np.arange(20), np.zeros(20, dtype=np.int64)
    shown = simulation.engine.seen_by(egos)
    counts = [
        Interaction(occlusion=each)(*shown)[b, FIRST_CONFLICT:, 0].sum() for each in (False, True)
    ]
    assert counts == [1.0, 0.0 if is_hidden else 1.0]


@pytest.mark.parametrize("road", ["intersection-v1", "merge-v1"])
def test_others_are_seen_with_errors_of_the_given_size(road: str) -> None:
    errors: dict[int, list[Any]] = {1: [], 2: [], 3: []}
    for decisions in (2, 4, 6):
        simulation = driven(road, decisions)
        egos = np.arange(20), np.zeros(20, dtype=np.int64)
        shown = simulation.engine.seen_by(egos)
        exact, hardly, blurred, again = (
            Interaction(distance_noise_m=metres, speed_noise_mps=mps)(*shown)
            for metres, mps in ((0.0, 0.0), (1e-6, 0.0), (2.0, 0.5), (2.0, 0.5))
        )
        np.testing.assert_array_equal(blurred, again)
        np.testing.assert_array_equal(blurred[:, :2], exact[:, :2])
        np.testing.assert_array_equal(blurred[..., 0], exact[..., 0])
        # Values at the end of their range are not known, and so neither is what follows of them.
        is_known = (np.abs(exact[..., 1:4]) < 1.0).all(axis=-1)
        np.testing.assert_allclose(hardly[is_known], exact[is_known], atol=2e-4)
        there = exact[:, 2:, 0] > 0
        difference = (blurred.astype(np.float64) - exact)[:, 2:]
        for rows, column, scale in ((slice(0, 6), 1, 100.0), (slice(6, 12), 2, 100.0)):
            errors[column].append((difference[:, rows, column] * scale)[there[:, rows]])
        errors[3].append((difference[..., 3] * 33.0)[there])
    for column, size in ((1, 2.0), (2, 2.0), (3, 0.5)):
        found = np.concatenate(errors[column])
        if found.size >= 100:
            assert abs(found.mean()) < 5 * size / np.sqrt(found.size)
            assert found.std() == pytest.approx(size, rel=0.25)
    assert np.concatenate(errors[3]).size >= 100


def test_on_a_straight_road_the_rows_are_the_neighbours() -> None:
    observed = []
    for observation in ("interaction", "neighbours"):
        env = ego_vector_env(20, observation=observation)
        observed.append(env.reset(seed=5)[0])
    ours, theirs = observed
    # The front vehicle is in row 4 of one and in row 3 of the other; vehicles are 5 m long.
    front, known = ours[:, 4], theirs[:, 3]
    near = known[:, 0] == 1
    assert near.sum() > 5
    ahead = known[near, 1].astype(np.float64) * 165 - 5
    np.testing.assert_allclose(front[near, 1] * 100, ahead, atol=1e-3)
    np.testing.assert_allclose(front[near, 2] * 20, known[near, 3] * 66, atol=1e-3)
    assert not ours[:, FIRST_CONFLICT:].any()
    assert (np.abs(ours) <= 1).all()


def test_the_text_in_a_network_describes_the_observation() -> None:
    for observation in (Interaction(), Interaction(conflicts=3)):
        assert observation_described(described(observation)) == observation
    assert math.prod(Interaction(conflicts=3).shape) == 11 * 8


def test_a_route_asks_for_the_lane_that_leads_to_an_exit_of_the_ring() -> None:
    # The exits begin beside the outer one of the two lanes, at the end of a part of the ring.
    simulation = driven("roundabout-v1", 0, "idm_mobil")
    scenes, asked = simulation.engine.episodes.scenes, []
    names = {lane: name for name, lane in simulation.engine.episodes.task.lanes.items()}
    for b in range(20):
        for i in range(1, 4):  # they start on the ring
            vehicle = scenes.vehicles[b, i]
            plain, with_exits = (
                Interaction(exit_lanes=option)(
                    *simulation.engine.seen_by((np.array([b]), np.array([i])))
                )
                for option in (False, True)
            )
            lanes = vehicle["route_roads"][: vehicle["route_end"]].tolist()
            nodes = [names[lane][:2] for lane in lanes]
            last = next(k for k, (_, end) in enumerate(nodes) if len(end) == 3) - 1
            own = local_coordinates(scenes.road, int(vehicle["lane"]), *vehicle[["x", "y"]])[0]
            to_go = (
                sum(float(scenes.road.lanes["length"][lane]) for lane in lanes[: last + 1]) - own
            )
            number, changed = names[int(vehicle["lane"])][2], with_exits != plain
            if number == 1 or last == 0:
                assert not changed.any()
                continue
            asked.append(to_go)
            np.testing.assert_allclose(
                with_exits[0, 1, 2:4], (0.25, min(to_go / 100, 1)), rtol=1e-6
            )
            changed[0, 1, 2:4] = False
            assert not changed.any()
    assert len(asked) > 20
