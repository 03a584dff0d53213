"""What drivers do to each other, against a plain version that reads whole trajectories."""

from collections import Counter

import numpy as np
import polars as pl
import pytest
from charms_baselines.idm_mobil import IdmMobil
from naive_conduct import NAMES, ahead, conduct
from naive_fault import at_fault
from scenes import scene_of

from charms_bench import ACTIONS, Mixture, Policy
from charms_bench.engine import MakeEngine
from charms_bench.engine.batched import BatchedEngine
from charms_bench.engine.collision_kinds import ANY_ANGLE, COLLISIONS, are_noted, note_collisions
from charms_bench.engine.simulation import Simulation
from charms_bench.plugins.traffic import OneAgent, Traffic
from charms_bench.recording.columns import DRIVER_SCHEMA, DRIVER_SUMS
from charms_bench.recording.recording import Recording
from charms_bench.world.scene import SceneSettings


class Reckless(Policy):
    """Draws its actions, so that vehicles change their minds, brake and collide."""

    weights_sha256 = ""

    def __init__(self) -> None:
        self._rng = np.random.default_rng(3)

    def decide(self, observations: np.ndarray) -> np.ndarray:
        return self._rng.choice(len(ACTIONS), size=len(observations), p=[0.2, 0.3, 0.2, 0.2, 0.1])


def _frame(made: Simulation) -> dict[str, np.ndarray]:
    scene = {name: getattr(made.scene, name).copy() for name in NAMES if name != "collision"}
    return scene | {"collision": made.collision.copy()}


def simulated(
    settings: SceneSettings, scenes: int, traffic: Traffic, engine: MakeEngine = BatchedEngine
) -> tuple[Simulation, Recording, list[dict[str, np.ndarray]]]:
    agents = {"idm_mobil": IdmMobil(), "reckless": Reckless()}
    made = Simulation(settings, scenes, "idm_mobil", traffic, agents, engine)
    made.reset(np.arange(900_000_000, 900_000_000 + scenes, dtype=np.uint64))
    recording, frames = Recording(made), [_frame(made)]
    while made.scene.active.any():
        for _ in range(settings.steps_per_decision):
            made.advance()
            frames.append(_frame(made))
        made.finish_step()
        recording.note()
    length = made.steps * settings.steps_per_decision + 1
    histories = [
        {name: np.stack([frame[name][b] for frame in frames[: length[b]]]) for name in NAMES}
        for b in range(scenes)
    ]
    return made, recording, histories


MIXED = Mixture({"reckless": 0.5, "idm_mobil": 0.5})


@pytest.mark.parametrize("traffic", [MIXED, OneAgent("reckless"), OneAgent("idm_mobil")])
def test_sums_are_those_of_a_plain_count_over_trajectories(traffic: Traffic) -> None:
    settings = SceneSettings(density=2.0, traffic_vehicles=14)
    made, recording, histories = simulated(settings, 24, traffic)
    rows, dt = recording.drivers(), 1 / settings.decision_hz
    every = settings.steps_per_decision
    assert rows.schema == DRIVER_SCHEMA
    events: Counter[str] = Counter()
    for b, history in enumerate(histories):
        fault = at_fault(history, every, settings.road)
        decisions = {name: values[::every] for name, values in history.items()}
        vehicles = conduct(decisions, dt, settings.road, fault)
        for row in rows.filter(pl.col("episode") == made.seeds[b]).iter_rows(named=True):
            places = [
                i
                for i in range(len(vehicles))
                if row["is_ego"] == (i == made.scene.ego[b]) and made.drivers[b, i] == row["agent"]
            ]
            assert row["vehicles"] == len(places) > 0
            for name in DRIVER_SUMS[1:]:
                expected = sum(vehicles[i][name] for i in places)
                assert row[name] == pytest.approx(expected, abs=1e-6), (b, row["agent"], name)
                events[name] += row[name]
    if traffic is MIXED:
        assert min(events.values()) > 0, events
        assert events["at_fault"] < events["crashed"]


def test_sums_over_drivers_are_those_of_the_episode() -> None:
    settings = SceneSettings(density=2.0)
    _, recording, _ = simulated(settings, 20, MIXED)
    traffic = (
        recording.drivers()
        .filter(~pl.col("is_ego"))
        .group_by("episode")
        .agg(pl.col(DRIVER_SUMS).sum())
    )
    both = recording.episodes().join(traffic, on="episode")
    assert len(both) == 20
    assert both["vehicles"].equals(both["traffic_vehicles"])
    assert both["crashed"].equals(both["traffic_crashed"])
    whole = both.filter(pl.col("crashed") == 0)
    np.testing.assert_allclose(whole["distance_m"], whole["traffic_distance_m"])
    np.testing.assert_allclose(whole["time_s"], 20 * whole["duration_s"])
    assert (both["distance_m"] < both["traffic_distance_m"] + 1e-6).all()


def test_what_one_does_another_suffers() -> None:
    _, recording, _ = simulated(SceneSettings(density=2.0), 20, MIXED)
    total = recording.drivers().select(pl.col(DRIVER_SUMS).sum()).row(0, named=True)
    for event in ("hard_braking", "conflicts", "near_misses", "pet", "pet_below_2s"):
        assert total[f"{event}_by"] == total[f"{event}_to"] > 0
    assert total["gaps_lost"] == total["gaps_taken"] > 0
    assert total["conflicts_by"] >= 1
    assert total["crashed"] >= sum(
        total[name] for name in ("rear_end_striking", "rear_end_struck", "side")
    )


def test_the_egos_crash_is_of_the_kind_that_ended_its_episode() -> None:
    settings = SceneSettings(density=2.0)
    agents = {"idm_mobil": IdmMobil(), "reckless": Reckless()}
    made = Simulation(settings, 60, "reckless", OneAgent("idm_mobil"), agents)
    made.reset(np.arange(900_000_000, 900_000_060, dtype=np.uint64))
    recording = Recording.of(made)
    ego = recording.drivers().filter(pl.col("is_ego")).join(recording.episodes(), on="episode")
    assert (ego["at_fault"] == ego["at_fault_right"].fill_null(False).cast(pl.Int32)).all()
    assert set(ego["at_fault_right"]) >= {False, True}
    rear_end = ego["rear_end_striking"] + ego["rear_end_struck"]
    assert (ego["side"] == (ego["ending"] == "side").cast(pl.Int32)).all()
    assert (rear_end == (ego["ending"] == "rear_end").cast(pl.Int32)).all()
    assert set(ego["ending"]) >= {"side", "rear_end"}


def test_the_new_follower_of_a_lane_change_is_watched_for_two_seconds() -> None:
    settings = SceneSettings(traffic_vehicles=14)
    agents = {"idm_mobil": IdmMobil(), "reckless": Reckless()}
    made = Simulation(settings, 40, "reckless", MIXED, agents)
    made.reset(np.arange(40, dtype=np.uint64))
    recording, frames = Recording(made), []
    while made.scene.active.any():
        made.step()
        recording.note()
        frames.append(_frame(made))
    checked = 0
    for b, seed in enumerate(made.seeds):
        steps, ego = recording.steps().filter(pl.col("episode") == seed), made.scene.ego[b]
        h = {name: np.stack([f[name][b] for f in frames[: made.steps[b]]]) for name in NAMES}
        for t, row in enumerate(steps.iter_rows(named=True)):
            follower = ahead(h, t, ego, row["lane"], settings.road, -1)
            expected = None
            if t > 0 and h["lane"][t, ego] != h["lane"][t - 1, ego] and follower >= 0:
                drives = ~h["crashed"][t : t + 6, [ego, follower]].any(axis=1)
                expected = min(h["acceleration"][t : t + 6, follower][drives], default=None)
            found = row["new_follower_acceleration"]
            assert found == (expected if expected is None else pytest.approx(expected, rel=1e-6))
            checked += expected is not None
    assert checked > 30


def test_the_vehicle_behind_strikes_and_the_one_ahead_is_struck() -> None:
    # Two overlap by 0.2 m along the road, two by 0.3 m across it, and one is alone.
    scene = scene_of(
        profile="charms",
        x=[100.0, 104.8, 300.0, 302.0, 500.0],
        y=[4.0, 4.5, 4.0, 5.7, 4.0],
        crashed=[True, True, True, True, False],
    )
    collision = np.zeros((1, 5), dtype=np.int8)
    assert not are_noted(scene.crashed.ravel(), collision.ravel())
    note_collisions(scene, collision, ANY_ANGLE)
    names = [COLLISIONS[each] for each in collision[0]]
    assert names == ["striking", "struck", "side", "side", "none"]
    assert are_noted(scene.crashed.ravel(), collision.ravel())
