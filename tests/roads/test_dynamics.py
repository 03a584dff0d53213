"""The bicycle model with slip, and actions that are accelerations and steering angles."""

from typing import Any

import numpy as np
import pytest
from highway_env.envs.common.action import ContinuousAction, DiscreteAction
from highway_env.vehicle.dynamics import BicycleVehicle

from charms_bench.errors import InputError
from charms_bench.roads.continuous_actions import actions_of
from charms_bench.roads.dynamics import move_with_slip
from charms_bench.roads.scenes import VEHICLE

TYPES = {"ContinuousAction": ContinuousAction, "DiscreteAction": DiscreteAction}


@pytest.mark.parametrize("speed", [8.3, 0.4, -6.0])
def test_a_dynamical_vehicle_slips_as_in_highway_env(speed: float) -> None:
    theirs = BicycleVehicle(None, [3.0, -2.0], 0.4, speed)
    ours = np.zeros(1, VEHICLE)
    ours["x"], ours["y"], ours["heading"], ours["speed"] = 3.0, -2.0, 0.4, speed
    rng = np.random.default_rng(0)
    for _ in range(30):
        steering, acceleration = rng.uniform(-2, 2), rng.uniform(-5, 5)
        ours["steering"], ours["acceleration"] = steering, acceleration
        theirs.act({"steering": steering, "acceleration": acceleration})
        theirs.step(0.1)
        move_with_slip(ours[0], 0.1)
        state = [ours[0][name] for name in ("x", "y", "heading", "speed")]
        state += [ours[0]["lateral_speed"], ours[0]["yaw_rate"]]
        np.testing.assert_allclose(state, theirs.state[:, 0], rtol=1e-6, atol=1e-6)


class Driver:
    """A vehicle that notes its action."""

    action: dict[str, float]

    def act(self, action: dict[str, float]) -> None:
        self.action = action


class Scene:
    """As much of a scene as actions need."""

    def __init__(self, count: int) -> None:
        self.vehicles = np.zeros((count, 1), VEHICLE)


@pytest.mark.parametrize("clip", [True, False])
@pytest.mark.parametrize("kind", tuple(TYPES))
@pytest.mark.parametrize("axes", [("longitudinal", "lateral"), ("longitudinal",), ("lateral",)])
def test_actions_mean_to_the_last_bit_what_they_do_in_highway_env(
    axes: tuple[str, ...], kind: str, clip: bool
) -> None:
    flags = {axis: axis in axes for axis in ("longitudinal", "lateral")}
    config = {"type": kind, **flags, "clip": clip, "steering_range": [-0.7, 1.1]}
    own: Any = actions_of({"action": config}, tuple(TYPES))
    theirs = TYPES[kind](None, **config)
    assert own.space == theirs.space()
    own.space.seed(0)
    scene: Any = Scene(20)
    for dtype in (None, np.float64):
        samples = np.array([own.space.sample() for _ in range(20)])
        if dtype and kind == "ContinuousAction":
            samples = samples.astype(dtype) * 1.5
        own.give(scene, np.arange(20), samples, 0)
        for k, sample in enumerate(samples):
            driver: Any = Driver()
            theirs.controlled_vehicle = driver
            theirs.act(sample)
            found = {axis: scene.vehicles[axis][k, 0] for axis in ("acceleration", "steering")}
            assert found == driver.action


def test_a_speed_range_is_given_to_the_ego() -> None:
    own: Any = actions_of(
        {"action": {"type": "ContinuousAction", "speed_range": [0, 20]}}, tuple(TYPES)
    )
    scene: Any = Scene(1)
    own.give(scene, np.zeros(1, dtype=int), np.zeros((1, 2)), 0)
    assert (scene.vehicles["speed_min"][0, 0], scene.vehicles["speed_max"][0, 0]) == (0, 20)


@pytest.mark.parametrize(
    ("action", "what"),
    [
        ({"type": "DiscreteMetaAction"}, "config.action.type: 'DiscreteMetaAction'"),
        ({"type": "ContinuousAction", "steer": 1}, "no key named 'steer'"),
        ({"type": "ContinuousAction", "actions_per_axis": 3}, "no key named 'actions_per_axis'"),
        ({"type": "DiscreteAction", "lateral": False, "longitudinal": False}, "neither"),
        ({"type": "ContinuousAction", "steering_range": [1]}, "steering_range.*two numbers"),
    ],
)
def test_actions_that_are_not_supported_are_rejected(action: dict[str, Any], what: str) -> None:
    with pytest.raises(InputError, match=what):
        actions_of({"action": action}, tuple(TYPES))
