"""Places the vehicles of a scenario, and computes their prescribed motion.

A prescribed vehicle obeys accelerations and steering angles like any other vehicle. Its steering
angle is the one with which the bicycle model reaches its prescribed path at the end of the step.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from charms_bench.engine.meta_actions import choose_target_speeds
from charms_bench.engine.neighbours import locate
from charms_bench.engine.running import RunningEpisodes
from charms_bench.engine.source import Source
from charms_bench.engine.stepping import Put
from charms_bench.foundation import maths
from charms_bench.foundation.compiled import clip, compiled, inlined
from charms_bench.foundation.generator import seeded
from charms_bench.world.bicycle import steering_of
from charms_bench.world.placement import Placement, Placing, place
from charms_bench.world.road import position
from charms_bench.world.scenario import Scenario
from charms_bench.world.scene import Bools, Floats, Ints, Scene, SceneSettings

_ROUNDING = 1e-9
"""s; sums of intervals differ from their product in the last bits."""
TEMPERAMENT = 0.5
"""Of every vehicle of a scenario: nothing of a concrete scenario is left to chance."""


class Script:
    """The concrete scenarios of B scenes."""

    kind = Placing
    """What places the vehicles."""

    def __init__(self, scenario: Scenario, settings: SceneSettings, scenes: int) -> None:
        self._scenario, self._settings = scenario, settings
        first = np.zeros(scenes, dtype=np.int64)
        self._placement = place(scenario, settings, first, self.kind)

    def place(self, scene: Scene, rows: Ints, numbers: NDArray[Any]) -> None:
        """Places the vehicles of the scenes `rows` (R,) at the points with these numbers."""
        found = self.choose(rows, numbers)
        scene.ego[rows] = 0
        scene.length[rows], scene.width[rows] = found.length, found.width
        scene.x[rows], scene.lane[rows], scene.speed[rows] = found.x, found.lane, found.speed
        _, scene.y[rows] = position(scene.road, found.lane, found.x, 0.0)
        scene.target_speed[rows], scene.target_lane[rows] = found.speed, found.lane
        for name in ("heading", "acceleration", "steering", "timer_s", "crashed", "impact"):
            getattr(scene, name)[rows] = 0
        scene.temperament[rows] = TEMPERAMENT
        scene.order[rows] = scene.rank[rows] = np.arange(scene.x.shape[1])
        scene.active[rows] = True
        locate(scene, rows)

    def choose(self, rows: Ints, numbers: NDArray[Any]) -> Placement:
        """Prescribes the motion of points with these numbers in the scenes `rows` (R,)."""
        found = place(self._scenario, self._settings, numbers, self.kind)
        for whole, part in zip(self._placement, found, strict=True):
            whole[rows] = part
        return found

    def prescribe(self, scene: Scene, rows: Ints, is_prescribed: Bools) -> None:
        """Sets the control of the vehicles [B, N] marked in these scenes for the next step."""
        _prescribe(scene, rows, is_prescribed, self._placement)


class Placed(Source):
    """The vehicles of a scenario, some of which move as it prescribes."""

    def __init__(self, episodes: RunningEpisodes) -> None:
        super().__init__(episodes)
        settings, scenes = episodes.settings, episodes.seeds.size
        assert settings.scenario is not None
        self._script = Script(settings.scenario, settings, scenes)
        self._speeds = np.array(settings.profile.target_speeds_mps, dtype=np.float64)
        self._is_prescribed = np.zeros(episodes.scene.x.shape, dtype=np.bool_)

    def start(self, rows: Ints, seats: Ints, draws: Floats | None) -> None:
        episodes, scene, seeds = self._episodes, self._episodes.scene, self._episodes.seeds[rows]
        self._script.place(scene, rows, seeds)
        scene.generator[rows] = seeded(seeds)
        episodes.engine.drivers[rows] = seats
        if self._speeds.size:
            is_free = np.isin(episodes.engine.drivers, episodes.unrounded)
            choose_target_speeds(scene, rows, is_free, self._speeds)
        self._mark(rows)
        episodes.engine.restore(rows, seeds)

    def resume(self, rows: Ints) -> None:
        self._script.choose(rows, self._episodes.seeds[rows])
        self._mark(rows)

    def _mark(self, rows: Ints) -> None:
        drivers, prescribed = self._episodes.engine.drivers, self._episodes.prescribed
        self._is_prescribed[rows] = np.isin(drivers[rows], prescribed)

    def before_move(self) -> Put | None:
        scene = self._episodes.scene
        self._script.prescribe(scene, np.nonzero(scene.active)[0], self._is_prescribed)
        return None


@compiled
def _prescribe(scene: Scene, rows: Ints, is_prescribed: Bools, placed: Placement) -> None:
    c = scene.constants
    for b in rows:
        for i in range(is_prescribed.shape[1]):
            if not is_prescribed[b, i] or scene.crashed[b, i]:
                continue
            time = scene.timer_s[b, i]
            speed, heading = scene.speed[b, i], scene.heading[b, i]
            acceleration = acceleration_at(placed, b, i, time, speed, c.dt)
            _, y = position(scene.road, placed.lane[b, i], scene.x[b, i], 0.0)
            for k in range(placed.moves_at.shape[2]):
                if placed.moves_at[b, i, k] <= time + _ROUNDING:
                    y += placed.moves_by[b, i, k] * passed(placed, b, i, k, time + c.dt)
                    scene.target_lane[b, i] = placed.moves_to[b, i, k]
            scene.acceleration[b, i] = acceleration
            scene.steering[b, i] = steering_to(y - scene.y[b, i], speed * c.dt, heading)


@compiled
def acceleration_at(
    placed: Placement, b: int, i: int, time: float, speed: float, dt: float
) -> float:
    """The acceleration that is prescribed for a vehicle from a time on, for a step."""
    acceleration = 0.0
    for k in range(placed.brakes_at.shape[2]):
        if placed.brakes_at[b, i, k] <= time + _ROUNDING:
            wanted, left = placed.acceleration[b, i, k], placed.until[b, i, k] - speed
            acceleration = clip(wanted, min(0.0, left / dt), max(0.0, left / dt))
    return acceleration


@inlined
def passed(placed: Placement, b: int, i: int, k: int, time: float) -> float:
    """The part of a movement to another lane that is over at a time, 0 to 1."""
    return clip((time - placed.moves_at[b, i, k]) / placed.duration[b, i, k], 0.0, 1.0)


@compiled
def steering_to(aside: float, distance: float, heading: float) -> float:
    """The steering angle that moves a vehicle aside by so much while it drives a distance.

    The inverse of the bicycle model's lateral displacement [`Vehicle.step`].
    """
    if distance < 1e-6:
        return 0.0
    slip = maths.asin(clip(aside / distance, -1.0, 1.0)) - heading
    return steering_of(maths.tan(clip(slip, -1.0, 1.0)))
