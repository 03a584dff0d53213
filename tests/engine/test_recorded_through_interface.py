"""Recorded speeds can be followed by meta-actions as the engine carries them out."""

import numpy as np
import pytest
from charms_agents.human.interface import through_interface

from charms_bench.engine.simulation import Simulation
from charms_bench.plugins.traffic import OneAgent
from charms_bench.world.actions import DEFAULT_ACTIONS, IDLE, MetaAction, with_speed_steps
from charms_bench.world.profile import PROFILES
from charms_bench.world.scene import SceneSettings


@pytest.mark.parametrize(
    ("name", "own"), [("charms", ()), ("naturalistic", ()), ("charms", (0.25, 0.5, 1.0, 2.0))]
)
def test_speeds_and_commands_are_those_of_the_engine(name: str, own: tuple[float, ...]) -> None:
    profile = PROFILES[name]
    steps = own or profile.target_speed_steps_mps
    recorded = profile.ego_speed_mps + 2.0 * np.sin(np.arange(60) / 8)
    commanded = profile.model_copy(update={"target_speed_steps_mps": steps})
    driven = through_interface(recorded[:, None], commanded)
    settings = SceneSettings(profile=profile, traffic_vehicles=0, ego_slots=1, duration_s=30.0)
    actions = with_speed_steps(*own) if own else DEFAULT_ACTIONS
    made = Simulation(settings, 1, None, OneAgent(""), {}, actions=actions)
    made.reset(np.zeros(1, dtype=np.uint64))
    for k, action in enumerate(driven.actions[:, 0]):
        scene = made.scene
        assert scene.target_speed[0, 0] == pytest.approx(driven.target_speed[k, 0], abs=1e-9)
        assert scene.repeats[0, 0] == driven.repeats[k, 0]
        if k:  # the engine's vehicles have no acceleration before they move
            assert scene.acceleration[0, 0] == pytest.approx(driven.acceleration[k, 0], abs=1e-9)
        made.step(np.array([action]))
        assert made.scene.speed[0, 0] == pytest.approx(driven.speed[k + 1, 0], abs=1e-9)
    assert len(set(driven.actions[:, 0])) == 3
    assert np.abs(driven.speed[:, 0] - recorded).max() < 1.0


def test_a_driver_who_brakes_hard_takes_the_action_that_can() -> None:
    six = (*DEFAULT_ACTIONS, MetaAction("BRAKE", speed_from_present_mps=-6.0))
    profile = PROFILES["naturalistic"]
    recorded = np.array([30.0, 30.0, 30.0, 28.0, 26.0, 24.0, 23.9, 23.8])
    driven = through_interface(recorded[:, None], profile, six)
    assert driven.actions[:2, 0].tolist() == [IDLE, IDLE]
    assert driven.actions[2:4, 0].tolist() == [5, 5]
    # Of 6 m/s, five steps of 1/15 s leave (11/12)^5.
    assert driven.speed[3, 0] == pytest.approx(24.0 + 6.0 * (11 / 12) ** 5)
    without = through_interface(recorded[:, None], profile)
    assert abs(without.speed[5, 0] - 24.0) > abs(driven.speed[5, 0] - 24.0) + 3.0
