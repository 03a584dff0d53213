"""The parameters of drivers: drawn from the seed, kept by states, given by scenarios."""

from typing import Any

import numpy as np
import pytest
from charms_baselines.idm_mobil import IdmMobil
from charms_baselines.varied_idm import VariedIdmMobil
from scipy import stats

from charms_bench.engine import MakeEngine
from charms_bench.engine.batched import BatchedEngine
from charms_bench.engine.simulation import Simulation
from charms_bench.errors import InputError, ScenarioError
from charms_bench.plugins.agent import DriverModel
from charms_bench.plugins.specs import TrafficSpec
from charms_bench.plugins.traffic import Mixture, OneAgent, Traffic
from charms_bench.testing.reference_engine import ENGINES, HighwayEnvEngine
from charms_bench.world.scenario import Scenario
from charms_bench.world.scene import Floats, Ints, Scene, SceneSettings, Vehicles

NAMES = tuple(VariedIdmMobil.parameters)
LOW, HIGH = np.array([*VariedIdmMobil.parameters.values()]).T
SMALL = SceneSettings(duration_s=4.0, traffic_vehicles=7, density=2.0)


def started(
    engine: MakeEngine = BatchedEngine,
    seeds: tuple[int, ...] = (3, 4),
    ego: str = "varied",
    traffic: Traffic | None = None,
    settings: SceneSettings = SMALL,
) -> Simulation:
    agents = {"varied": VariedIdmMobil(), "idm_mobil": IdmMobil()}
    traffic = traffic or OneAgent("varied")
    made = Simulation(settings, len(seeds), ego, traffic, agents, engine)
    made.reset(np.array(seeds, dtype=np.uint64))
    return made


def scenario_of(points: list[dict[str, float]], **changes: Any) -> SceneSettings:
    """A vehicle 40 m behind another one of 20 m/s, at the same speed."""
    follower = {"name": "follower", "lane": 0, "behind": "leader", "gap_m": 40, "speed_mps": 20}
    vehicles = [
        {"name": "leader", "lane": 0, "x_m": 200, "speed_mps": 20},
        {**follower, "agent": "varied", **changes},
    ]
    fields = {"parameters": {"headway": [0, 9]}, "points": points, "vehicles": vehicles}
    made = Scenario.model_validate({**fields, "ego": {"lane": 2, "speed_mps": 30, "x_m": 100}})
    profile = {"name": "highway-env", "vehicle_length_m": 4.0}
    return SceneSettings(profile=profile, duration_s=3.0).of_scenario(made)


def placed(settings: SceneSettings, engine: MakeEngine = BatchedEngine) -> Simulation:
    assert settings.scenario is not None
    traffic = TrafficSpec(scenario=settings.scenario).make()
    return started(engine, (0, 1), "idm_mobil", traffic, settings)


def test_parameters_are_uniform_in_their_ranges_and_independent() -> None:
    scene = started(seeds=tuple(range(300))).scene
    uniforms = ((scene.parameters - LOW) / (HIGH - LOW)).reshape(-1, len(NAMES))
    for each in uniforms.T:
        assert stats.kstest(each, "uniform").pvalue > 1e-3
    everything = np.c_[uniforms, scene.temperament.ravel()]
    correlations = np.corrcoef(everything.T)[np.triu_indices(len(NAMES) + 1, 1)]
    assert np.abs(correlations).max() < 0.08  # 4 standard errors of 2,400 drivers are 0.082


def test_parameters_follow_from_the_seed_alone() -> None:
    one, other = started(seeds=(3, 4, 5)), started(HighwayEnvEngine, seeds=(5, 3))
    np.testing.assert_array_equal(one.scene.parameters[[2, 0]], other.scene.parameters)
    assert np.ptp(one.scene.parameters[:, :, 3]) > 1.0
    assert not np.array_equal(one.scene.parameters[0], one.scene.parameters[1])


def test_other_drivers_do_not_change_the_draws() -> None:
    traffic = Mixture({"idm_mobil": 0.5, "varied": 0.5})
    mixed = started(ego="idm_mobil", traffic=traffic)
    is_varied = mixed.drivers == "varied"
    assert 0 < is_varied.sum() < is_varied.size
    np.testing.assert_array_equal(
        mixed.scene.parameters[is_varied], started().scene.parameters[is_varied]
    )
    assert not mixed.scene.parameters[~is_varied].any()


def test_a_driver_that_takes_over_has_parameters() -> None:
    running = started(ego="idm_mobil", traffic=OneAgent("idm_mobil"))
    branch = started(ego="idm_mobil")
    branch.restore(running.state().seated(running.scene.ego, "varied"))
    egos = branch.scene.parameters[branch.ego_vehicles]
    assert ((egos >= LOW) & (egos <= HIGH)).all()
    assert np.ptp(egos[:, 3]) > 0


@pytest.mark.parametrize("engine", ENGINES)
def test_in_a_scenario_parameters_are_the_middles_of_their_ranges_or_as_given(
    engine: MakeEngine,
) -> None:
    given = {"time_headway_s": "headway / 2", "jam_distance_m": 8}
    points = [{"headway": 2.0}, {"headway": 4.0}]
    scene = placed(scenario_of(points, driver_parameters=given), engine).scene
    expected = np.tile((LOW + HIGH) / 2, (2, 1))
    expected[:, NAMES.index("jam_distance_m")] = 8.0
    expected[:, NAMES.index("time_headway_s")] = [1.0, 2.0]
    np.testing.assert_allclose(scene.parameters[:, 2], expected)


@pytest.mark.parametrize("engine", ENGINES)
def test_a_driver_in_a_scenario_brakes_by_its_parameters(engine: MakeEngine) -> None:
    """At 20 m/s, 44 m behind: IDM with a = 2.5 (1 - 1 - (s* / 44)^2), s* = s0 + 20 T."""
    given = {"time_headway_s": "headway", "jam_distance_m": 8, "acceleration_mps2": 2.5}
    points = [{"headway": 1.0}, {"headway": 1.8}]
    running = placed(scenario_of(points, driver_parameters=given), engine)
    running.advance()
    expected = [-2.5 * (28 / 44) ** 2, -2.5 * (44 / 44) ** 2]
    assert running.scene.acceleration[:, 2] == pytest.approx(expected)


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"headway_s": 1}, "'varied' has no parameter 'headway_s'. Did you mean 'time_headway_s'"),
        ({"time_headway_s": "headway"}, "3 is out of range; expected 0.6 to 2 at .* headway 3"),
    ],
)
def test_a_scenario_cannot_give_other_parameters(given: dict[str, Any], message: str) -> None:
    with pytest.raises(ScenarioError, match=message) as found:
        placed(scenario_of([{"headway": 1.0}, {"headway": 3.0}], driver_parameters=given))
    assert found.value.location == ("vehicles", 1, "driver_parameters", next(iter(given)))


@pytest.mark.parametrize("ranges", [{"a": (2, 1)}, {"a": (0, np.inf)}, {"a": 1}, ["a"]])
def test_ranges_that_are_wrong_are_rejected(ranges: Any) -> None:
    class Wrong(DriverModel):
        parameters = ranges

        def drive(self, scene: Scene, vehicles: Vehicles) -> tuple[Floats, Ints]:
            raise AssertionError

    with pytest.raises(InputError, match="agent 'wrong': its attribute `parameters` is"):
        Simulation(SMALL, 1, "wrong", OneAgent("wrong"), {"wrong": Wrong()})
