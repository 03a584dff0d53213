"""The rows of an episode, against the scene they were taken from."""

import numpy as np
import polars as pl
import pytest
from charms_baselines.idm_mobil import IdmMobil
from handmade_conduct import vehicles_of

from charms_bench.engine.simulation import Simulation
from charms_bench.plugins.traffic import OneAgent
from charms_bench.recording.columns import EPISODE_SCHEMA, OF_ROADS, STEP_SCHEMA
from charms_bench.recording.planar_ttc import planar_ttc
from charms_bench.recording.recording import Recording
from charms_bench.world.scene import SceneSettings

SHORT = SceneSettings(duration_s=4.0)
FASTER, SLOWER = 3, 4


def simulation(settings: SceneSettings, scenes: int, ego: str | None = "idm_mobil") -> Simulation:
    made = Simulation(settings, scenes, ego, OneAgent("idm_mobil"), {"idm_mobil": IdmMobil()})
    made.reset(np.arange(scenes, dtype=np.uint64))
    return made


def recorded(made: Simulation, action: int | None = None) -> Recording:
    recording = Recording(made)
    actions = None if action is None else np.full(made.seeds.size, action)
    while made.scene.active.any():
        made.step(actions)
        recording.note()
    return recording


def test_there_is_a_row_for_every_decision_and_every_episode() -> None:
    recording = recorded(simulation(SHORT, 3))
    steps, episodes = recording.steps(), recording.episodes()
    assert steps.schema == STEP_SCHEMA
    optional = ("traffic_time_s", *OF_ROADS)
    assert [*episodes.schema, *optional] == [*EPISODE_SCHEMA]
    assert all(episodes.schema[name] == EPISODE_SCHEMA[name] for name in episodes.schema)
    assert steps["episode"].to_list() == [0] * 12 + [1] * 12 + [2] * 12
    assert steps["step"].to_list() == list(range(1, 13)) * 3
    assert episodes["ending"].to_list() == ["time"] * 3
    assert episodes["duration_s"].to_list() == [4.0] * 3
    assert episodes["traffic_vehicles"].to_list() == [20] * 3


def test_the_last_row_is_the_scene_at_the_end() -> None:
    made = simulation(SHORT, 4)
    last = recorded(made).steps().group_by("episode", maintain_order=True).last()
    scene, ego = made.scene, made.ego_vehicles
    for name in ("x", "y", "heading", "speed", "acceleration", "steering", "lane"):
        values = getattr(scene, name)[ego]
        np.testing.assert_array_equal(last[name], values.astype(last[name].to_numpy().dtype))


def test_leader_follower_and_vehicles_near_are_those_of_the_scene() -> None:
    made = simulation(SHORT, 4)
    last = recorded(made).steps().group_by("episode", maintain_order=True).last()
    for b, row in enumerate(last.iter_rows(named=True)):
        scene, ego = made.scene, made.scene.ego[b]
        ahead = scene.x[b] - scene.x[b, ego]
        on_lane = np.abs(scene.y[b] - 4.0 * row["lane"]) <= 3.0  # half a lane and 1 m
        assert row["leader_distance"] == pytest.approx(ahead[on_lane & (ahead > 0)].min())
        behind = -ahead[on_lane & (ahead < 0)]
        leader = None if row["leader"] is None else ahead[row["leader"]]
        assert row["leader_distance"] == (None if leader is None else pytest.approx(leader))
        follower = None if row["follower"] is None else -ahead[row["follower"]]
        assert row["follower_distance"] == (None if follower is None else pytest.approx(follower))
        assert row["follower_distance"] == (pytest.approx(behind.min()) if behind.size else None)
        near = (np.abs(ahead) <= 30.0) & (np.abs(scene.lane[b] - row["lane"]) <= 1)
        assert row["vehicles_near"] == near.sum()


def test_the_planar_ttc_is_that_of_the_scene() -> None:
    made, found = simulation(SceneSettings(density=2.0), 20, ego=None), []
    recording = Recording(made)
    while made.scene.active.any():
        made.step(np.full(20, FASTER))
        recording.note()
        vehicles, egos = vehicles_of(made.scene), made.scene.ego
        times = [planar_ttc(vehicles[b], egos[b]) for b in range(20)]
        found += [(made.seeds[b], made.steps[b], times[b]) for b in range(20)]
    expected = pl.DataFrame(found, schema=["episode", "step", "time"], orient="row").unique(
        ["episode", "step"], keep="first"
    )
    steps = recording.steps().join(expected.cast({"step": pl.Int32}), on=["episode", "step"])
    assert len(steps) == len(recording.steps())
    near = steps.filter(pl.col("time").is_finite())
    assert steps["planar_ttc"].null_count() == len(steps) - len(near) > 0 < len(near)
    np.testing.assert_allclose(near["planar_ttc"], near["time"], rtol=1e-6)


def test_what_does_not_exist_is_null() -> None:
    steps = recorded(
        simulation(SceneSettings(duration_s=1.0, traffic_vehicles=0, ego_slots=1), 2)
    ).steps()
    assert steps.select(pl.col("^(leader|follower).*$")).null_count().row(0) == (6,) * 9
    assert steps["action"].null_count() == steps["planar_ttc"].null_count() == 6
    assert steps["new_follower_acceleration"].null_count() == 6
    assert steps["vehicles_near"].to_list() == [1] * 6


def test_a_crash_ends_the_rows_and_names_its_kind() -> None:
    recording = recorded(simulation(SceneSettings(), 6, ego=None), action=FASTER)
    steps, episodes = recording.steps(), recording.episodes()
    crashed = episodes.filter(pl.col("ending") == "rear_end")
    assert len(crashed) > 0
    assert (crashed["steps"] < 60).all()
    counts = steps.group_by("episode", maintain_order=True).len()["len"]
    assert counts.to_list() == episodes["steps"].to_list()
    assert (steps["action"] == FASTER).all()


def test_a_rear_end_collision_says_whether_the_ego_was_struck() -> None:
    faster = recorded(simulation(SceneSettings(), 6, ego=None), action=FASTER).episodes()
    assert set(faster.filter(pl.col("ending") == "rear_end")["struck"]) == {False}
    assert set(faster.filter(pl.col("ending") != "rear_end")["struck"]) <= {None}
    made = simulation(SceneSettings(traffic_vehicles=1, ego_slots=1), 1, ego=None)
    scene, (ego,) = made.scene, made.scene.ego
    (follower,) = {0, 1} - {int(ego)}
    scene.x[0, follower], scene.y[0, follower] = scene.x[0, ego] - 6.0, scene.y[0, ego]
    scene.speed[0, follower], scene.speed[0, ego] = 33.0, 22.0
    episodes = recorded(made, action=SLOWER).episodes()
    assert episodes.select("ending", "struck").row(0) == ("rear_end", True)


def test_the_vehicle_that_the_ego_hits_counts_as_crashed_traffic() -> None:
    episodes = recorded(simulation(SceneSettings(), 6, ego=None), action=FASTER).episodes()
    hit = episodes.filter(pl.col("ending") == "rear_end")
    assert (hit["traffic_crashed"] >= 1).all()


def test_distances_are_those_along_the_road() -> None:
    made = simulation(SHORT, 2)
    start = made.scene.x.copy()
    episodes = recorded(made).episodes()
    driven = made.scene.x - start
    ego = driven[made.ego_vehicles]
    np.testing.assert_allclose(episodes["distance_m"], ego)
    np.testing.assert_allclose(episodes["traffic_distance_m"], driven.sum(axis=1) - ego)


def test_the_braking_of_a_wreck_is_not_recorded() -> None:
    made = simulation(SHORT, 4)
    recording = Recording(made)
    made.step()
    made.scene.crashed[...] = True
    recording.note()
    steps = recording.steps()
    assert steps["follower_distance"].is_not_null().any()
    assert steps["follower_acceleration"].is_null().all()
