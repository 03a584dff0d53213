"""Vehicles of several types: sizes, desired speeds and drivers' parameters of their own."""

from typing import Any

import numpy as np
import pytest
from charms_baselines.idm_mobil import IdmMobil
from charms_baselines.stackelberg import Stackelberg
from charms_baselines.varied_idm import VariedIdmMobil
from pydantic import ValidationError
from scipy import stats

from charms_bench.engine import MakeEngine
from charms_bench.engine.batched import BatchedEngine
from charms_bench.engine.draws import draws_of
from charms_bench.engine.simulation import Simulation
from charms_bench.errors import InputError
from charms_bench.foundation.generator import seeded
from charms_bench.plugins.traffic import OneAgent
from charms_bench.testing.reference_engine import ENGINES
from charms_bench.world.scenario import Scenario
from charms_bench.world.scene import SceneSettings

CAR = {"name": "car", "proportion": 0.75, "desired_speed_mps": [26, 33]}
TRUCK = {
    "name": "truck",
    "proportion": 0.25,
    "length_m": 16.0,
    "width_m": 2.5,
    "desired_speed_mps": [22, 25],
    "driver_parameters": {"acceleration_mps2": [1.0, 1.5]},
}


def settings_of(*types: dict[str, Any], **fields: Any) -> SceneSettings:
    return SceneSettings.model_validate({"vehicle_types": types, **fields})


MIXED = settings_of(CAR, TRUCK, density=2.0, duration_s=6.0)


def started(
    settings: SceneSettings = MIXED,
    seeds: int = 2,
    engine: MakeEngine = BatchedEngine,
    ego: str = "idm_mobil",
    traffic: str = "varied",
) -> Simulation:
    agents = {
        "varied": VariedIdmMobil(),
        "idm_mobil": IdmMobil(),
        "stackelberg": Stackelberg(),
    }
    made = Simulation(settings, seeds, ego, OneAgent(traffic), agents, engine)
    made.reset(np.arange(seeds, dtype=np.uint64))
    return made


def is_traffic(made: Simulation) -> np.ndarray:
    return np.arange(made.settings.vehicles) != made.scene.ego[:, None]


def test_types_have_their_proportions_and_the_ego_is_the_profiles_vehicle() -> None:
    made = started(seeds=300)
    length, width = made.scene.length, made.scene.width
    traffic = is_traffic(made)
    assert (length[~traffic] == 5.0).all()
    trucks = length[traffic] == 16.0
    assert stats.binomtest(int(trucks.sum()), trucks.size, 0.25).pvalue > 1e-3
    np.testing.assert_array_equal(width[traffic], np.where(trucks, 2.5, 2.0))
    wanted = made.scene.target_speed[traffic]
    for is_type, low, high in ((trucks, 22, 25), (~trucks, 26, 33)):
        assert stats.kstest((wanted[is_type] - low) / (high - low), "uniform").pvalue > 1e-3


def test_the_ego_may_have_a_type() -> None:
    made = started(settings_of(CAR, TRUCK, ego_type="truck"), ego="varied")
    assert (made.scene.length[made.ego_vehicles] == 16.0).all()
    assert (made.scene.parameters[made.ego_vehicles][:, 0] <= 1.5).all()


def test_types_of_the_profiles_size_change_nothing() -> None:
    plain, typed = started(settings_of()), started(settings_of({"name": "car", "proportion": 1}))
    assert {*plain.state().arrays()} == {*typed.state().arrays()}
    for name, array in plain.state().arrays().items():
        np.testing.assert_array_equal(array, getattr(typed.state(), name), name)
    np.testing.assert_array_equal(plain.scene.parameters, typed.scene.parameters)


def test_vehicles_start_with_the_gaps_that_cars_have() -> None:
    plain = started(settings_of(density=2.0)).scene
    mixed = started(settings_of(CAR, {**TRUCK, "length_m": 25.0}, density=2.0)).scene
    np.testing.assert_array_equal(mixed.speed, plain.speed)
    between = (mixed.length[:, 1:] + mixed.length[:, :-1]) / 2
    gaps, gaps_of_cars = np.diff(mixed.x) - between, np.diff(plain.x) - 5.0
    assert (np.diff(plain.x) < 25).any()
    np.testing.assert_allclose(gaps, gaps_of_cars, rtol=0, atol=1e-9)


def test_the_road_is_long_enough_for_long_vehicles() -> None:
    lorry = {"name": "lorry", "proportion": 1, "length_m": 30.0}
    made = started(settings_of(lorry, traffic_vehicles=300, density=3.0, lanes=2), seeds=1)
    fastest = made.settings.profile.speed_max_mps * made.settings.duration_s
    assert made.scene.x.max() + fastest < made.settings.road_length_m


def test_parameters_of_a_type_are_uniform_in_its_range() -> None:
    made = started(seeds=300)
    trucks, traffic = made.scene.length == 16.0, is_traffic(made)
    of_trucks = made.scene.parameters[trucks][:, 0]
    assert stats.kstest((of_trucks - 1.0) / 0.5, "uniform").pvalue > 1e-3
    of_cars = made.scene.parameters[traffic & ~trucks][:, 0]
    assert stats.kstest((of_cars - 1.0) / 3.0, "uniform").pvalue > 1e-3


def test_draws_place_vehicles_with_the_types_of_their_seeds() -> None:
    made, drawn = started(), started()
    seeds = np.arange(2, dtype=np.uint64)
    drawn.reset(seeds, draws=draws_of(seeded(seeds), MIXED))
    for name in ("x", "length", "target_speed", "parameters"):
        np.testing.assert_array_equal(getattr(drawn.scene, name), getattr(made.scene, name))


@pytest.mark.parametrize(
    ("types", "fields", "what"),
    [
        ([{**CAR, "proportion": 0.5}, TRUCK], {}, "the proportions sum to 0.75; expected 1"),
        ([CAR, {**TRUCK, "name": "car"}], {}, "two types have the same name"),
        ([CAR, TRUCK], {"ego_type": "lorry"}, "no vehicle type called 'lorry'"),
        ([CAR, {**TRUCK, "desired_speed_mps": [15, 25]}], {}, "expected 22 to 33"),
        ([CAR, {**TRUCK, "desired_speed_mps": [25, 22]}], {}, "25 exceeds 22"),
        ([CAR, {**TRUCK, "length_m": 100.0}], {}, "less than or equal to 30"),
    ],
)
def test_impossible_types_are_rejected(types: Any, fields: dict[str, Any], what: str) -> None:
    with pytest.raises(ValidationError, match=what):
        settings_of(*types, **fields)


@pytest.mark.parametrize(
    ("name", "values", "what"),
    [
        ("acceleration", [1, 2], r"vehicle_types\.1\..*no driver of idm_mobil, varied has a para"),
        ("acceleration_mps2", [0.5, 2], "0.5 to 2 is outside the range of .*expected 1 to 4"),
    ],
)
def test_unknown_parameters_and_wider_ranges_are_rejected(
    name: str, values: list[float], what: str
) -> None:
    with pytest.raises(InputError, match=what):
        started(settings_of(CAR, {**TRUCK, "driver_parameters": {name: values}}))


def test_a_scenario_may_give_sizes() -> None:
    truck = {"name": "truck", "lane": 1, "ahead_of": "ego", "gap_m": 20, "speed_mps": 25}
    scenario = Scenario.model_validate(
        {
            "parameters": {"length": [10, 20]},
            "points": [{"length": 10}, {"length": 20}],
            "ego": {"lane": 1, "speed_mps": 30, "x_m": 100, "width_m": 1.8},
            "vehicles": [{**truck, "length_m": "length", "width_m": 2.5, "agent": "idm_mobil"}],
        }
    )
    for engine in ENGINES:
        made = started(settings_of(CAR, TRUCK).of_scenario(scenario), 2, engine)
        assert made.scene.length.tolist() == [[5.0, 10.0], [5.0, 20.0]]
        assert made.scene.width.tolist() == [[1.8, 2.5], [1.8, 2.5]]
        assert made.scene.x[:, 1].tolist() == [127.5, 132.5]
        made.restore(made.state().take([1, 0]))
        assert made.scene.length[:, 1].tolist() == [20.0, 10.0]


TALL = {
    "name": "tall",
    "proportion": 1.0,
    "length_m": {"normal": [12.0, 2.0], "range": [8.0, 16.0]},
    "width_m": {"normal": [2.4, 0.1], "range": [2.2, 2.6]},
    "desired_speed_mps": [20, 30],
    "driver_parameters": {
        "time_headway_s": {"lognormal": [1.2, 0.3], "range": [0.6, 2.0]},
        "politeness": [0.0, 0.5],
    },
    "correlations": [
        ["length_m", "width_m", 0.6],
        ["desired_speed_mps", "length_m", -0.4],
        ["desired_speed_mps", "time_headway_s", -0.3],
        ["time_headway_s", "politeness", 0.4],
    ],
}


def test_quantities_of_a_type_have_their_distributions_and_correlations() -> None:
    made = started(settings_of(TALL, profile="naturalistic"), seeds=300)
    traffic = is_traffic(made)
    parameters = made.scene.parameters[traffic]
    found = {
        "length_m": made.scene.length[traffic],
        "width_m": made.scene.width[traffic],
        "desired_speed_mps": made.scene.target_speed[traffic],
        "time_headway_s": parameters[:, 3],
        "politeness": parameters[:, 4],
        "imposed_braking_mps2": parameters[:, 6],
    }
    expected = {
        "length_m": stats.truncnorm(-2, 2, loc=12, scale=2),
        "width_m": stats.truncnorm(-2, 2, loc=2.4, scale=0.1),
        "desired_speed_mps": stats.uniform(20, 10),
        "politeness": stats.uniform(0, 0.5),
        "imposed_braking_mps2": stats.uniform(1, 3),
    }
    for name, distribution in expected.items():
        assert stats.kstest(found[name], distribution.cdf).pvalue > 1e-3, name
    bounds = np.log(np.array([0.6, 2.0]) / 1.2) / 0.3
    headway = np.log(found["time_headway_s"] / 1.2) / 0.3
    assert stats.kstest(headway, stats.truncnorm(*bounds).cdf).pvalue > 1e-3
    given = {frozenset(pair[:2]): pair[2] for pair in TALL["correlations"]}  # type: ignore[attr-defined]
    for one in found:
        for other in found:
            # Of a Gaussian copula, Spearman's correlation follows from that of the normal scores.
            expected_rho = 6 / np.pi * np.arcsin(given.get(frozenset({one, other}), 0.0) / 2)
            rho = stats.spearmanr(found[one], found[other]).statistic
            assert one == other or abs(rho - expected_rho) < 0.05, (one, other)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"length_m": {"range": [8, 16]}}, "expected either normal or lognormal"),
        ({"length_m": {"normal": [12, 2], "range": [8, 40]}}, "length_m: 8 to 40; expected 1 to"),
        ({"length_m": {"normal": [20, 2], "range": [8, 16]}}, "range: the center 20 is outside"),
        ({"width_m": {"lognormal": [2, 1], "range": [0, 3]}}, "lognormal distribution is above 0"),
        ({"desired_speed_mps": {"normal": [9, 9], "range": [0, 20]}}, "expected speeds above 0"),
        ({"correlations": [["length_m", "age", 0.5]]}, "the type draws no 'age'"),
        ({"correlations": [["length_m", "length_m", 1]]}, "'length_m' twice"),
        ({"correlations": [["length_m", "width_m", 1.5]]}, "less than or equal to 1"),
        (
            {
                "correlations": [
                    ["length_m", "width_m", 0.9],
                    ["length_m", "politeness", 0.9],
                    ["width_m", "politeness", -0.9],
                ]
            },
            "no distribution has these",
        ),
    ],
)
def test_a_distribution_that_does_not_exist_is_rejected(
    changes: dict[str, Any], message: str
) -> None:
    with pytest.raises(ValidationError, match=message):
        settings_of({**TALL, **changes})
