"""The traffic on highway-env's roads, each vehicle along its own way."""

from typing import Any

import numpy as np
import polars as pl
import pytest
from handmade_conduct import conduct

from charms_bench.engine.simulation import Simulation
from charms_bench.plugins.registry import make_agent
from charms_bench.plugins.traffic import Mixture, OneAgent, Traffic
from charms_bench.recording.columns import DRIVER_SUMS
from charms_bench.recording.primitives import NEAR, NOBODY, SEEN
from charms_bench.recording.recording import Recording
from charms_bench.roads.agent_stepping import show_each
from charms_bench.roads.engine import RoadEngine
from charms_bench.roads.settings import on_road
from charms_bench.world.candidate_lanes import LEFT, OWN, RIGHT
from charms_bench.world.named_road import NamedRoad
from charms_bench.world.scenario import PRESCRIBED
from charms_bench.world.scene import Scene, SceneSettings

FREE = {"name": "charms", "speed_min_mps": 0.0, "target_speed_min_mps": 0.0}
OF_FAULT = ("at_fault", "rear_end_striking", "rear_end_struck", "side")
"""What is judged by other rules on other roads."""


def simulation(
    road: str,
    scenes: int,
    traffic: Traffic,
    ego: str = "idm_mobil",
    duration_s: float = 20.0,
    **configuration: Any,
) -> Simulation:
    """Scenes on a road that have just started."""
    named = NamedRoad(name=road, configuration=configuration or None)
    given = {"profile": FREE, "duration_s": duration_s}
    settings = on_road(SceneSettings.model_validate(given), named)
    agents = {name: make_agent(name) for name in {ego, *traffic.agents} - {PRESCRIBED}}
    made = Simulation(settings, scenes, ego, traffic, agents, RoadEngine)
    made.reset(np.arange(scenes, dtype=np.uint64))
    return made


@pytest.mark.parametrize("traffic", [OneAgent(PRESCRIBED), Mixture({"charms": 0.5, "human": 0.5})])
def test_on_a_straight_network_the_traffic_does_what_the_straight_road_says(
    traffic: Traffic,
) -> None:
    scenes, lanes = 8, 3
    crowd = {"lanes_count": lanes, "vehicles_count": 20, "vehicles_density": 3.0}
    made = simulation("highway-v0", scenes, traffic, **crowd)
    recording = Recording(made)
    names = ("x", "y", "heading", "speed", "acceleration", "steering", "lane", "target_lane",
             "crashed")  # fmt: skip
    frames: list[dict[str, Any]] = []

    def keep() -> None:
        frames.append({name: getattr(made.engine.state, name).copy() for name in names})

    keep()
    made.step_watchers.append(keep)
    while made.scene.active.any():
        made.step()
        recording.note()
    rows = recording.drivers().filter(~pl.col("is_ego"))
    compared = [name for name in DRIVER_SUMS if name not in OF_FAULT]
    for b in range(scenes):
        own = frames[: int(made.steps[b]) * made.settings.steps_per_decision + 1]
        fields = {name: np.array([frame[name][b] for frame in own]) for name in names}
        expected = conduct(every=5, collision=fields["crashed"] * 3, **fields)[1:]
        found = rows.filter(episode=b).select(pl.col(compared).sum()).row(0, named=True)
        for name in compared:
            total = sum(each[name] for each in expected)
            assert found[name] == pytest.approx(total, abs=1e-6), (b, name)
    events = ("lane_changes", "hard_braking_by", "near_misses_by", "pet_by", "rss_by_s")
    counted = rows.select(pl.col(events).sum()).row(0, named=True)
    assert all(counted.values()), counted


def test_every_vehicle_is_counted_on_a_road_where_they_come_and_go() -> None:
    made = simulation("intersection-v1", 6, OneAgent(PRESCRIBED))
    recording = Recording(made)
    state = made.engine.state
    met: list[set[int]] = [set() for _ in range(6)]
    lost: list[set[int]] = [set() for _ in range(6)]
    driven = np.zeros(6)
    running = np.ones(6, dtype=np.bool_)
    while True:
        for b, i in zip(*np.nonzero(state.present & running[:, None]), strict=True):
            if i:
                met[b].add(int(state.entry[b, i]))
                if state.crashed[b, i]:
                    lost[b].add(int(state.entry[b, i]))
        if not made.scene.active.any():
            break
        running = made.scene.active.copy()
        was = state.entry.copy(), state.present.copy(), state.x.copy(), state.y.copy()
        made.step()
        recording.note()
        stayed = was[1] & state.present & (state.entry == was[0]) & running[:, None]
        moved = np.hypot(state.x - was[2], state.y - was[3])
        driven += np.where(stayed[:, 1:], moved[:, 1:], 0.0).sum(axis=1)
    rows = recording.episodes()
    assert rows["traffic_vehicles"].to_list() == [len(each) for each in met]
    assert rows["traffic_crashed"].to_list() == [len(each) for each in lost]
    # The way is longer than the chords between decisions, but only a little.
    np.testing.assert_allclose(rows["traffic_distance_m"], driven, rtol=0.03)
    assert rows["traffic_crashed"].sum() > 0


def test_a_vehicle_that_passes_the_end_of_its_road_no_longer_counts() -> None:
    scenes, end = 24, 170.0 + 5.0  # of the exits of highway-env's roundabout, and its margin
    made = simulation("roundabout-v1", scenes, OneAgent("idm_mobil"), "yielding_human", 45.0)
    recording, state = Recording(made), made.engine.state
    counts, beyond = state.present.copy(), np.zeros_like(state.present)
    driven, collided, outside = np.zeros(scenes), 0, 0
    counts[:, 0] = False
    while made.scene.active.any():
        running = made.scene.active[:, None].copy()
        was_x, was_y, was_crashed = state.x.copy(), state.y.copy(), state.crashed.copy()
        made.step()
        recording.note()
        beyond |= (np.abs(state.x) >= end) | (np.abs(state.y) >= end)
        new = state.crashed & ~was_crashed & running
        outside += int((new & beyond)[:, 1:].sum())
        counts &= ~beyond
        collided += int((new & counts).sum())
        driven += np.where(counts & running, np.hypot(state.x - was_x, state.y - was_y), 0).sum(1)
    assert outside > 0
    assert collided > 0
    np.testing.assert_allclose(recording.episodes()["traffic_distance_m"], driven, rtol=0.05)
    rows = recording.drivers().filter(~pl.col("is_ego"))
    counted = rows.select(pl.sum("rear_end_striking", "rear_end_struck", "side")).row(0)
    assert sum(counted) == collided


def test_a_vehicle_that_turns_round_at_the_end_of_its_road_no_longer_counts() -> None:
    scenes, ends = 12, (2.5, 800.0 - 2.5)  # where highway-env's vehicles look for the next lane
    made = simulation("two-way-v0", scenes, OneAgent(PRESCRIBED), "yielding_human", 45.0)
    recording, state = Recording(made), made.engine.state
    y, lost, ended = state.y.copy(), np.zeros_like(state.present), np.zeros_like(state.present)
    while made.scene.active.any():
        running = made.scene.active[:, None].copy()
        made.step()
        recording.note()
        ended |= running & ((state.x < ends[0]) | (state.x > ends[1]))
        lost |= running & ~ended & (state.crashed | (np.abs(state.y - y) > 2.0))
    assert ended[:, 1:].mean() > 0.5
    assert recording.episodes()["traffic_crashed"].to_list() == lost[:, 1:].sum(axis=1).tolist()


@pytest.mark.parametrize("road", ["merge-v1", "roundabout-v1"])
def test_a_vehicle_that_comes_to_another_road_changes_no_lane(road: str) -> None:
    scenes = 10
    made = simulation(road, scenes, OneAgent(PRESCRIBED))
    recording, table = Recording(made), made.engine.episodes.scenes
    first = table.road.lanes["first"]
    changes = np.zeros(scenes)
    while made.scene.active.any():
        was, running = table.vehicles["lane"].copy(), made.scene.active.copy()
        made.step()
        recording.note()
        lane = table.vehicles["lane"]
        is_change = (lane != was) & (first[lane] == first[was]) & made.engine.state.present
        changes += is_change[:, 1:].sum(axis=1) * running
    rows = recording.drivers().filter(~pl.col("is_ego"))
    counted = rows.group_by("episode").agg(pl.col("lane_changes").sum()).sort("episode")
    # A change within the interval in which the road changes has no place on either.
    assert changes.sum() > 0
    np.testing.assert_allclose(counted["lane_changes"], changes, atol=1)
    assert abs(counted["lane_changes"].sum() - changes.sum()) <= 0.15 * changes.sum()


@pytest.mark.parametrize("road", ["merge-v1", "roundabout-v1", "intersection-v1", "highway-v0"])
def test_a_vehicle_has_the_neighbours_that_its_whole_view_has(road: str) -> None:
    scenes = 4
    made = simulation(road, scenes, Mixture({PRESCRIBED: 0.5, "human": 0.5}))
    views, engine = made.engine.views(), made.engine
    made.step_watchers.append(views.follow)
    places = made.settings.vehicles
    width = NEAR + places - 1
    shown, whole = (Scene.empty(made.settings, n) for n in (scenes, scenes * places))
    compared = np.zeros(NEAR, dtype=np.int64)
    while made.scene.active.any():
        made.step()
        rows, viewers = np.nonzero(engine.state.present & made.scene.active[:, None])
        ends = width * np.arange(1, rows.size + 1)
        seen = np.zeros(rows.size * width, SEEN)
        views.look(np.nonzero(made.scene.active)[0])
        views.see((rows, viewers), ends, seen)
        show_each(views._scenes, shown.unpacked, whole.unpacked, rows, viewers)
        for b, i, own in zip(rows, viewers, seen.reshape(-1, width), strict=True):
            v = b * places + i
            leaders = whole.leaders[v, i, [LEFT, OWN, RIGHT]]
            expected = [*leaders, whole.followers[v, i, OWN]]
            assert own["place"][:NEAR].tolist() == expected
            assert own["place"][NEAR:].tolist() == [j for j in range(places) if j != i]
            there = own["place"] != NOBODY
            there[there] = whole.present[v, own["place"][there]]
            for name in ("x", "y", "lane", "target_lane", "direction_x", "direction_y"):
                # Of the follower and of vehicles that are not near, no direction is shown.
                which = there & (np.arange(width) < NEAR - 1) if "direction" in name else there
                expected = getattr(whole, name)[v, own["place"][which]]
                assert (own[name][which] == expected).all(), (name, b, i)
            compared += there[:NEAR]
    assert (compared[[1, 3]] > 0).all()  # the leader and the follower
