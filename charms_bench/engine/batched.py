"""The default engine: thousands of scenes at once, compiled."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from charms_bench.agent import FASTER, LANE_LEFT, LANE_RIGHT, SLOWER, Actions, DriverModel
from charms_bench.engine import kernels
from charms_bench.scene import Ints, Scene, SceneSettings, Vehicles


class BatchedEngine:
    """highway-env's behaviour over arrays `[B, N]`; see `charms_bench.engine`."""

    def __init__(self, settings: SceneSettings, scenes: int) -> None:
        self.scene = Scene.empty(settings, scenes)
        self._settings = settings
        self._models: tuple[DriverModel, ...] = ()
        self._model_of = np.full(self.scene.x.shape, -1)
        self._modelled = np.zeros(self.scene.x.shape, dtype=np.bool_)
        self._groups: list[tuple[DriverModel, Vehicles]] = []
        self._grouped = np.zeros(scenes, dtype=np.bool_)

    def reset(
        self,
        rows: Ints,
        seeds: NDArray[np.uint64],
        models: Sequence[DriverModel],
        ego_model: int,
        traffic_models: Ints,
    ) -> None:
        scene, settings, profile = self.scene, self._settings, self._settings.profile
        traffic_spacing = 1 / settings.density
        crowding = float(np.exp(-5 / 40 * settings.lanes))
        for row, seed in zip(rows, seeds, strict=True):
            kernels.spawn(
                row,
                scene,
                np.random.default_rng(int(seed)),
                settings.ego_slots,
                profile.ego_speed_mps,
                profile.ego_spacing or traffic_spacing,
                traffic_spacing,
                crowding,
                profile.spawn_speed_low,
                profile.spawn_speed_high,
            )
        kernels.locate(scene, rows)
        self._models = tuple(models)
        is_ego = np.arange(settings.vehicles) == scene.ego[rows, None]
        model_of = np.empty(is_ego.shape, dtype=np.int64)
        model_of[is_ego] = ego_model
        model_of[~is_ego] = traffic_models.ravel()
        self._model_of[rows] = model_of
        self._modelled[rows] = model_of >= 0
        if profile.target_speeds_mps:
            commanded = (rows[np.nonzero(model_of < 0)[0]], np.nonzero(model_of < 0)[1])
            speeds = scene.target_speed[commanded]
            scene.target_speed[commanded] = self._nearest_target_speed(speeds, 0)
        self._grouped[:] = False

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
        width, x = profile.lane_width_m, scene.x[vehicles]
        reachable = (  # [`AbstractLane.is_reachable_from`]
            (np.abs(scene.y[vehicles] - lane * width) <= 2 * width)
            & (0 <= x)
            & (x < profile.road_length_m + profile.vehicle_length_m)
        )
        scene.target_lane[vehicles] = np.where(
            (side != 0) & reachable, lane, scene.target_lane[vehicles]
        )

    def advance(self) -> None:
        if not np.array_equal(self._grouped, self.scene.active):
            self._regroup()
        for model, vehicles in self._groups:
            acceleration, target_lane = model.drive(self.scene, vehicles)
            kernels.obey(self.scene, vehicles[0], vehicles[1], acceleration, target_lane)
        kernels.advance(self.scene, self._modelled)

    def _regroup(self) -> None:
        """Lists the vehicles of each driver model; those of ended scenes drop out."""
        self._grouped[:] = self.scene.active
        model_of = np.where(self.scene.active[:, None], self._model_of, -1)
        groups = ((model, np.nonzero(model_of == k)) for k, model in enumerate(self._models))
        self._groups = [(model, vehicles) for model, vehicles in groups if vehicles[0].size]

    def _nearest_target_speed(
        self, speed: NDArray[np.float64], change: NDArray[np.int64] | int
    ) -> NDArray[np.float64]:
        """[`MDPVehicle.speed_to_index` and `index_to_speed`], `change` indices further."""
        speeds = np.array(self._settings.profile.target_speeds_mps)
        index = np.round((speed - speeds[0]) / (speeds[-1] - speeds[0]) * (speeds.size - 1))
        index = index.clip(0, speeds.size - 1).astype(np.int64) + change
        return speeds[index.clip(0, speeds.size - 1)]
