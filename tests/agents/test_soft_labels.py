"""What a driver meant, and CHARMS eq. 9 and 10."""

import numpy as np
import pytest
from charms_agents.human.soft_labels import (
    brakings,
    lateral_intents,
    longitudinal_intents,
    soft_labels,
    step_labels,
)

from charms_bench.world.actions import DEFAULT_ACTIONS, MetaAction
from charms_bench.world.profile import PROFILES
from charms_bench.world.scene import SceneSettings


def test_a_weak_acceleration_means_nothing() -> None:
    acceleration = np.array([0.19, 0.21, -0.19, -0.21])
    assert longitudinal_intents(acceleration).tolist() == [0, 1, 0, -1]


def test_a_drift_is_meant_when_it_leads_away_from_the_centre() -> None:
    lateral_speed = np.array([0.08, 0.06, 0.08, -0.08, -0.08])
    offset = np.array([0.5, 0.5, -0.5, -0.5, 0.5])
    assert lateral_intents(lateral_speed, offset).tolist() == [1, 0, 0, -1, 0]


def test_two_intents_share_the_probability_by_their_magnitudes() -> None:
    # Means of the magnitudes are 0.5 m/s2 and 0.1 m/s: three times the one, once the other.
    acceleration, lateral_speed = np.array([-1.5, 0.0, 0.0]), np.array([0.1, -0.1, 0.1])
    longitudinal, lateral = np.array([-1, 0, 0], np.int8), np.array([1, -1, 0], np.int8)
    labels = soft_labels(longitudinal, lateral, acceleration, lateral_speed)
    # LANE_LEFT, IDLE, LANE_RIGHT, FASTER, SLOWER
    assert labels.tolist() == [[0, 0, 0.25, 0, 0.75], [1, 0, 0, 0, 0], [0, 1, 0, 0, 0]]


def test_one_intent_is_one_action_and_none_is_idle() -> None:
    labels = soft_labels(
        np.array([1, -1, 0, 0, 0], np.int8),
        np.array([0, 0, 1, -1, 0], np.int8),
        np.array([0.3, -0.3, 0.0, 0.0, 0.0]),
        np.array([0.0, 0.0, 0.1, -0.1, 0.0]),
    )
    assert labels.argmax(axis=1).tolist() == [3, 4, 2, 0, 1]
    assert (labels.sum(axis=1) == 1).all()


def test_steps_drawn_from_the_labels_accelerate_on_average_as_the_driver_does() -> None:
    acceleration = np.random.default_rng(0).uniform(-0.75, 0.75, 1000)
    labels = step_labels(np.zeros(1000, np.int8), acceleration, strongest_mps2=0.75)
    # Three decisions per second, each of which changes the speed by 0.25, 0 or -0.25 m/s.
    mean = 3 * labels @ np.array([0.0, 0.0, 0.0, 0.25, -0.25])
    np.testing.assert_allclose(mean, acceleration, atol=1e-6)
    np.testing.assert_allclose(labels.sum(axis=1), 1.0, rtol=1e-6)
    assert (labels >= 0).all()


def test_a_driver_that_accelerates_more_than_steps_can_takes_every_step() -> None:
    labels = step_labels(np.zeros(2, np.int8), np.array([2.0, -2.0]), strongest_mps2=0.75)
    assert labels.tolist() == [[0, 0, 0, 1, 0], [0, 0, 0, 0, 1]]


def test_a_lane_change_is_certain_whatever_the_speed_does() -> None:
    labels = step_labels(np.array([-1, 1], np.int8), np.array([0.5, -0.5]), strongest_mps2=0.75)
    assert labels.tolist() == [[1, 0, 0, 0, 0], [0, 0, 1, 0, 0]]


SIX = (*DEFAULT_ACTIONS, MetaAction("BRAKE", speed_from_present_mps=-6.0))


def test_who_brakes_harder_than_steps_can_brakes_as_hard_on_average() -> None:
    # In the scene of `charms`, the controller keeps -6 m/s / 0.8 s during a decision.
    braking = brakings(SIX, SceneSettings(), 3.0)
    assert braking == {5: pytest.approx(7.5)}
    acceleration = np.array([-0.5, -0.75, -3.0, -7.5, -9.0, 1.0])
    labels = step_labels(np.zeros(6, np.int8), acceleration, 0.75, SIX, braking)
    assert labels.shape == (6, 6)
    np.testing.assert_allclose(labels.sum(axis=1), 1.0, rtol=1e-6)
    mean = labels @ np.array([0.0, 0.0, 0.0, 0.75, -0.75, -7.5])
    np.testing.assert_allclose(mean, [-0.5, -0.75, -3.0, -7.5, -7.5, 0.75], atol=1e-5)
    assert labels[2, [1, 3]].tolist() == [0, 0]


def test_a_controller_that_acts_in_every_step_brakes_less_in_a_decision() -> None:
    # Each of five steps takes 1 / 12 off the 6 m/s that are left.
    (found,) = brakings(SIX, SceneSettings(profile=PROFILES["naturalistic"]), 3.0).values()
    assert found == pytest.approx(6 * (1 - (11 / 12) ** 5) * 3)
