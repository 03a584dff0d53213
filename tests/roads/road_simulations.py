"""Simulations on roads, started with the seeds 0, 1, ..."""

from pathlib import Path
from typing import Any

import numpy as np

from charms_bench.engine.simulation import Simulation
from charms_bench.plugins.registry import make_agent
from charms_bench.plugins.traffic import OneAgent
from charms_bench.roads.engine import RoadEngine
from charms_bench.roads.settings import on_road
from charms_bench.world.named_road import ENVIRONMENT, NamedRoad
from charms_bench.world.scenario import PRESCRIBED
from charms_bench.world.scene import SceneSettings

PLACES = Path(__file__).parents[2] / "suites" / "places"


def simulation(road: str, traffic: str = ENVIRONMENT, scenes: int = 4, **scene: Any) -> Simulation:
    """Scenes of IDM egos on a road of highway-env, or on one of the project's own places."""
    path = PLACES / f"{road}.json"
    named = NamedRoad.model_validate({"file": path} if path.exists() else {"name": road})
    settings = on_road(SceneSettings.model_validate({"profile": "roads", **scene}), named)
    driver = PRESCRIBED if traffic == ENVIRONMENT else traffic
    agents = {name: make_agent(name) for name in {"idm_mobil", driver} - {PRESCRIBED}}
    made = Simulation(settings, scenes, "idm_mobil", OneAgent(driver), agents, RoadEngine)
    made.reset(np.arange(scenes, dtype=np.uint64))
    return made
