"""What is recorded of an open road: each vehicle from its entry until it leaves."""

import numpy as np
import polars as pl
import pytest
from charms_baselines.idm_mobil import IdmMobil
from charms_baselines.varied_idm import VariedIdmMobil

from charms_bench.engine.simulation import Simulation
from charms_bench.plugins.traffic import Mixture
from charms_bench.recording.recording import Recording
from charms_bench.world.scene import SceneSettings

SCENES = 3


@pytest.fixture(scope="module")
def recorded() -> tuple[Simulation, Recording, dict[tuple[int, int], list[float]]]:
    """A simulation, its recording, and where each vehicle was at the decisions, by its number."""
    fields = {
        "profile": {"name": "naturalistic", "road_length_m": 600.0},
        "traffic_vehicles": 5,
        "density": 2.0,
        "duration_s": 30.0,
        "inflow": {"vehicles_per_hour_and_lane": 1500, "capacity": 40},
    }
    settings = SceneSettings.model_validate(fields)
    agents = {"varied": VariedIdmMobil(), "idm_mobil": IdmMobil()}
    traffic = Mixture({"varied": 0.5, "idm_mobil": 0.5})
    made = Simulation(settings, SCENES, "idm_mobil", traffic, agents)
    made.reset(np.arange(SCENES, dtype=np.uint64))
    recording = Recording(made)
    places: dict[tuple[int, int], list[float]] = {}
    running = np.ones(SCENES, dtype=np.bool_)
    while True:
        for b, i in zip(*np.nonzero(made.scene.present & running[:, None]), strict=True):
            places.setdefault((b, int(made.scene.entry[b, i])), []).append(made.scene.x[b, i])
        if not made.scene.active.any():
            return made, recording, places
        running = made.scene.active.copy()
        made.step()
        recording.note()


def test_every_vehicle_is_counted_and_leaving_is_no_crash(
    recorded: tuple[Simulation, Recording, dict[tuple[int, int], list[float]]],
) -> None:
    made, recording, places = recorded
    assert not made.scene.crashed.any()
    in_scene = np.bincount([b for b, _ in places], minlength=SCENES)
    assert (in_scene > 15).all()
    episodes = recording.episodes()
    assert (episodes["traffic_vehicles"].to_numpy() == in_scene - 1).all()
    assert episodes["traffic_crashed"].sum() == 0
    drivers = recording.drivers()
    assert drivers["vehicles"].sum() == len(places)
    assert drivers.select(pl.col("crashed", "at_fault").sum()).row(0) == (0, 0)


def test_distances_are_those_between_the_first_and_the_last_decision_of_each_vehicle(
    recorded: tuple[Simulation, Recording, dict[tuple[int, int], list[float]]],
) -> None:
    made, recording, places = recorded
    expected = sum(xs[-1] - xs[0] for xs in places.values())
    drivers = recording.drivers()
    assert drivers["distance_m"].sum() == pytest.approx(expected, abs=1e-6)
    intervals = sum(len(xs) - 1 for xs in places.values())
    assert drivers["time_s"].sum() == pytest.approx(intervals / made.settings.decision_hz)
    changes = drivers["lane_changes"].sum()
    assert 0 < changes < len(places)
