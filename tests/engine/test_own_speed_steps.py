"""A policy can have speed steps of its own, beside policies that have the profile's."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from trios import flowing_road, write_trio

from charms_bench import Policy, load_state, save_state
from charms_bench.engine import MakeEngine
from charms_bench.engine.batched import BatchedEngine
from charms_bench.engine.rollouts import Futures
from charms_bench.engine.simulation import Simulation
from charms_bench.errors import InputError
from charms_bench.humans.resimulation import drive_behind
from charms_bench.humans.trips import RATE_HZ, Trip
from charms_bench.plugins.agent import Agent
from charms_bench.plugins.consistency import checked
from charms_bench.plugins.registry import make_agent
from charms_bench.plugins.traffic import OneAgent
from charms_bench.testing.reference_engine import ENGINES
from charms_bench.world.actions import (
    FASTER,
    IDLE,
    LANE_LEFT,
    SLOWER,
    with_speed_steps,
)
from charms_bench.world.recorded_moments import scene_of
from charms_bench.world.scene import Floats, Observations, SceneSettings

GROWING = (0.25, 0.5, 1.0, 2.0)
ALONE = {"traffic_vehicles": 0, "ego_slots": 1}
PAIR = {"traffic_vehicles": 1, "ego_slots": 1, "density": 0.2}
IN_SPEEDS = {"name": "highway-env", "ego_speed_mps": 26.0}
"""A profile with the target speeds 20, 25 and 30 m/s."""


class Scripted(Policy):
    """Carries out commands one after the other, which it counts in its memory."""

    memory_width = 1

    def __init__(self, script: list[int], steps: Any = ()) -> None:
        self.script = np.array(script)
        if steps:
            self.actions = with_speed_steps(*steps)

    def decide(self, observations: Observations, memory: Floats, noise: Floats) -> Any:
        return self.script[memory[:, 0].astype(int) % self.script.size], memory + 1


def simulation(
    engine: MakeEngine, ego: Agent | None, other: Agent | None = None, **fields: Any
) -> Simulation:
    agents = {"ego": ego, "other": other or Scripted([IDLE])}
    settings = SceneSettings.model_validate((ALONE if other is None else PAIR) | fields)
    made = Simulation(settings, 1, ego and "ego", OneAgent("other"), agents, engine)  # type: ignore[arg-type]
    made.reset(np.zeros(1, dtype=np.uint64))
    return made


def targets(made: Simulation, decisions: int) -> Floats:
    """(D + 1, N) the target speeds of the only scene at the start and after each decision."""
    found = [made.scene.target_speed[0].copy()]
    for _ in range(decisions):
        made.step()
        found.append(made.scene.target_speed[0].copy())
    return np.array(found)


@pytest.mark.parametrize("engine", ENGINES)
def test_speeds_follow_the_policys_steps(engine: MakeEngine) -> None:
    script = [FASTER, FASTER, FASTER, SLOWER, IDLE, SLOWER]
    made = simulation(engine, Scripted(script, GROWING))
    # Targets 30.25, 30.75, 31.75, 31.5, 31.5 and 31.25 m/s, by hand. In a decision of 1/3 s, the
    # ego keeps (target - speed) / 0.8 s, so it covers 5/12 of the difference.
    expected = [30.1041667, 30.3732639, 30.9469039, 31.1773606, 31.3117937, 31.2860463]
    for speed in expected:
        made.step()
        assert made.scene.speed[0, 0] == pytest.approx(speed, abs=1e-6)


@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize(
    ("ego", "other", "changes"),
    [
        (GROWING, (), ([0.25, 0.5, 1.0, 0.0, 0.25], [1.0, 1.0, 1.0, 0.0, 1.0])),
        ((), GROWING, ([1.0, 1.0, 1.0, 0.0, 1.0], [0.25, 0.5, 1.0, 0.0, 0.25])),
        ((0.5,), [0.1, 0.2], ([0.5, 0.5, 0.5, 0.0, 0.5], [0.1, 0.2, 0.2, 0.0, 0.1])),
    ],
)
def test_each_policy_of_a_scene_has_its_own_steps(
    engine: MakeEngine, ego: Any, other: Any, changes: tuple[list[float], list[float]]
) -> None:
    script = [FASTER, FASTER, FASTER, LANE_LEFT, FASTER]
    drivers = Scripted(script, ego), Scripted(script, other)
    made = simulation(engine, *drivers, profile={"name": "charms", "ego_speed_mps": 25.0})
    np.testing.assert_allclose(np.diff(targets(made, 5), axis=0).T, changes, rtol=0, atol=1e-12)


@pytest.mark.parametrize("engine", ENGINES)
def test_a_policy_without_steps_keeps_those_of_the_profile(engine: MakeEngine) -> None:
    profile = {"name": "charms", "ego_speed_mps": 25.0, "target_speed_steps_mps": GROWING}
    drivers = Scripted([SLOWER], (1.0,)), Scripted([FASTER])
    made = simulation(engine, *drivers, profile=profile)
    changes = np.diff(targets(made, 3), axis=0).T
    np.testing.assert_array_equal(changes[0], [-1.0, -1.0, -1.0])
    np.testing.assert_allclose(changes[1], [0.25, 0.5, 1.0], rtol=0, atol=1e-12)


@pytest.mark.parametrize("engine", ENGINES)
def test_steps_take_precedence_over_target_speeds(engine: MakeEngine) -> None:
    stepwise = simulation(engine, Scripted([FASTER], (0.5, 1.5)), profile=IN_SPEEDS)
    np.testing.assert_array_equal(targets(stepwise, 4)[:, 0], [26.0, 26.5, 28.0, 29.5, 30.0])
    plain = simulation(engine, Scripted([FASTER]), profile=IN_SPEEDS)
    np.testing.assert_array_equal(targets(plain, 2)[:, 0], [25.0, 30.0, 30.0])


@pytest.mark.parametrize("engine", ENGINES)
def test_a_learner_driven_from_outside_keeps_the_profiles_steps(engine: MakeEngine) -> None:
    made = simulation(engine, None, Scripted([FASTER], GROWING))
    start = made.scene.target_speed[0].copy()
    made.step(np.array([SLOWER]))
    np.testing.assert_allclose(made.scene.target_speed[0] - start, [-1.0, 0.25], atol=1e-12)


@pytest.mark.parametrize("engine", ENGINES)
def test_a_state_that_is_saved_in_a_repeat_continues_it(engine: MakeEngine, tmp_path: Path) -> None:
    def driven() -> Simulation:
        slow = {"name": "charms", "ego_speed_mps": 25.0}
        return simulation(engine, Scripted([FASTER], GROWING), profile=slow)

    made, later = driven(), driven()
    targets(made, 2)
    save_state(made.state(), tmp_path / "state.json")
    later.restore(load_state(tmp_path / "state.json"))
    np.testing.assert_array_equal(targets(later, 2)[:, 0], [25.75, 26.75, 28.75])
    targets(made, 2)
    assert later.state() == made.state()


def test_a_new_driver_begins_with_its_own_first_step() -> None:
    drivers = Scripted([FASTER], GROWING), Scripted([FASTER], (0.1, 0.7))
    made = simulation(BatchedEngine, *drivers, profile={"name": "charms", "ego_speed_mps": 25.0})
    targets(made, 3)
    made.restore(made.state().seated(made.scene.ego, "other"))
    np.testing.assert_allclose(targets(made, 2)[:, 0], [26.75, 26.85, 27.55], atol=1e-12)


class Planner(Scripted):
    """Looks ahead with vehicles that have steps of their own."""

    rollouts_with = "stepwise"

    def decide(self, observations: Observations, memory: Floats, *given: Any) -> Any:
        return super().decide(observations, memory, given[0])


def test_a_rollout_continues_the_planners_own_steps(monkeypatch: pytest.MonkeyPatch) -> None:
    other = Scripted([SLOWER], (0.3, 0.9))
    monkeypatch.setattr("charms_bench.plugins.registry.make_agent", lambda name: other)
    planner = Planner([FASTER, FASTER, FASTER, SLOWER], GROWING)
    settings = SceneSettings.model_validate(
        PAIR | {"profile": {"name": "charms", "ego_speed_mps": 25.0}}
    )
    agents = {"ego": planner, "stepwise": other}
    made = Simulation(settings, 1, "ego", OneAgent("stepwise"), agents)
    made.reset(np.zeros(1, dtype=np.uint64))
    targets(made, 2)
    found = Futures(made, planner).of(made.ego_vehicles)(np.array([[FASTER, SLOWER]]))
    for decision in range(2):
        made.step()
        assert found.speed[0, 0, decision] == made.scene.speed[0, 0]


@pytest.mark.parametrize(
    "steps",
    [(0.0,), (1.0, -1.0), (float("nan"),), (float("inf"),), ("1",), (True,), (None,), (-1.0,),
     (1.0,) * 101, (10**400,), ((1.0,),)],
)  # fmt: skip
def test_steps_that_are_not_possible_are_named(steps: Any) -> None:
    with pytest.raises(InputError, match=r"speed steps \(.*; expected 1 to 100 positive"):
        with_speed_steps(*steps)


def test_steps_beside_the_actions_are_rejected() -> None:
    policy = Scripted([IDLE])
    policy.target_speed_steps_mps = GROWING  # type: ignore[attr-defined]
    what = r"agent 'ego': its attribute `target_speed_steps_mps` .* `actions = with_speed_steps"
    with pytest.raises(InputError, match=what):
        simulation(BatchedEngine, policy)


def test_a_policy_that_is_held_to_its_word_keeps_its_steps() -> None:
    policies = Scripted([IDLE], GROWING), Scripted([IDLE], GROWING)
    held = checked(*policies, SceneSettings(), np.random.default_rng(0))
    assert isinstance(held, Policy)
    assert held.actions == with_speed_steps(*GROWING)


def test_recorded_vehicles_start_at_their_speed_under_a_policy_with_steps(tmp_path: Path) -> None:
    write_trio(tmp_path, flowing_road(10), rate=10)
    fields = {"profile": "highway-env", "simulation_hz": 30, "duration_s": 2.0}
    settings = scene_of(fields | {"recording": str(tmp_path)})

    def started(steps: tuple[float, ...]) -> Simulation:
        agents: dict[str, Agent] = {"ego": Scripted([IDLE], steps), "other": make_agent("recorded")}
        made = Simulation(settings, 1, "ego", OneAgent("other"), agents)
        made.reset(np.zeros(1, dtype=np.uint64))
        return made

    stepwise, plain = started((1.0,)), started(())
    assert stepwise.scene.target_speed[0, 0] == stepwise.scene.speed[0, 0]
    assert plain.scene.target_speed[0, 0] in (20.0, 25.0, 30.0)
    assert stepwise.scene.speed[0, 0] not in (20.0, 25.0, 30.0)


def test_a_policy_in_the_place_of_recorded_drivers_has_its_own_steps() -> None:
    """Behind a leader out of reach, the ego speeds up by its first step, and keeps its speed."""
    count = 31 * RATE_HZ
    trip = Trip(
        0, np.full(count, 900.0), np.full(count, 25.0), np.full(count, 900.0), np.full(count, 25.0)
    )

    def last_speed(steps: tuple[float, ...]) -> float:
        agents = {"ego": Scripted([FASTER] + [IDLE] * 99, steps)}
        driven = drive_behind([trip], SceneSettings(), "ego", agents, np.zeros((0, 3)))
        return float(driven.speed[0, 0, -1])

    assert last_speed(()) == pytest.approx(26.0, abs=1e-6)
    assert last_speed((0.25, 4.0)) == pytest.approx(25.25, abs=1e-6)
