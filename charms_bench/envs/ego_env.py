"""The environment `charms_bench/Ego-v0`, alone and as a vector environment."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from gymnasium.vector import AutoresetMode
from pydantic import ValidationError

from charms_bench.envs import ID
from charms_bench.envs.base_env import SingleEnv
from charms_bench.envs.given_actions import GivenLike
from charms_bench.envs.highway_reward import HighwayReward
from charms_bench.envs.learners import Learners, Reward
from charms_bench.envs.progress_reward import ProgressReward
from charms_bench.envs.scene_episodes import OfScenes, SceneEpisodes
from charms_bench.envs.vector_env import HighwayVectorEnv
from charms_bench.errors import InputError, problem_in
from charms_bench.plugins.agent import Agent
from charms_bench.plugins.registry import make_agent, make_traffic
from charms_bench.plugins.specs import TrafficSpec
from charms_bench.plugins.traffic import Mixture, Traffic
from charms_bench.world.named_road import ENVIRONMENT, NamedRoad
from charms_bench.world.observations import ObservationLike, observation_of
from charms_bench.world.profile import ROADS
from charms_bench.world.recorded_moments import scene_of
from charms_bench.world.scenario import PRESCRIBED
from charms_bench.world.scene import SceneSettings

TrafficLike = str | Mapping[str, Any] | Traffic
"""A traffic model, its name or an agent's, proportions of agents such as `{"idm_mobil": 1.0}`,
or what a suite gives as `traffic`: `{"name": ..., "options": ...}`, `{"mixture": ...}`, or
`{"scenario": ...}`. The path of an ONNX file is the name of an agent."""


class EgoEnv(OfScenes, SingleEnv):
    """One episode after another; the actions given to `step` drive the ego.

    The episodes are those of a suite: `reset(seed=k)` starts the episode with seed k. Without a
    seed, one is drawn that no suite evaluates on. An episode terminates when the ego collides or
    leaves the road, and is truncated when its time is over. The state of `get_state` and of the
    option `state` of `reset` is a `SceneState`.

    The info of `reset` contains the `seed`. With meta-actions, every info contains the
    `action_mask` (A,) of the next step, which `action_space.sample` takes; see `world.action_mask`.
    The last one contains the `ending`, one of `engine.simulation.ENDINGS`. Continuous actions are
    clipped.

    Args:
        traffic: Assigns a driver to each of the other vehicles; by default `idm_mobil`, and on a
            road of highway-env the vehicles that it has itself.
        reward: The reward of a decision; by default highway-env's, see `HighwayReward`, and for
            continuous actions the progress along the road, see `ProgressReward`.
        observation: The ego's observation; see `charms_bench.world.observations`.
        actions: `meta` for highway-env's five, `continuous` for an acceleration and a steering
            angle, or a list of meta-actions such as `[*DEFAULT_ACTIONS, MetaAction("BRAKE",
            speed_from_present_mps=-6.0)]`; see `charms_bench.world.action_texts`.
        longitudinal: Whether actions change the speed, as in highway-env's configuration.
        lateral: Whether actions change the lane, or steer.
        render_mode: `rgb_array` or `human`; see `render`.
        scene: `density`, `lanes`, `traffic_vehicles`, `profile` and all other keys of a suite's
            `scene`, with the same defaults, also together as `scene={...}`; and `road`, one of
            highway-env's by its name, or `{"name": ..., "configuration": {...}}`. There, the
            traffic `environment` are the vehicles that the road has itself.

    Raises:
        InputError: The traffic is not installed, or the scene, the observation, the kind of
            actions or the render mode is wrong.
    """

    def __init__(
        self,
        traffic: TrafficLike | None = None,
        reward: Reward[Any] | None = None,
        observation: ObservationLike = "neighbours",
        actions: GivenLike = "meta",
        render_mode: str | None = None,
        longitudinal: bool = True,
        lateral: bool = True,
        **scene: Any,
    ) -> None:
        settings, around, agents = surroundings(traffic, scene, ID)
        how = (around, agents, reward or reward_of(actions, settings), observation_of(observation))
        learners = Learners(settings, 1, (0,), *how, ID, actions, longitudinal, lateral)
        super().__init__(SceneEpisodes(learners), render_mode)


def ego_vector_env(
    num_envs: int,
    traffic: TrafficLike | None = None,
    reward: Reward[Any] | None = None,
    observation: ObservationLike = "neighbours",
    actions: GivenLike = "meta",
    render_mode: str | None = None,
    longitudinal: bool = True,
    lateral: bool = True,
    autoreset_mode: AutoresetMode | str = AutoresetMode.SAME_STEP,
    first_seed: int | None = None,
    **scene: Any,
) -> HighwayVectorEnv[Any]:
    """Many episodes simulated together; see `EgoEnv` and `HighwayVectorEnv`."""
    settings, around, agents = surroundings(traffic, scene, ID)
    return HighwayVectorEnv(
        settings,
        num_envs,
        around,
        agents,
        reward or reward_of(actions, settings),
        first_seed,
        observation_of(observation),
        actions,
        render_mode,
        longitudinal,
        lateral,
        autoreset_mode,
    )


def reward_of(actions: GivenLike, settings: SceneSettings) -> Reward[Any]:
    """The default reward of actions in some scenes."""
    is_progress = actions == "continuous" or settings.network is not None
    return ProgressReward() if is_progress else HighwayReward()


def surroundings(
    traffic: TrafficLike | None, scene: dict[str, Any], environment: str
) -> tuple[SceneSettings, Traffic, dict[str, Agent]]:
    """The settings with the keys of a suite's `scene`, a traffic model, and its agents by name.

    Raises:
        InputError: The traffic is not installed, or a key or a value is wrong; the message begins
            with the environment's name.
    """
    keys = {**scene.pop("scene", {}), **scene}
    plain = {k: each.item() if isinstance(each, np.generic) else each for k, each in keys.items()}
    road = plain.pop("road", None)
    if road is not None:
        from charms_bench.roads.defaults import duration_of  # slow to import, as the settings below

        plain = {"profile": ROADS.name, "duration_s": duration_of(road), **plain}
    if traffic is None:
        traffic = "idm_mobil" if road is None else ENVIRONMENT
    if isinstance(traffic, Mapping) and "road" in traffic:
        instead = f"scene={{'road': {traffic['road']!r}}}, "
        instead += f"traffic={traffic.get('drivers', ENVIRONMENT)!r}"
        raise InputError(f"{environment}: traffic: a road is no traffic model; give {instead}")
    try:
        settings, scenario = scene_of(plain), None
        if isinstance(traffic, Mapping) and {*traffic} & {*TrafficSpec.model_fields}:
            spec = TrafficSpec.model_validate(traffic)
            scenario, traffic = spec.scenario, spec.make()
        if road is not None:
            from charms_bench.roads.settings import (  # slow to import
                on_road,
                reject_of_straight_roads,
            )

            named = NamedRoad.model_validate({"name": road} if isinstance(road, str) else road)
            reject_of_straight_roads(named, plain)
            settings = on_road(settings, named, scenario=scenario)
        elif traffic == ENVIRONMENT:
            raise InputError(f"{environment}: traffic: '{ENVIRONMENT}' needs scene={{'road': ...}}")
        else:
            settings = settings.of_scenario(scenario)
    except ValidationError as error:
        raise InputError(f"{environment}: {problem_in(error)}") from error
    return settings, *made_traffic(traffic)


def made_traffic(traffic: str | Mapping[str, float] | Traffic) -> tuple[Traffic, dict[str, Agent]]:
    """A traffic model and its agents by name."""
    if isinstance(traffic, str):
        traffic = make_traffic(traffic)
    elif isinstance(traffic, Mapping):
        traffic = Mixture(traffic)
    elif not isinstance(traffic, Traffic):
        found = type(traffic).__name__
        raise InputError(f"traffic: found {found}, expected a name, a dictionary or a Traffic")
    driving = (name for name in traffic.agents if name != PRESCRIBED)
    return traffic, {name: make_agent(name) for name in driving}
