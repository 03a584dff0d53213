"""One scene with vehicles wherever a test wants them; vehicle 0 is the ego."""

import numpy as np

from charms_bench.engine.neighbours import locate
from charms_bench.engine.simulation import Simulation
from charms_bench.plugins.agent import Policy
from charms_bench.plugins.traffic import OneAgent
from charms_bench.world.actions import IDLE, Actions
from charms_bench.world.scene import Observations, Scene, SceneSettings

LANE_M = 4.0


class Idle(Policy):
    """Keeps speed and lane."""

    def decide(self, observations: Observations) -> Actions:
        return np.full(len(observations), IDLE)


def simulation_of(
    *vehicles: tuple[float, int, float], target_lane: int | None = None
) -> Simulation:
    """A simulation of vehicles given as (x, lane, speed); the ego steers to `target_lane`."""
    settings = SceneSettings(traffic_vehicles=len(vehicles) - 1, ego_slots=1)
    simulation = Simulation(settings, 1, None, OneAgent("idle"), {"idle": Idle()})
    simulation.reset(np.zeros(1, dtype=np.uint64))
    place(simulation.scene, *vehicles, target_lane=target_lane)
    return simulation


def place(
    scene: Scene, *vehicles: tuple[float, int, float], target_lane: int | None = None
) -> None:
    """Puts every vehicle (x, lane, speed) on its lane's centre."""
    x, lane, speed = np.transpose(vehicles)
    scene.x[0], scene.y[0], scene.speed[0] = x, lane * LANE_M, speed
    scene.target_lane[0] = lane
    if target_lane is not None:
        scene.target_lane[0, 0] = target_lane
    locate(scene, np.array([0]))
