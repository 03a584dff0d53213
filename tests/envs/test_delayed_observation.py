"""The option `delay_decisions` of the observation `interaction`, in environments and suites."""

from typing import Any

import numpy as np
import pytest

from charms_bench.engine.simulation import Simulation
from charms_bench.envs.ego_env import ego_vector_env
from charms_bench.envs.learners_vector_env import LearnersVectorEnv
from charms_bench.plugins.agent import Policy
from charms_bench.plugins.registry import make_agent
from charms_bench.plugins.traffic import OneAgent
from charms_bench.roads.engine import RoadEngine
from charms_bench.roads.settings import on_road
from charms_bench.world.actions import ACTIONS
from charms_bench.world.interaction_observation import FIRST_NEIGHBOUR, Interaction
from charms_bench.world.named_road import NamedRoad
from charms_bench.world.scene import Observations, SceneSettings

DELAY, DECISIONS = 3, 8
ROADS = [None, "roundabout-v1"]


def made(road: str | None, delay: int, traffic: str | None = None) -> Any:
    scene = {"road": road} if road else {}
    observation = {"type": "interaction", "delay_decisions": delay}
    return ego_vector_env(5, observation=observation, scene=scene, traffic=traffic or "idm_mobil")


def late(plain: list[Observations], t: int) -> Observations:
    """What is to be seen at decision t of what was there."""
    shown = plain[t].copy()
    shown[:, FIRST_NEIGHBOUR:] = plain[max(t - DELAY, 0)][:, FIRST_NEIGHBOUR:]
    return shown


def followed(env: Any, first: Observations, decisions: range) -> list[Observations]:
    """The observations of an environment, whose egos do the same each time."""
    seen = [first]
    for t in decisions:
        actions = np.random.default_rng(t).choice([1, 4], 5)  # IDLE, SLOWER
        observations, _, *ends, _ = env.step(actions)
        assert not np.any(ends)
        seen.append(observations)
    return seen


@pytest.mark.parametrize("road", ROADS)
def test_others_are_seen_as_they_were_some_decisions_ago(road: str | None) -> None:
    env = made(road, 0)
    plain = followed(env, env.reset(seed=3)[0], range(DECISIONS))
    env = made(road, DELAY)
    delayed = followed(env, env.reset(seed=3)[0], range(DECISIONS))
    for t in range(DECISIONS):
        np.testing.assert_array_equal(delayed[t], late(plain, t))
    assert (delayed[-1] != plain[-1]).any()
    np.testing.assert_array_equal(env.reset(seed=3)[0], plain[0])


@pytest.mark.parametrize("road", ROADS)
def test_a_saved_state_has_what_was_seen_before(road: str | None) -> None:
    env = made(road, DELAY)
    seen = followed(env, env.reset(seed=3)[0], range(5))
    state = env.get_state()
    on = followed(env, seen[-1], range(5, DECISIONS))
    other = made(road, DELAY)
    other.reset(seed=4)
    other.set_state(state)
    for expected, found in zip(
        on[1:], followed(other, seen[-1], range(5, DECISIONS))[1:], strict=True
    ):
        np.testing.assert_array_equal(found, expected)


@pytest.mark.parametrize("road", ["straight", "merge-v1"])
def test_each_of_several_learners_sees_others_late(road: str) -> None:
    seen = []
    for delay in (0, DELAY):
        given: dict[str, Any] = {"lanes": 3, "traffic_vehicles": 10}
        if road != "straight":
            given = {"road": road}
        observation = {"type": "interaction", "delay_decisions": delay}
        env = LearnersVectorEnv(2, learners=(0, 1), observation=observation, **given)
        observations, rows = env.reset(seed=3)[0], []
        for _ in range(DELAY + 2):
            rows.append(observations)
            observations, _, *ends, _ = env.step(np.full(len(observations), 1))  # IDLE
            assert not np.any(ends)
        seen.append(rows)
    plain, delayed = seen
    for t, shown in enumerate(delayed):
        np.testing.assert_array_equal(shown, late(plain, t))


class Noting(Policy):
    """Brakes, and keeps what it has been shown."""

    decision_hz = 3

    def __init__(self, delay: int, history: int = 1) -> None:
        self.observation = Interaction(delay_decisions=delay)
        self.history_length = history
        self.shown: list[Observations] = []

    def decide(self, observations: Observations) -> np.ndarray:
        self.shown.append(observations.copy())
        return np.full(len(observations), ACTIONS.index("SLOWER"))


def noted(road: str | None, policy: Noting) -> list[Observations]:
    settings = SceneSettings.model_validate({"decision_hz": 3})
    agents = {"ego": policy, "idm_mobil": make_agent("idm_mobil")}
    given = 5, "ego", OneAgent("idm_mobil"), agents
    if road is None:
        simulation = Simulation(settings, *given)
    else:
        simulation = Simulation(on_road(settings, NamedRoad(name=road)), *given, RoadEngine)
    simulation.reset(np.array([0, 1, 2, 4, 5], dtype=np.uint64))
    for _ in range(DECISIONS):
        simulation.step()
        assert simulation.scene.active.all()
    return policy.shown


@pytest.mark.parametrize("road", ROADS)
def test_policies_of_suites_are_shown_the_same_and_keep_their_history(road: str | None) -> None:
    plain = noted(road, Noting(0))
    delayed, several = noted(road, Noting(DELAY)), noted(road, Noting(DELAY, history=2))
    for t in range(DECISIONS):
        np.testing.assert_array_equal(delayed[t], late(plain, t))
        np.testing.assert_array_equal(several[t][:, 1], late(plain, t))
        np.testing.assert_array_equal(several[t][:, 0], late(plain, max(t - 1, 0)))
