"""The default engine: thousands of scenes at once, compiled."""

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from charms_bench.engine import kernels
from charms_bench.plugins.agent import DriverModel
from charms_bench.world import maths
from charms_bench.world.actions import FASTER, LANE_LEFT, LANE_RIGHT, SLOWER, Actions
from charms_bench.world.lanes import is_reachable
from charms_bench.world.scene import Floats, Ints, Scene, SceneSettings, Vehicles


class BatchedEngine:
    """highway-env's behaviour over arrays `[B, N]`; see `charms_bench.engine`."""

    def __init__(
        self, settings: SceneSettings, scenes: int, models: Mapping[int, DriverModel]
    ) -> None:
        self.scene = Scene.empty(settings, scenes)
        self.drivers = np.zeros(self.scene.x.shape, dtype=np.int64)
        self._settings = settings
        self._spawn_rule = _spawn_rule(settings)
        self._models = models
        self._shown = self.scene.read_only()
        self._is_modelled = np.zeros(self.drivers.shape, dtype=np.bool_)
        self._vehicles: dict[int, Vehicles] = {}
        """The active vehicles of each driver model, while `_listed` are the active scenes."""
        self._listed = self.scene.active.copy()

    def reset(self, rows: Ints, seeds: NDArray[np.uint64], traffic: Ints) -> None:
        scene, profile = self.scene, self._settings.profile
        count = 4 * self._settings.vehicles + 8  # each vehicle takes up to three words and a half
        words = np.empty((rows.size, count), dtype=np.uint64)
        for row_words, seed in zip(words, seeds, strict=True):
            row_words[:] = np.random.PCG64(int(seed)).random_raw(count)
        kernels.spawn(scene, rows, words, self._spawn_rule)
        is_ego = np.arange(self._settings.vehicles) == scene.ego[rows, None]
        drivers = np.zeros(is_ego.shape, dtype=np.int64)
        drivers[~is_ego] = traffic.ravel()
        self.drivers[rows] = drivers
        self._is_modelled[rows] = np.isin(drivers, list(self._models))
        self._vehicles.clear()
        if profile.target_speeds_mps:
            which, places = np.nonzero(~self._is_modelled[rows])
            commanded = rows[which], places
            speeds = scene.target_speed[commanded]
            scene.target_speed[commanded] = self._nearest_target_speed(speeds, 0)

    def command(self, vehicles: Vehicles, actions: Actions) -> None:
        scene, profile = self.scene, self._settings.profile
        change = (actions == FASTER).astype(np.int64) - (actions == SLOWER)
        if profile.target_speeds_mps:
            wanted = self._nearest_target_speed(scene.speed[vehicles], change)
        else:
            wanted = scene.target_speed[vehicles] + change * profile.target_speed_step_mps
            wanted = wanted.clip(profile.target_speed_min_mps, profile.target_speed_max_mps)
        scene.target_speed[vehicles] = np.where(change, wanted, scene.target_speed[vehicles])

        side = (actions == LANE_RIGHT).astype(np.int64) - (actions == LANE_LEFT)
        from_target = profile.lane_command_from == "target_lane"
        lane = (scene.target_lane if from_target else scene.lane)[vehicles] + side
        lane = lane.clip(0, self._settings.lanes - 1)
        reachable = is_reachable(scene.x[vehicles], scene.y[vehicles], lane, scene.constants)
        scene.target_lane[vehicles] = np.where(
            (side != 0) & reachable, lane, scene.target_lane[vehicles]
        )

    def advance(self) -> None:
        scene = self.scene
        if not self._vehicles or not np.array_equal(self._listed, scene.active):
            self._listed[:] = scene.active
            for agent in self._models:
                found = kernels.vehicles_of(agent, self.drivers, scene.active)
                self._vehicles[agent] = found
        for agent, model in self._models.items():
            vehicles = self._vehicles[agent]
            if vehicles[0].size:
                answers = model.drive(self._shown, vehicles)
                set_here = (scene.crashed, scene.acceleration, scene.target_lane)
                kernels.obey(vehicles, answers, *set_here)
        kernels.advance(scene, self._is_modelled)

    def _nearest_target_speed(self, speed: Floats, change: Ints | int) -> Floats:
        """[`MDPVehicle.speed_to_index` and `index_to_speed`], `change` indices further."""
        speeds = np.array(self._settings.profile.target_speeds_mps, dtype=np.float64)
        share = (speed - speeds[0]) / (speeds[-1] - speeds[0])
        index = np.round(share * (speeds.size - 1)).clip(0, speeds.size - 1) + change
        return np.asarray(speeds[index.clip(0, speeds.size - 1).astype(np.int64)])


def _spawn_rule(settings: SceneSettings) -> kernels.SpawnRule:
    """[`HighwayEnv._create_vehicles` and `Vehicle.create_random`]"""
    profile, spacing = settings.profile, 1 / settings.density
    return kernels.SpawnRule(
        lanes=settings.lanes,
        ego_slots=settings.ego_slots,
        ego_speed=profile.ego_speed_mps,
        ego_spacing=profile.ego_spacing or spacing,
        spacing=spacing,
        crowding=maths.exp(-5 / 40 * settings.lanes),
        speed_low=profile.spawn_speed_low * profile.speed_limit_mps,
        speed_high=profile.spawn_speed_high * profile.speed_limit_mps,
    )
