"""Small policies and a driver model with each kind of state, in arithmetic without libraries.

Sums of products are written out, because those of NumPy depend on the processor.
"""

from typing import Any

import numpy as np

from charms_bench import FASTER, IDLE, LANE_LEFT, LANE_RIGHT, SLOWER, DriverModel, Policy
from charms_bench.world.actions import Actions, with_speed_steps
from charms_bench.world.scene import Floats, Ints, Observations, Scene, Vehicles

WEIGHTS = np.random.default_rng(0).integers(-8, 9, (35, 5)) / 8


def values(observations: Observations) -> Floats:
    """Returns the values (M, 5) of a linear network."""
    seen = observations.astype(np.float64).reshape(len(observations), -1)
    found = np.zeros((len(seen), 5))
    for k in range(35):
        found += seen[:, k, None] * WEIGHTS[k]
    return found


class Recurrent(Policy):
    """Chooses by a decaying sum of values, some of it at random."""

    memory_width, noise_draws = 5, 1

    def decide(self, observations: Observations, memory: Floats, noise: Floats) -> Any:
        memory = 0.5 * memory + values(observations)
        return np.where(noise[:, 0] < 0.2, IDLE, np.argmax(memory, axis=1)), memory


class Noisy(Policy):
    """Draws an action for each vehicle, most of the time IDLE; sees what the paper's agents see."""

    observation, noise_draws = "paper_neighbours", 5

    def decide(self, observations: Observations, memory: Floats, noise: Floats) -> Actions:
        return np.where(noise[:, 4] < 0.6, IDLE, np.argmax(values(observations) * noise, axis=1))


class Remembering(Policy):
    """Speeds up if its leader has come nearer over three decisions, or else keeps its lane."""

    history_length, decision_hz = 3, 5.0

    def decide(self, observations: Observations) -> Actions:
        change = values(observations[:, 2]) - values(observations[:, 0])
        return np.argmax(change, axis=1)


class Wrong(Policy):
    """Chooses an action that does not exist for the vehicle of one row, and else keeps its lane."""

    def __init__(self, row: int) -> None:
        self.row = row

    def decide(self, observations: Observations) -> Actions:
        return np.where(np.arange(len(observations)) == self.row, 5, IDLE)


class Steering(Policy):
    """Accelerates and steers a little."""

    actions = "continuous"

    def decide(self, observations: Observations) -> Actions:
        found = np.clip(values(observations)[:, :2] / 8, -1, 1)
        return found * [1.0, 0.02]


class Canny(Policy):
    """Changes its target speed by steps that grow when it repeats itself."""

    actions = with_speed_steps(0.5, 1.0, 2.5)

    def decide(self, observations: Observations) -> Actions:
        slow = observations[:, 0, 3] < 0.72
        found = np.where(slow, FASTER, SLOWER)
        left = values(observations)[:, LANE_LEFT] > 2.0
        return np.where(left, np.where(slow, LANE_LEFT, LANE_RIGHT), found)


class Planning(Policy):
    """Looks ahead with three continuous plans and takes the one that gets furthest."""

    actions, rollouts_with = "continuous", "idm_mobil"

    def decide(self, observations: Observations, memory: Any, noise: Any, rollouts: Any) -> Actions:
        plans = np.zeros((3, 4, 2))
        plans[:, :, 0] = np.array([-0.4, 0.1, 0.6])[:, None]
        plans[1, 0, 1] = 0.01
        found = rollouts(plans)
        value = found.x[:, :, -1] - 1e3 * found.failed[:, :, -1] - 1e2 * (found.gap[:, :, -1] < 20)
        return plans[np.argmax(value, axis=1), 0]


class Braking(DriverModel):
    """Brakes in every second step and counts its steps; each driver has its own strength."""

    memory_width = 1
    parameters = {"strength": (0.5, 2.0)}  # noqa: RUF012

    def drive(self, scene: Scene, vehicles: Vehicles) -> tuple[Floats, Ints]:
        steps = scene.memory[vehicles][:, 0]
        scene.memory[(*vehicles, 0)] = steps + 1
        strength = scene.parameters[vehicles][:, 0]
        lane = np.where(steps == 20, np.maximum(scene.lane[vehicles] - 1, 0), scene.lane[vehicles])
        return np.where(steps % 2 == 1, -strength, 0.5 * strength), lane
