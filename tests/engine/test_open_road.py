"""Open boundaries: vehicles enter a straight road at its start and leave it at its end."""

from typing import Any

import numpy as np
import pytest
from charms_baselines.idm_mobil import IdmMobil
from charms_baselines.varied_idm import VariedIdmMobil
from pydantic import ValidationError
from scipy import stats

from charms_bench.engine import MakeEngine
from charms_bench.engine.batched import BatchedEngine
from charms_bench.engine.simulation import Simulation
from charms_bench.errors import InputError
from charms_bench.plugins.traffic import Mixture, Traffic
from charms_bench.world.scene import Scene, SceneSettings

TYPES = [
    {
        "name": "car",
        "proportion": 0.7,
        "length_m": {"normal": [4.7, 0.4], "range": [3.5, 5.8]},
        "desired_speed_mps": {"normal": [30.0, 3.0], "range": [24, 36]},
        "driver_parameters": {"time_headway_s": {"lognormal": [1.2, 0.3], "range": [0.7, 2.0]}},
        "correlations": [["desired_speed_mps", "time_headway_s", -0.4]],
    },
    {"name": "truck", "proportion": 0.3, "length_m": 16.0, "desired_speed_mps": [22, 25]},
]
SHORT: dict[str, Any] = {
    "profile": {"name": "naturalistic", "road_length_m": 700.0, "offroad_terminal": False},
    "traffic_vehicles": 6,
    "density": 2.0,
    "duration_s": 24.0,
    "vehicle_types": TYPES,
    "inflow": {"vehicles_per_hour_and_lane": 1800, "capacity": 40},
}
VARIED = Mixture({"varied": 0.6, "idm_mobil": 0.4})


def started(
    engine: MakeEngine = BatchedEngine,
    seeds: int = 4,
    traffic: Traffic = VARIED,
    **changes: Any,
) -> Simulation:
    settings = SceneSettings.model_validate({**SHORT, **changes})
    agents = {"varied": VariedIdmMobil(), "idm_mobil": IdmMobil()}
    made = Simulation(settings, seeds, "idm_mobil", traffic, agents, engine)
    made.reset(np.arange(seeds, dtype=np.uint64))
    return made


def without_ego(made: Simulation) -> Simulation:
    """The same scenes on an empty road, so that only time ends an episode."""
    state = made.state()
    made.restore(state.with_arrays({"present": state.present & False}))
    return made


def moments(made: Simulation) -> Any:
    """Simulates until all episodes have ended; yields after each simulation step."""
    while made.scene.active.any():
        made.advance()
        yield made.scene
        if made.phase == made.settings.steps_per_decision:
            made.finish_step()


def numbers(scene: Scene) -> list[set[int]]:
    """The numbers of the vehicles that are present in each scene."""
    return [
        set(entry[present].tolist())
        for entry, present in zip(scene.entry, scene.present, strict=True)
    ]


def test_vehicles_enter_at_the_start_and_leave_at_the_end() -> None:
    made = started()
    before, entered, left = numbers(made.scene), 0, 0
    for scene in moments(made):
        now = numbers(scene)
        for b in range(4):
            new = now[b] - before[b]
            gone = before[b] - now[b]
            is_new = np.isin(scene.entry[b], list(new)) & scene.present[b]
            assert (scene.x[b][is_new] == 0.0).all()
            entered, left = entered + len(new), left + len(gone)
        before = now
        is_traffic = scene.present.copy()
        is_traffic[made.ego_vehicles] = False
        assert (scene.x[is_traffic] < 700.0).all()
    assert entered > 60
    assert left > 4


def test_an_episode_ends_when_the_ego_is_at_the_end() -> None:
    made = started()
    for _ in moments(made):
        pass
    assert made.truncated.all()
    x = made.scene.x[made.ego_vehicles]
    at_end = made.steps < made.settings.decisions
    assert at_end.any()
    assert (x[at_end] >= 700.0).all()
    assert (x[~at_end] < 700.0).all()
    assert not made.is_off_road.any()


def test_nobody_enters_into_another_vehicle_or_too_near_to_stop() -> None:
    fields = {"inflow": {"vehicles_per_hour_and_lane": 3000, "capacity": 100}, "duration_s": 24.0}
    made = without_ego(started(**fields))
    seen, entered = numbers(made.scene), 0
    for scene in moments(made):
        now = numbers(scene)
        for b in range(4):
            for number in now[b] - seen[b]:
                place = int(np.nonzero((scene.entry[b] == number) & scene.present[b])[0][0])
                at = (np.array([b]), np.array([place]))
                leader, exists = scene.leader(at, scene.lane[at])
                gap = scene.gap_to(at, leader)[0] if exists[0] else np.inf
                assert gap >= 2.0 + 1.2 * scene.speed[b, place] - 1e-9
                assert not exists[0] or scene.speed[b, place] <= scene.speed[b, leader[0]] + 1e-9
                entered += 1
        seen = now
        assert not scene.crashed[scene.x < 50.0].any()
    assert entered > 100


def test_arrivals_are_a_poisson_process_of_the_flow() -> None:
    fields = {"inflow": {"vehicles_per_hour_and_lane": 200, "capacity": 60}, "duration_s": 200.0}
    made = without_ego(started(seeds=6, **fields))
    times, last = [], numbers(made.scene)
    for k, scene in enumerate(moments(made)):
        now = numbers(scene)
        times += [[b, k / 15] for b in range(6) for _ in now[b] - last[b]]
        last = now
    counts = np.bincount(np.array(times)[:, 0].astype(int))
    assert stats.poisson(6 * 200 * 200 * 3 / 3600).cdf([counts.sum()])[0] == pytest.approx(
        0.5, abs=0.499
    )
    between = np.concatenate([np.diff([t for b, t in times if b == k]) for k in range(6)])
    assert stats.kstest(between, stats.expon(scale=6.0).cdf).pvalue > 1e-3


def test_vehicles_that_enter_have_the_types_of_the_scene() -> None:
    made = without_ego(started(seeds=8))
    lengths: dict[tuple[int, int], float] = {}
    wanted: dict[tuple[int, int], float] = {}
    for scene in moments(made):
        for b, place in zip(*np.nonzero(scene.present), strict=True):
            key = (int(b), int(scene.entry[b, place]))
            lengths[key] = float(scene.length[b, place])
            wanted[key] = float(scene.target_speed[b, place])
    is_truck = np.array([*lengths.values()]) == 16.0
    assert stats.binomtest(int(is_truck.sum()), is_truck.size, 0.3).pvalue > 1e-3
    assert is_truck.size > 200
    of_cars = np.array([*wanted.values()])[~is_truck]
    assert stats.kstest(of_cars, stats.truncnorm(-2, 2, loc=30, scale=3).cdf).pvalue > 1e-3


def test_a_full_road_is_an_error_that_says_so() -> None:
    made = started(inflow={"vehicles_per_hour_and_lane": 1800, "capacity": 3})
    message = r"scene\.inflow\.capacity: episode \d is full at step \d+, with 10 vehicles; use a"
    with pytest.raises(InputError, match=message):
        for _ in moments(made):
            pass


def test_vehicles_at_the_start_must_fit_on_the_road() -> None:
    with pytest.raises(ValidationError, match="700 m are too short for the 41 vehicles"):
        SceneSettings.model_validate({**SHORT, "traffic_vehicles": 40})
