"""Drivers as they were recorded, in scenes of recordings (`scene: {recording: ...}`)."""

import numpy as np
from numpy.typing import NDArray

from charms_bench.plugins.agent import DriverModel
from charms_bench.plugins.traffic import Traffic
from charms_bench.world.scene import Floats, Ints, Scene, Vehicles

NAME = "recorded"


class Recorded(DriverModel):
    """Moves as recorded; where there is no recording, it keeps its speed and its lane."""

    follows_recording = True

    def drive(self, scene: Scene, vehicles: Vehicles) -> tuple[Floats, Ints]:
        return np.zeros(vehicles[0].size), scene.lane[vehicles]


class RecordedUntilDeviation(Traffic):
    """The recorded drivers, until the ego is no longer where its vehicle was recorded.

    Args:
        then: The agent that drives all other vehicles from then on.
    """

    def __init__(self, then: str = "idm_mobil") -> None:
        self.agents = (NAME, then)
        self.after_deviation = then

    def assign(self, rng: np.random.Generator, scenes: int, vehicles: int) -> NDArray[np.str_]:
        return np.full((scenes, vehicles), NAME)
