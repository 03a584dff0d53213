"""Samples of simulated drivers: what a driver that is told its commands has commanded."""

from typing import Any

import numpy as np
import pytest
from charms_agents.human.samples import Samples
from charms_agents.human.simulated import simulated_samples

from charms_bench.engine.simulation import Simulation
from charms_bench.plugins.agent import Agent, Policy
from charms_bench.plugins.registry import make_agent
from charms_bench.plugins.traffic import OneAgent
from charms_bench.world.actions import (
    FASTER,
    IDLE,
    LANE_LEFT,
    LANE_RIGHT,
    SLOWER,
    Actions,
    with_speed_steps,
)
from charms_bench.world.observations import COMMANDS, EGO, Neighbours
from charms_bench.world.profile import PROFILES
from charms_bench.world.scene import Floats, Observations, SceneSettings

SEEN = Neighbours(commands=True)
STEPS = (0.25, 0.5, 1.0, 2.0)
SETTLING = 6
"""Decisions in the 2 s that are left out."""
SCRIPT = [
    *[SLOWER, SLOWER, SLOWER, IDLE, FASTER, IDLE],  # settles
    *[FASTER, FASTER, IDLE, SLOWER, SLOWER, SLOWER, SLOWER, FASTER],
    *[IDLE, FASTER, SLOWER, FASTER, IDLE, IDLE],
]


class Scripted(Policy):
    """Carries out one command after the other, which it counts in its memory."""

    memory_width = 1

    def __init__(self, script: list[int]) -> None:
        self.script = np.array(script)

    def decide(
        self, observations: Observations, memory: Floats, noise: Floats
    ) -> tuple[Actions, Floats]:
        return self.script[memory[:, 0].astype(int) % self.script.size], memory + 1


def alone(decisions: int) -> SceneSettings:
    profile = PROFILES["charms"].model_copy(update={"target_speed_steps_mps": STEPS})
    return SceneSettings(profile=profile, traffic_vehicles=0, ego_slots=1, duration_s=decisions / 3)


def samples_of(driver: Agent, scene: SceneSettings, **options: Any) -> Samples:
    given = {"episodes": 2, "first_seed": 0, "observation": SEEN} | options
    traffic, others = OneAgent("idm_mobil"), {"idm_mobil": make_agent("idm_mobil")}
    return simulated_samples([driver], [(scene, traffic)], others, **given)


def test_labels_are_the_commands_that_have_been_given() -> None:
    found = samples_of(Scripted(SCRIPT), alone(len(SCRIPT)))
    labels = found.labels.argmax(axis=1).reshape(-1, 2)
    np.testing.assert_array_equal(labels[:, 0], SCRIPT[SETTLING:])
    np.testing.assert_array_equal(labels[:, 1], SCRIPT[SETTLING:])
    assert (found.labels.max(axis=1) == 1.0).all()


def test_observed_commands_are_those_of_the_engine() -> None:
    scene = alone(len(SCRIPT))
    found = samples_of(Scripted(SCRIPT), scene).observations.reshape(-1, 2, 8, 5)
    made = Simulation(scene, 1, "ego", OneAgent("ego"), {"ego": Scripted(SCRIPT)})
    made.reset(np.zeros(1, dtype=np.uint64))
    for k in range(len(SCRIPT)):
        if k >= SETTLING:
            expected = SEEN(made.scene, made.ego_vehicles)[0]
            np.testing.assert_allclose(found[k - SETTLING, 0], expected, atol=1e-6)
        made.step()


@pytest.mark.parametrize(("command", "change"), [(LANE_LEFT, -1), (LANE_RIGHT, 1)])
def test_a_lane_change_is_a_lane_command_from_its_beginning_to_the_other_lane(
    command: int, change: int
) -> None:
    begins = 8
    script = [IDLE] * begins + [command] + [IDLE] * 11
    scene = alone(len(script)).model_copy(update={"lanes": 5})
    for seed in range(20):  # until the driver starts on a lane that has one beside it
        found = samples_of(Scripted(script), scene, first_seed=seed)
        labels = found.labels.argmax(axis=1).reshape(-1, 2)[:, 0]
        if command in labels:
            break
    steers_to = np.round(found.observations[:, COMMANDS, 2].reshape(-1, 2)[:, 0])
    moves = np.flatnonzero(labels == command)
    assert moves[0] == begins - SETTLING
    np.testing.assert_array_equal(moves, np.arange(moves[0], moves[-1] + 1))
    # Before its first decision, the driver does not yet steer to the other lane.
    np.testing.assert_array_equal(np.flatnonzero(steers_to == change), moves[1:])
    lane = found.observations[:, EGO, 2].reshape(-1, 2)[:, 0] * 12 / 4
    assert abs(lane[-1] - lane[0] - change) < 0.1


def test_the_labels_of_a_driver_model_drive_as_it_does() -> None:
    scene = alone(60)
    driver = make_agent("idm_mobil")
    model = Simulation(scene, 1, "ego", OneAgent("ego"), {"ego": driver})
    model.reset(np.zeros(1, dtype=np.uint64))
    speeds = []
    for _ in range(60):
        speeds.append(model.scene.speed[0, 0])
        model.step()
    labels = samples_of(driver, scene).labels.argmax(axis=1).reshape(-1, 2)[:, 0]
    labelled = Simulation(scene, 1, None, OneAgent(""), {}, actions=with_speed_steps(*STEPS))
    labelled.reset(np.zeros(1, dtype=np.uint64))
    scene_now = labelled.scene
    scene_now.speed[0, 0] = scene_now.target_speed[0, 0] = speeds[SETTLING]
    for speed, action in zip(speeds[SETTLING:], labels, strict=True):
        assert labelled.scene.speed[0, 0] == pytest.approx(speed, abs=0.3)
        labelled.step(np.array([action]))


def test_a_tenth_of_the_episodes_is_held_out_and_the_first_two_seconds_are_left_out() -> None:
    found = samples_of(Scripted([IDLE]), alone(15), episodes=20)
    assert found.held_out.reshape(9, 20).sum(axis=1).tolist() == [2] * 9
    two = samples_of(Scripted([IDLE]), alone(15), episodes=2)
    assert two.held_out.reshape(9, 2).sum(axis=0).tolist() == [0, 9]


def test_samples_without_commands_have_seven_rows() -> None:
    found = samples_of(Scripted([IDLE]), alone(15), observation=Neighbours())
    assert found.observations.shape == (18, 7, 5)
