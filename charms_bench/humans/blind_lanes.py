"""A driver with a known fault: it changes lanes as often as recorded drivers, without looking."""

import numpy as np

from charms_bench.humans.held_out import SEED
from charms_bench.humans.simple_models import keeping
from charms_bench.plugins.agent import DriverModel
from charms_bench.world.gaps import time_headway
from charms_bench.world.scene import Floats, Ints, Scene, Vehicles

LIMITS_MPS2 = (-9.0, 2.0)
LIMITS_TIME_GAP_S = (0.5, 3.0)


class BlindLanes(DriverModel):
    """Keeps the first time gap to the leader, and changes to a random side at random times."""

    memory_width = 1

    def __init__(self, changes_per_km: float, lanes: int) -> None:
        self._changes_per_m, self._last = changes_per_km / 1000, lanes - 1
        self._rng = np.random.default_rng(SEED)

    def drive(self, scene: Scene, vehicles: Vehicles) -> tuple[Floats, Ints]:
        speed, lane = scene.speed[vehicles], scene.lane[vehicles]
        leader, is_led = scene.leader(vehicles, lane)
        gap = scene.gap_to(vehicles, leader)
        first = np.clip(time_headway(gap, speed), *LIMITS_TIME_GAP_S)
        kept = scene.memory[vehicles][:, 0]
        time_gap = np.where(kept > 0, kept, np.where(is_led, first, 0.0))
        scene.memory[(*vehicles, np.zeros(lane.size, dtype=np.int64))] = time_gap
        wanted = keeping(time_gap, gap, speed, scene.speed[vehicles[0], leader])
        driven_m = speed * scene.timer_s[vehicles]
        scene.timer_s[vehicles] = 0.0
        changes = self._rng.random(lane.size) < self._changes_per_m * driven_m
        side = np.where(self._rng.random(lane.size) < 0.5, -1, 1)
        side = np.where((lane + side < 0) | (lane + side > self._last), -side, side)
        target = scene.target_lane[vehicles]
        target = np.where(changes & (lane == target), lane + side, target)
        return np.where(is_led, np.clip(wanted, *LIMITS_MPS2), 0.0), target
