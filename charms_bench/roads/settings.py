"""The settings of scenes on a road of highway-env, and the agents that can drive there."""

import math
from collections.abc import Collection
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from charms_bench.errors import InputError, suggestion
from charms_bench.plugins.agent import Agent, DriverModel
from charms_bench.roads import OF_SEVERAL_EGOS, OF_SUITES, TASKS
from charms_bench.roads.defaults import DEFAULTS
from charms_bench.roads.episodes import episodes_of_agents
from charms_bench.roads.layout import Layout
from charms_bench.roads.scenes import OBSTACLE
from charms_bench.world.highway_env_observation import HighwayEnv
from charms_bench.world.kinematics_observation import Kinematics
from charms_bench.world.named_road import NamedRoad
from charms_bench.world.observations import observation_of
from charms_bench.world.profile import Profile
from charms_bench.world.recorded_moments import Moments
from charms_bench.world.scenario import Scenario
from charms_bench.world.scene import SceneSettings

_OF_STRAIGHT_ROADS = {
    "recording": (),
    "lanes": ("lanes_count", "no_lanes", "roundabout_lanes"),
    "traffic_vehicles": ("vehicles_count", "other_vehicles", "initial_vehicle_count", "density"),
    "density": ("vehicles_density", "density"),
    "ego_slots": (),
}
"""What a suite says of its scenes, but a road decides itself, and the keys of roads for it."""
SIMULATION_HZ = 15
"""At which the start of an episode is looked at: few roads simulate before it."""
_OF_SCENES = {
    "action": "the agents of a suite have their own actions",
    "observation": "the agents of a suite have their own observations",
    "simulation_frequency": "give scene.simulation_hz",
    "policy_frequency": "give scene.decision_hz",
    "duration": "give duration_s beside the road's name",
    "file": "give file beside the configuration",
    "sha256": "it is that of the file",
}
"""Keys of highway-env's configuration that a suite says in another way."""
_MOST = {
    **dict.fromkeys(("vehicles_count", "other_vehicles", "initial_vehicle_count"), 2000),
    **dict.fromkeys(("lanes_count", "no_lanes", "roundabout_lanes"), 50),
    "controlled_vehicles": 50,
}
"""The largest values of keys, so that scenes fit into memory."""
ONLY_EGOS = "a policy with the observation highway_env drives egos only"
LARGEST = 10_000
"""That of all other keys."""


class _Road(NamedTuple):
    places: int
    """For vehicles and obstacles."""
    lanes: int
    """The most lanes beside each other."""
    lane_width: float
    """That of the ego's lane at the start, m."""
    ego_speed: float
    """The speed of the ego at the start, m/s."""
    others_speed: float
    """The lowest target speed of another vehicle at the start of episode 0, m/s."""
    duration: float
    """Of an episode, at most, s; infinite if highway-env truncates none."""
    moments: Moments | None
    """Of a recorded scene."""
    no_inflow: str
    """Why vehicles cannot flow in; empty if they can."""
    egos: int
    vehicles: int
    """The places of vehicles, with the egos."""
    layout: Layout
    home: tuple[str, str] | None
    """The nodes of the road where the ego starts; None if it is drawn."""


def _check(road: NamedRoad) -> None:
    """Raises an `InputError` if a road is none of suites, or its configuration is not its own."""
    if road.file is not None and road.name in TASKS:
        raise InputError(
            f"name: '{road.name}' is one of highway-env's roads; give the road of a file another "
            "name, or none"
        )
    of_suites = (*OF_SUITES, *OF_SEVERAL_EGOS)
    if road.file is None and road.name not in of_suites:
        known = suggestion(road.name, dict.fromkeys(of_suites))
        raise InputError(f"no road named '{road.name}'. {known}")
    for key, value in (road.configuration or {}).items():
        if key in _OF_SCENES:
            raise InputError(f"configuration.{key}: {_OF_SCENES[key]}")
        most = _MOST.get(key, LARGEST)
        if isinstance(value, int | float) and not abs(value) <= most:
            raise InputError(f"configuration.{key}: {value}; expected at most {most:,}")


@lru_cache
def _road(road: NamedRoad) -> _Road:
    try:
        episodes = episodes_of_agents(road, 1, SIMULATION_HZ)
    except InputError as error:
        raise InputError(str(error).replace("config", "configuration", 1)) from error
    episodes.seed(episodes.everyone, np.zeros(1, dtype=np.uint64))
    episodes.start(episodes.everyone)
    scenes = episodes.scenes
    lanes = int(scenes.road.lanes["lanes"].max())
    others = scenes.vehicles[0, 1:]
    slowest = others["target_speed"][others["kind"] > OBSTACLE].min(initial=math.inf)
    speed = scenes.vehicles["speed"][0, 0]
    width = scenes.road.lanes["width"][scenes.vehicles["lane"][0, 0]]
    places = scenes.vehicles.shape[1]
    no_inflow = "" if episodes.task.starts.size else "each of its lanes begins where another ends"
    if "spawn_probability" in episodes.config:
        no_inflow = "vehicles come to it anyway, by its configuration.spawn_probability"
    task, numbers = episodes.task, (float(width), float(speed), float(slowest))
    of_task = task.egos, task.vehicles, task.layout
    names = list(task.lanes)
    home = None if road.file else names[int(scenes.vehicles["lane"][0, 0])][:2]
    return _Road(places, lanes, *numbers, task.duration, task.moments, no_inflow, *of_task, home)


def layout_on(settings: SceneSettings) -> tuple[Layout, tuple[str, str] | None]:
    """The lanes of a road, and the nodes of the one where its ego starts; None if it is drawn."""
    assert settings.network is not None
    found = _road(settings.network)
    return found.layout, found.home


def egos_on(settings: SceneSettings) -> int:
    """The number of vehicles in a scene that the agent of the ego drives."""
    return 1 if settings.network is None else _road(settings.network).egos


def room_on(settings: SceneSettings) -> int:
    """How many vehicles there is room for beside those of the road itself."""
    assert settings.network is not None
    return settings.vehicles - _road(settings.network).places


def reject_of_straight_roads(road: NamedRoad, given: Collection[str]) -> None:
    """Raises an `InputError` if one of the given keys of a scene is for straight roads only."""
    for field, keys in _OF_STRAIGHT_ROADS.items():
        if field in given:
            own = [key for key in keys if key in DEFAULTS.get(road.environment, {})]
            instead = f", or give the road configuration.{own[0]} instead" if own else ""
            if field == "recording":
                instead = ". Recorded vehicles drive on the lanes where they were recorded: give "
                instead += "{file: scene.xml, configuration: {start: recorded}} as the road"
            raise InputError(
                f"the road '{road}' has its own lanes and vehicles; remove scene.{field}{instead}"
            )


def on_road(
    settings: SceneSettings,
    road: NamedRoad,
    duration_s: float | None = None,
    scenario: Scenario | None = None,
) -> SceneSettings:
    """The same settings for scenes on one of highway-env's roads.

    By default, the duration is that of the settings, and the vehicles are those of the road.

    Raises:
        InputError: There is no such road, its configuration is wrong, or the settings place
            vehicles in another way.
    """
    _check(road)
    duration_s = settings.duration_s if duration_s is None else duration_s
    own = {"duration": duration_s}  # which decides how many vehicles there is room for
    own |= {"spawn_probability": 0.0} if scenario is not None else {}
    if own := {key: each for key, each in own.items() if key in DEFAULTS[road.environment]}:
        road = road.model_copy(update={"configuration": {**(road.configuration or {}), **own}})
    found, defaults = _road(road), SceneSettings.model_fields
    reject_of_straight_roads(
        road, [name for name, value in settings if value != defaults[name].default]
    )
    if settings.inflow and found.no_inflow:
        raise InputError(f"scene.inflow: nothing flows into '{road}': {found.no_inflow}; remove it")
    changes = {"network": road, "lanes": found.lanes, "traffic_vehicles": found.places - 1}
    changes |= {"duration_s": duration_s, "ego_slots": 1}
    if found.moments is not None:
        decisions = math.floor(found.duration * settings.decision_hz + 1e-9)
        if decisions < 1:
            raise InputError(
                f"the road '{road}': its scene of {found.duration:g} s is shorter than a decision; "
                "give a higher scene.decision_hz"
            )
        # The sum of the intervals may be less than their product.
        changes["duration_s"] = decisions / settings.decision_hz - 1e-6
    if found.lane_width != settings.profile.lane_width_m:
        width = {"lane_width_m": found.lane_width}
        changes["profile"] = settings.profile.model_copy(update=width)
    settings = settings.model_copy(update=changes)
    if scenario is None:
        return settings
    if found.moments is not None:
        what = "a scenario places all vehicles; remove configuration.start"
        raise InputError(f"the road '{road}': {what}")
    if found.egos > 1:
        raise InputError(
            f"the road '{road}': a scenario has one ego, and the road {found.egos}; expected one, "
            "as on intersection-v1, or configuration.controlled_vehicles: 1"
        )
    room = max(0, len(scenario.vehicles) + 1 - found.vehicles)
    count = {"traffic_vehicles": found.places + room - 1}
    return settings.of_scenario(scenario).model_copy(update=count)


def moments_on(road: NamedRoad) -> Moments:
    """The moments at which episodes start in the recorded scene of a road."""
    found = _road(road).moments
    assert found is not None
    return found


def problem_of_driver(agent: Agent, is_ego: bool = True) -> str:
    """Why an agent cannot drive on a road, the ego or the traffic; empty if it can."""
    if isinstance(agent, DriverModel):
        return ""
    if isinstance(observation_of(agent.observation), HighwayEnv) and not is_ego:
        return ONLY_EGOS
    if agent.weights_sha256 and isinstance(observation_of(agent.observation), Kinematics):
        return (
            "a network of highway-env's Kinematics receives on this road neither the ranges nor "
            "the target speeds of the environment that it was trained in; export it again with "
            "the name of that environment as `charms-bench export --environment`"
        )
    return ""


def profiles_of(settings: SceneSettings) -> tuple[Profile, Profile]:
    """The profile whose target speeds policies choose on a road: of the ego, and of other vehicles.

    They begin at the first speed of the ego, and at the lowest target speed of another vehicle, if
    those of the scene's profile are above it.
    """
    assert settings.network is not None
    road, profile = _road(settings.network), settings.profile
    return profile.beginning_at(road.ego_speed), profile.beginning_at(road.others_speed)
