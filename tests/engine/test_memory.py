"""Agents with memory and noise, which the harness keeps; and planners, which look ahead."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from charms_bench import IDLE, DriverModel, Policy, load_state, save_state
from charms_bench.engine import MakeEngine
from charms_bench.engine.batched import BatchedEngine
from charms_bench.engine.rollouts import Futures
from charms_bench.engine.simulation import Simulation
from charms_bench.errors import AgentError, InputError
from charms_bench.plugins.agent import Agent
from charms_bench.plugins.registry import make_agent
from charms_bench.plugins.specs import TrafficSpec
from charms_bench.plugins.traffic import OneAgent
from charms_bench.world.actions import Actions
from charms_bench.world.scenario import Scenario
from charms_bench.world.scene import Floats, Ints, Observations, Scene, SceneSettings, Vehicles

SETTINGS = SceneSettings(duration_s=6.0, traffic_vehicles=8)
SEEDS = np.arange(900_000_000, 900_000_012, dtype=np.uint64)
GAIN = np.random.default_rng(0).normal(size=(35, 4))


class Recurrent(Policy):
    """A small recurrent network with arbitrary weights, which also draws a random number."""

    memory_width = 4
    noise_draws = 1

    def decide(
        self, observations: Observations, memory: Floats, noise: Floats
    ) -> tuple[Actions, Floats]:
        seen = np.einsum("mi,ij->mj", observations.reshape(-1, 35), GAIN)
        memory = np.tanh(0.5 * memory + seen)
        return np.where(noise[:, 0] < 0.2, IDLE, np.argmax(memory, axis=1)), memory


class Stacked(Policy):
    """Keeps the observations that it receives."""

    history_length = 3

    def __init__(self) -> None:
        self.received: list[Observations] = []

    def decide(self, observations: Observations) -> Actions:
        self.received.append(observations.copy())
        return np.full(len(observations), IDLE)


class Hesitant(DriverModel):
    """Brakes in every second step; it counts the steps of each vehicle."""

    memory_width = 1

    def drive(self, scene: Scene, vehicles: Vehicles) -> tuple[Floats, Ints]:
        steps = scene.memory[vehicles][:, 0]
        scene.memory[(*vehicles, 0)] = steps + 1
        return np.where(steps % 2 == 1, -1.0, 0.5), scene.lane[vehicles]


def simulation(
    ego: Agent, traffic: Agent | None = None, scenes: int = 12, engine: MakeEngine = BatchedEngine
) -> Simulation:
    agents = {"ego": ego, "traffic": traffic or make_agent("idm_mobil")}
    return Simulation(SETTINGS, scenes, "ego", OneAgent("traffic"), agents, engine)


def driven(made: Simulation, seeds: NDArray[np.uint64] = SEEDS, steps: int = 12) -> Simulation:
    made.reset(seeds)
    for _ in range(steps):
        made.step()
    return made


def test_memory_is_zero_at_the_start_and_then_what_the_policy_returned() -> None:
    made = simulation(Recurrent())
    made.reset(SEEDS)
    assert not made.scene.memory.any()
    made.step()
    egos = made.ego_vehicles
    assert made.scene.memory[egos].any(axis=1).all()
    assert not np.delete(made.scene.memory[0], made.scene.ego[0], axis=0).any()


def test_episodes_do_not_depend_on_those_beside_them() -> None:
    together = driven(simulation(Recurrent(), Recurrent()))
    order = np.random.default_rng(1).permutation(12)[:5]
    apart = driven(simulation(Recurrent(), Recurrent(), scenes=5), SEEDS[order])
    for name in ("x", "y", "memory", "target_lane"):
        assert np.array_equal(getattr(apart.scene, name), getattr(together.scene, name)[order])


def test_noise_is_that_of_numpys_philox_for_the_episode_the_decision_and_the_vehicle() -> None:
    class Noisy(Policy):
        noise_draws = 5
        drawn: list[Floats] = []  # noqa: RUF012

        def decide(self, observations: Observations, memory: Floats, noise: Floats) -> Actions:
            self.drawn.append(noise.copy())
            return np.full(len(observations), IDLE)

    made = driven(simulation(Noisy()), steps=3)
    for decision, drawn in enumerate(Noisy.drawn):
        for scene, seed in enumerate(SEEDS):
            counter = [0, decision, int(made.scene.ego[scene]), 0]
            bits = np.random.Philox(
                key=np.array([seed, 0], dtype=np.uint64), counter=np.array(counter, dtype=np.uint64)
            )
            assert drawn[scene].tolist() == np.random.Generator(bits).random(5).tolist()


def test_a_history_ends_with_the_latest_observation_and_begins_with_zeros() -> None:
    stacked = Stacked()
    driven(simulation(stacked), steps=4)
    first, second, third, fourth = stacked.received
    assert first.shape == (12, 3, 7, 5)
    assert not first[:, :2].any()
    assert np.array_equal(second[:, 1], first[:, 2])
    assert np.array_equal(third[:, :2], second[:, 1:])
    assert np.array_equal(fourth[:, :2], third[:, 1:])
    assert not np.array_equal(fourth[:, 2], fourth[:, 1])


def test_a_state_with_memory_continues_from_its_file(tmp_path: Path) -> None:
    whole = driven(simulation(Recurrent(), Hesitant()))
    half = driven(simulation(Recurrent(), Hesitant()), steps=5)
    save_state(half.state(), tmp_path / "state.json")
    other = simulation(Recurrent(), Hesitant())
    other.restore(load_state(tmp_path / "state.json"))
    for _ in range(7):
        other.step()
    assert other.state() == whole.state()


def test_a_new_driver_remembers_nothing() -> None:
    state = driven(simulation(Recurrent(), Recurrent()), steps=2).state()
    seated = state.seated(state.ego, "another")
    rows = np.arange(12)
    assert not seated.memory[rows, state.ego].any()
    assert np.array_equal(seated.memory[0, 1 - state.ego[0]], state.memory[0, 1 - state.ego[0]])


@pytest.mark.parametrize(
    ("answer", "message"),
    [
        (lambda n, m: np.ones(n, int), r"decide returned ndarray; expected \(actions, memory\)"),
        (lambda n, m: (np.ones(n, int), m[:, :2]), r"shape \(12, 2\); expected floats of shape"),
        (lambda n, m: (np.ones(n, int), m + np.nan), "decide returned memory that is not finite"),
    ],
)
def test_memory_that_does_not_fit_names_the_agent(answer: Any, message: str) -> None:
    class Wrong(Policy):
        memory_width = 3

        def decide(self, observations: Observations, memory: Floats, noise: Floats) -> Any:
            return answer(len(observations), memory)

    with pytest.raises(AgentError, match=rf"agent 'ego', episode \d+, step 0: .*{message}"):
        driven(simulation(Wrong()), steps=1)


class Planner(Policy):
    """Carries out IDLE; it only looks."""

    rollouts_with = "idm_mobil"

    def decide(self, observations: Observations, *given: Any) -> Actions:
        return np.full(len(observations), IDLE)


PLANS = np.random.default_rng(2).integers(0, 5, (6, 4))


def test_a_rollout_is_what_then_happens() -> None:
    """IDM+MOBIL really drives the others, and has the temperament that planners assume."""
    made = driven(simulation(Planner()), steps=2)
    made.scene.temperament[:] = 0.5
    state, egos = made.state(), made.ego_vehicles
    found = Futures(made, Planner()).of(egos)(PLANS)
    assert made.state() == state
    for k, plan in enumerate(PLANS):
        alone = Simulation(SETTINGS, 12, None, OneAgent("traffic"), made_agents())
        alone.restore(state.seated(state.ego, ""))
        for decision, action in enumerate(plan):
            alone.step(np.full(12, action))
            for name, values in (("x", alone.scene.x), ("y", alone.scene.y)):
                assert np.array_equal(getattr(found, name)[:, k, decision], values[egos])
            assert np.array_equal(found.failed[:, k, decision], alone.failed)


def made_agents() -> dict[str, Agent]:
    return {"traffic": make_agent("idm_mobil")}


def test_each_vehicle_can_have_plans_of_its_own() -> None:
    made = driven(simulation(Planner()), steps=2)
    rollouts = Futures(made, Planner()).of(made.ego_vehicles)
    one, other = rollouts(PLANS[:1]), rollouts(PLANS[1:2])
    own = np.broadcast_to(PLANS[:1], (12, 1, 4)).copy()
    own[::2] = PLANS[1]
    mixed = rollouts(own)
    assert np.array_equal(mixed.x[::2], other.x[::2])
    assert np.array_equal(mixed.x[1::2], one.x[1::2])
    with pytest.raises(InputError, match=r"plans of shape \(3, 6, 4\); expected \(plans, deci"):
        rollouts(np.zeros((3, 6, 4), dtype=int))


def test_a_planner_keeps_the_ego_on_the_road_without_a_crash() -> None:
    made = simulation(make_agent("mpc"))
    driven(made, steps=18)
    assert made.truncated.all()


def test_rollouts_leave_every_vehicle_its_size_whoever_plans() -> None:
    types = [
        {"name": "truck", "proportion": 0.5, "length_m": 16.0},
        {"name": "car", "proportion": 0.5},
    ]
    fields = {"vehicle_types": types, "ego_type": "truck", "traffic_vehicles": 8}
    agents = {"ego": make_agent("idm_mobil"), "planner": Planner()}
    settings = SceneSettings.model_validate(fields)
    made = Simulation(settings, 12, "ego", OneAgent("planner"), agents)
    made.reset(SEEDS)
    rows, places = np.arange(12), (made.scene.ego + 1) % 9
    futures = Futures(made, Planner())
    futures.of((rows, places))(PLANS[:1])
    foreseen = futures._simulation.scene
    np.testing.assert_array_equal(foreseen.ego[:12], places)
    np.testing.assert_array_equal(foreseen.length[:12], made.scene.length)


def test_in_rollouts_of_a_scenario_sizes_stay_and_no_motion_is_prescribed() -> None:
    scenario = Scenario.model_validate(
        {
            "ego": {"lane": 0, "speed_mps": 25.0},
            "vehicles": [
                {
                    "name": "lorry",
                    "lane": 0,
                    "ahead_of": "ego",
                    "gap_m": 30.0,
                    "speed_mps": 25.0,
                    "length_m": 12.0,
                    "actions": [{"at_s": 0.0, "acceleration_mps2": -6.0}],
                }
            ],
        }
    )
    settings = SETTINGS.of_scenario(scenario)
    traffic = TrafficSpec(scenario=scenario).make()
    made = Simulation(settings, 1, "ego", traffic, {"ego": Planner()})
    made.reset(np.array([0], dtype=np.uint64))
    futures = Futures(made, Planner())
    futures.of(made.ego_vehicles)(np.full((1, 4), IDLE))
    foreseen = futures._simulation.scene
    assert foreseen.length[0, 1] == made.scene.length[0, 1] == 12.0
    assert foreseen.speed[0, 1] > 22.0  # by IDM on a free lane, not by the scenario's braking


def test_a_planner_cannot_look_ahead_with_a_planner() -> None:
    class Endless(Policy):
        rollouts_with = "mpc"

        def decide(self, observations: Observations, *given: Any) -> Actions:
            return np.full(len(observations), IDLE)

    with pytest.raises(InputError, match="agent 'ego': its attribute `rollouts_with` is 'mpc', a"):
        simulation(Endless())


@pytest.mark.parametrize("agent", [Recurrent, Hesitant])
@pytest.mark.parametrize("width", [-1, "2", 10**9])
def test_a_width_of_memory_that_is_not_possible_names_the_attribute(agent: Any, width: Any) -> None:
    wrong = agent()
    wrong.memory_width = width
    with pytest.raises(InputError, match=f"agent 'ego': its attribute `memory_width` is '{width}'"):
        simulation(wrong)


def test_a_driver_model_that_leaves_nan_in_its_memory_is_named() -> None:
    class Undefined(Hesitant):
        def drive(self, scene: Scene, vehicles: Vehicles) -> tuple[Floats, Ints]:
            scene.memory[vehicles] = np.nan
            return super().drive(scene, vehicles)

    with pytest.raises(AgentError, match="agent 'ego', episode 900000000, step 0: drive left mem"):
        driven(simulation(Undefined()), steps=1)
