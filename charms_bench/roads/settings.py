"""The settings of scenes on a road of highway-env, and the agents that can drive there."""

from functools import lru_cache
from typing import NamedTuple

import numpy as np

from charms_bench.errors import InputError, suggestion
from charms_bench.plugins.agent import Agent, DriverModel
from charms_bench.roads import OF_SUITES
from charms_bench.roads.episodes import Episodes
from charms_bench.world.scene import SceneSettings


class _Road(NamedTuple):
    places: int
    """For vehicles and obstacles."""
    lanes: int
    """The most lanes beside each other."""
    ego_speed: float
    """The speed of the ego at the start, m/s."""


@lru_cache
def _road(name: str) -> _Road:
    if name not in OF_SUITES:
        raise InputError(f"no road named '{name}'. {suggestion(name, dict.fromkeys(OF_SUITES))}")
    episodes = Episodes(name, 1)
    episodes.seed(episodes.everyone, np.zeros(1, dtype=np.uint64))
    episodes.start(episodes.everyone)
    scenes = episodes.scenes
    lanes = int(scenes.road.lanes["lanes"].max())
    return _Road(scenes.vehicles.shape[1], lanes, float(scenes.vehicles["speed"][0, 0]))


def on_road(settings: SceneSettings, name: str) -> SceneSettings:
    """The same settings for scenes of the environment of highway-env with that name.

    Raises:
        InputError: There is no such road, or the settings place vehicles in another way.
    """
    road = _road(name)
    for field in ("inflow", "recording", "vehicle_types", "ego_type"):
        if getattr(settings, field):
            raise InputError(f"the road '{name}' has its own vehicles; remove scene.{field}")
    changes = {"network": name, "lanes": road.lanes, "traffic_vehicles": road.places - 1}
    return settings.model_copy(update={**changes, "ego_slots": 1})


def problem_of_driver(agent: Agent, settings: SceneSettings) -> str:
    """Why an agent cannot drive on the road of some settings; empty if it can."""
    assert settings.network is not None
    speed, least = _road(settings.network).ego_speed, settings.profile.target_speed_min_mps
    if isinstance(agent, DriverModel):
        return ""
    if agent.rollouts_with:
        return "it plans on copies of a straight road"
    if agent.actions == "meta" and speed < least:
        return (
            f"it commands target speeds from {least:g} m/s, and the ego starts at {speed:g} m/s; "
            "see scene.profile.target_speed_min_mps"
        )
    return ""
