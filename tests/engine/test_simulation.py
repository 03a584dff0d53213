"""Episodes: how they end, who acts, and what is said of agents that misbehave."""

import gymnasium
import highway_env  # noqa: F401  # registers highway-v0
import numpy as np
import pytest

from charms_bench.engine import MakeEngine
from charms_bench.engine.batched import BatchedEngine
from charms_bench.engine.endings import OFF_ROAD, REAR_END, RUNNING, SIDE, TIME
from charms_bench.engine.simulation import Simulation
from charms_bench.errors import AgentError, InputError
from charms_bench.plugins.agent import Agent, DriverModel, Policy
from charms_bench.plugins.registry import make_agent
from charms_bench.plugins.traffic import Mixture, OneAgent
from charms_bench.testing.reference_engine import ENGINES, HighwayEnvEngine
from charms_bench.world.actions import ACTIONS, IDLE, Actions
from charms_bench.world.scene import Floats, Ints, Observations, Scene, SceneSettings, Vehicles


class Always(Policy):
    """Takes one action for ever."""

    def __init__(self, action: str = "IDLE", hz: float = 3.0) -> None:
        self.action, self.decision_hz, self.calls = ACTIONS.index(action), hz, 0

    def decide(self, observations: Observations) -> Actions:
        self.calls += 1
        return np.full(len(observations), self.action)


def simulate(
    ego: Agent, settings: SceneSettings, scenes: int = 8, engine: MakeEngine = BatchedEngine
) -> Simulation:
    agents = {"ego": ego, "idm_mobil": make_agent("idm_mobil")}
    simulation = Simulation(settings, scenes, "ego", OneAgent("idm_mobil"), agents, engine)
    simulation.reset(np.arange(scenes, dtype=np.uint64))
    while simulation.scene.active.any():
        simulation.step()
    return simulation


def two_vehicles(other_x: float, other_y: float, **ego: float) -> Simulation:
    """One scene of an idle ego on the middle lane at x = 100 and another vehicle."""
    settings = SceneSettings(traffic_vehicles=1, ego_slots=1)
    idle = {"ego": Always(), "other": Always()}
    simulation = Simulation(settings, 1, "ego", OneAgent("other"), idle)
    simulation.reset(np.zeros(1, dtype=np.uint64))
    scene = simulation.scene
    scene.x[:], scene.y[:], scene.heading[:] = (100.0, other_x), (4.0, other_y), 0.0
    scene.speed[:] = scene.target_speed[:] = 25.0
    for name, value in ego.items():
        getattr(scene, name)[0, 0] = value
    from charms_bench.engine.neighbours import locate

    locate(scene, np.array([0]))
    scene.target_lane[:] = scene.lane
    return simulation


def test_an_episode_of_20_s_at_3_hz_has_60_decisions() -> None:
    simulation = simulate(make_agent("idm_mobil"), SceneSettings())
    assert (simulation.ending == TIME).all()
    assert (simulation.steps == 60).all()


@pytest.mark.parametrize(
    ("decision_hz", "duration_s"), [(1, 10.0), (3, 20.0), (3, 1.0), (5, 20.0), (15, 12.0)]
)
def test_the_profile_highway_env_has_as_many_decisions_as_stock_highway_env(
    decision_hz: int, duration_s: float
) -> None:
    config = {"vehicles_count": 1, "policy_frequency": decision_hz, "duration": duration_s}
    stock = gymnasium.make("highway-v0", config=config)
    stock.reset(seed=0)
    decisions, truncated = 0, False
    while not truncated:
        _, _, terminated, truncated, _ = stock.step(IDLE)
        decisions += 1
        assert not terminated
    settings = SceneSettings.model_validate(
        {"profile": "highway-env", "decision_hz": decision_hz, "duration_s": duration_s}
    )
    assert settings.decisions == decisions


class Counting(DriverModel):
    """Accelerates by half the number of times that it has been asked about its vehicle."""

    def __init__(self) -> None:
        self.asked: list[int] = []

    def drive(self, scene: Scene, vehicles: Vehicles) -> tuple[Floats, Ints]:
        self.asked += vehicles[1].tolist()
        return np.full(vehicles[0].size, 0.5 * len(self.asked)), scene.target_lane[vehicles]


@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize(("rate", "per_decision"), [("decision", 1), ("simulation", 5)])
def test_an_ego_is_asked_as_often_as_the_profile_says(
    rate: str, per_decision: int, engine: MakeEngine
) -> None:
    settings = SceneSettings.model_validate(
        {
            "profile": {"name": "charms", "ego_control_rate": rate},
            "traffic_vehicles": 1,
            "ego_slots": 1,
        }
    )
    ego, other = Counting(), Counting()
    agents = {"ego": ego, "other": other}
    simulation = Simulation(settings, 1, "ego", OneAgent("other"), agents, engine)
    simulation.reset(np.zeros(1, dtype=np.uint64))
    timer_s = simulation.scene.timer_s[0].copy()
    simulation.step()
    simulation.step()
    assert (len(ego.asked), len(other.asked)) == (2 * per_decision, 10)
    np.testing.assert_allclose(simulation.scene.timer_s[0], timer_s + 10 / 15)
    zero_order_hold_mps = 30.0 + (5 * 0.5 + 5 * 1.0) / 15
    every_step_mps = 30.0 + 0.5 * sum(range(1, 11)) / 15
    expected = zero_order_hold_mps if rate == "decision" else every_step_mps
    assert simulation.scene.speed[0, 0] == pytest.approx(expected)


@pytest.mark.parametrize("engine", ENGINES)
def test_a_command_in_a_zero_order_hold_stays_as_highway_env_has_limited_it(
    engine: MakeEngine,
) -> None:
    """At 40 m/s, 33 - 40 = -7 m/s2 is commanded; the ego keeps that while it slows down."""
    settings = SceneSettings(traffic_vehicles=0, ego_slots=1)
    simulation = Simulation(settings, 1, "ego", OneAgent("ego"), {"ego": Counting()}, engine)
    simulation.reset(np.zeros(1, dtype=np.uint64))
    simulation.scene.speed[0, 0] = 40.0
    if engine is HighwayEnvEngine:
        simulation.engine.roads[0].vehicles[0].speed = 40.0
    simulation.step()
    assert simulation.scene.acceleration[0, 0] == -7.0
    assert simulation.scene.speed[0, 0] == pytest.approx(40.0 - 7 * 5 / 15)


@pytest.mark.parametrize("engine", ENGINES)
def test_an_ego_with_a_zero_order_hold_keeps_its_steering_angle_during_a_decision(
    engine: MakeEngine,
) -> None:
    settings = SceneSettings(traffic_vehicles=0, ego_slots=1)
    simulation = Simulation(settings, 1, None, OneAgent("none"), {"none": Always()}, engine)
    simulation.reset(np.zeros(1, dtype=np.uint64))
    angles = []
    for action in (ACTIONS.index("LANE_LEFT"), ACTIONS.index("LANE_RIGHT"), IDLE):
        for frame in range(5):
            simulation.advance(np.array([action]) if frame == 0 else None)
            angles.append(simulation.scene.steering[0, 0])
        simulation.finish_step()
    of_decisions = np.array(angles).reshape(3, 5)
    assert (of_decisions == of_decisions[:, :1]).all()
    assert np.unique(of_decisions).size == 3


def test_a_vehicle_that_runs_into_its_leader_ends_its_episode_as_a_rear_end() -> None:
    simulation = two_vehicles(108.0, 4.0, speed=33.0, target_speed=33.0)
    for _ in range(6):
        simulation.step()
    assert simulation.ending[0] == REAR_END


def test_a_vehicle_that_steers_into_its_neighbour_ends_its_episode_as_a_side_collision() -> None:
    simulation = two_vehicles(100.5, 8.0)
    simulation.scene.target_lane[0, 0] = 2
    for _ in range(12):
        simulation.step()
    assert simulation.ending[0] == SIDE


def test_leaving_the_road_ends_the_episode_where_the_profile_says_so() -> None:
    simulation = two_vehicles(300.0, 4.0, y=10.5)
    simulation.step()
    assert simulation.ending[0] == OFF_ROAD


def test_an_ended_scene_stays_as_it_was() -> None:
    simulation = two_vehicles(300.0, 4.0, y=10.5)
    simulation.step()
    before = simulation.scene.x.copy()
    simulation.step()
    assert (simulation.scene.x == before).all()
    assert simulation.steps[0] == 1


def test_a_scene_depends_on_its_seed_and_not_on_its_drivers_or_neighbours() -> None:
    settings = SceneSettings()
    agents = {name: make_agent(name) for name in ("idm_mobil", "stackelberg")}
    many = Simulation(settings, 5, "idm_mobil", OneAgent("idm_mobil"), agents)
    many.reset(np.arange(5, dtype=np.uint64))
    one = Simulation(settings, 1, "stackelberg", OneAgent("stackelberg"), agents)
    one.reset(np.array([3], dtype=np.uint64))
    for name in ("x", "y", "speed", "temperament"):
        assert (getattr(many.scene, name)[3] == getattr(one.scene, name)[0]).all(), name


def test_a_mixture_is_drawn_anew_for_every_episode_and_again_for_the_same_seed() -> None:
    mixture = Mixture({"slow": 0.5, "fast": 0.5})
    agents = {"ego": Always(), "slow": Always("SLOWER"), "fast": Always("FASTER")}
    simulation = Simulation(SceneSettings(), 2, "ego", mixture, agents)
    simulation.reset(np.array([7, 8], dtype=np.uint64))
    simulation.step()
    first = simulation.action.copy()
    assert (first[0] != first[1]).any()
    simulation.reset(np.array([7, 7], dtype=np.uint64))
    simulation.step()
    assert (simulation.action[0] == first[0]).all()
    assert (simulation.action[1] == first[0]).all()


def test_an_agent_decides_at_its_own_rate() -> None:
    quick, slow = Always(hz=15.0), Always(hz=1.0)
    simulation = Simulation(
        SceneSettings(duration_s=2), 1, "quick", OneAgent("slow"), {"quick": quick, "slow": slow}
    )
    simulation.reset(np.zeros(1, dtype=np.uint64))
    while simulation.ending[0] == RUNNING:
        simulation.step()
    assert (quick.calls, slow.calls) == (30, 2)


def test_a_rate_that_does_not_fit_the_simulation_is_rejected() -> None:
    said = r"'ego' decides 4\.0 times per second; simulation_hz 15 .*; `simulation_hz: 24` in the"
    with pytest.raises(InputError, match=said):
        simulate(Always(hz=4.0), SceneSettings())
    simulate(Always(hz=4.0), SceneSettings(simulation_hz=24))


def test_an_observation_that_does_not_exist_is_rejected() -> None:
    class Psychic(Always):
        observation = "tomorrow"

    with pytest.raises(InputError, match=r"no observation named 'tomorrow'\. Known: neigh"):
        simulate(Psychic(), SceneSettings())


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("outside_raising", r"raised ValueError: out of petrol \(.*outside_plugin\.py:\d+\)"),
        ("outside_misshapen", r"decide returned int64 of shape \(8, 2\); expected integers"),
        ("outside_out_of_range", "decide returned action 7; expected 0 to 4"),
        ("outside_not_finite", "drive returned nan; expected an acceleration within ±20 m/s²"),
    ],
)
def test_an_agent_that_misbehaves_is_named_with_episode_and_step(name: str, message: str) -> None:
    with pytest.raises(AgentError, match=rf"agent 'ego', episode 0, step 0: {message}"):
        simulate(make_agent(name), SceneSettings())


class Teleporting(DriverModel):
    """Puts its vehicles 10 m further ahead."""

    def drive(self, scene: Scene, vehicles: Vehicles) -> tuple[Floats, Ints]:
        scene.x[vehicles] += 10
        return np.zeros(vehicles[0].size), scene.target_lane[vehicles]


class Rocket(DriverModel):
    def drive(self, scene: Scene, vehicles: Vehicles) -> tuple[Floats, Ints]:
        return np.full(vehicles[0].size, 20.5), scene.target_lane[vehicles]


@pytest.mark.parametrize("engine", ENGINES)
def test_a_driver_model_cannot_write_to_the_scene(engine: MakeEngine) -> None:
    with pytest.raises(AgentError, match=r"agent 'ego', episode 0, step 0: raised .*read-only"):
        simulate(Teleporting(), SceneSettings(), engine=engine)


def test_an_impossible_acceleration_is_rejected() -> None:
    message = "drive returned 20.5; expected an acceleration within ±20 m/s²"
    with pytest.raises(AgentError, match=message):
        simulate(Rocket(), SceneSettings())


def test_an_ego_driven_from_outside_does_what_it_is_told() -> None:
    agents = {"idm_mobil": make_agent("idm_mobil")}
    simulation = Simulation(SceneSettings(), 2, None, OneAgent("idm_mobil"), agents)
    simulation.reset(np.arange(2, dtype=np.uint64))
    simulation.step(np.array([ACTIONS.index("SLOWER"), IDLE]))
    targets = simulation.scene.target_speed[simulation.ego_vehicles]
    assert targets.tolist() == [29.0, 30.0]  # REFERENCE: starts at 30, SLOWER is -1 m/s
