"""Reads from this project's straight road what the golden traces have of highway-env's."""

from typing import Any

import numpy as np
from numpy.typing import NDArray
from recorded_traces import Floats, canonical

from charms_bench.engine.simulation import Simulation
from charms_bench.plugins.registry import make_agent
from charms_bench.plugins.traffic import OneAgent
from charms_bench.world.scene import SceneSettings

DRIVER = "idm_mobil"


class StraightRoads:
    """Episodes of one configuration, which advance together; see `road_frames.Roads`."""

    def __init__(self, count: int, config: dict[str, Any]) -> None:
        rate = "decision" if config["holds"] else "simulation"
        settings = {
            "profile": {"name": config["profile"], "ego_control_rate": rate},
            "lanes": config["lanes"],
            "traffic_vehicles": config["vehicles"] - 1,
            "density": config["density"],
            "ego_slots": 6 if config["profile"] == "charms" else 1,
            "decision_hz": config["decision_hz"],
        }
        self._ego = config["ego"]
        self._simulation = Simulation(
            SceneSettings.model_validate(settings),
            count,
            DRIVER if self._ego == "idm" else None,
            OneAgent(DRIVER),
            {DRIVER: make_agent(DRIVER)},
            actions="continuous" if self._ego == "continuous" else "meta",
        )

    def start(self, seeds: NDArray[np.uint64]) -> list[dict[str, Floats]]:
        """Starts all episodes; returns the frame of each."""
        self._simulation.reset(seeds)
        return self._frames()

    def step(self, actions: NDArray[Any]) -> list[dict[str, Floats]]:
        """Carries out the actions (B, 1, ...) of a decision; returns the frame of each."""
        self._simulation.step(None if self._ego == "idm" else actions[:, 0])
        return self._frames()

    def words(self) -> NDArray[np.uint64]:
        """[B, 6] the states of the random generators."""
        return self._simulation.scene.generator

    def _frames(self) -> list[dict[str, Floats]]:
        simulation, scene = self._simulation, self._simulation.scene
        idm = scene.constants.idm_mobil
        names = ("x", "y", "heading", "speed", "acceleration", "steering", "lane", "crashed")
        values = {name: getattr(scene, name).astype(np.float64) for name in names}
        is_idm = np.ones(scene.x.shape, dtype=np.bool_)
        is_idm[simulation.ego_vehicles] = self._ego == "idm"
        has_targets = is_idm | (self._ego == "meta")
        values["target_speed"] = np.where(has_targets, scene.target_speed, np.nan)
        values["target_lane"] = np.where(has_targets, scene.target_lane, np.nan)
        values["timer"] = np.where(is_idm, scene.timer_s, np.nan)
        exponent = idm.exponent_low + (idm.exponent_high - idm.exponent_low) * scene.temperament
        values["exponent"] = np.where(is_idm, exponent, np.nan)
        impact = np.stack((scene.impact_x, scene.impact_y), axis=-1)
        values["impact"] = np.where(scene.impact[..., None], impact, np.nan)
        values["ego"] = scene.ego[:, None].astype(np.float64)
        values["ended"] = np.stack((simulation.failed, simulation.truncated), axis=1)
        values = {name: canonical(each) for name, each in values.items()}
        return [{name: each[b] for name, each in values.items()} for b in range(len(scene.x))]
