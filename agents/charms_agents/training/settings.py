"""Training suites: which networks are trained, and how, from YAML."""

import math
from collections.abc import Mapping
from graphlib import TopologicalSorter
from typing import Annotated, Any, Literal

from pydantic import AfterValidator, BeforeValidator, Field, model_validator

from charms_agents.human.samples import Interface, SampleSettings
from charms_agents.human.soft_labels import columns_of
from charms_agents.training.completed_reward import CompletedReward, RewardScales, style_numbers
from charms_agents.training.hyperparameters import Count, Hyperparameters, Supervised, Width
from charms_agents.training.rewards import SVO_ANGLES_RAD, StyleReward, Svo, Weights
from charms_bench.envs.learners import Reward
from charms_bench.errors import InputError
from charms_bench.foundation.fields import FilePath, FrozenModel, Line, Positive
from charms_bench.plugins.deciding import delay_of
from charms_bench.plugins.specs import AgentSpec, TrafficSpec
from charms_bench.plugins.traffic import OneAgent, Traffic
from charms_bench.runs.suite_roads import RoadEntry
from charms_bench.world.action_texts import MetaActionsField
from charms_bench.world.actions import DEFAULT_ACTIONS, MetaAction, with_speed_steps
from charms_bench.world.kinematics_observation import Kinematics
from charms_bench.world.named_road import DRAWN, ENVIRONMENT
from charms_bench.world.observations import NamedObservation, named_observation
from charms_bench.world.recorded_moments import RecordedScene
from charms_bench.world.scenario import PRESCRIBED
from charms_bench.world.scene import ProfileLike, SceneSettings

FIRST_TRAINING_SEED = 2**40
"""Trainings use seeds from here on; evaluations use seeds below 10^9, so none coincide."""
EPISODES_OF_A_SEED = 2**32
"""The seed of training episode k is FIRST_TRAINING_SEED + seed * EPISODES_OF_A_SEED + k."""

Name = Annotated[str, Field(pattern=r"^[a-z][a-z0-9_]{0,63}$")]
Names = Annotated[
    tuple[Name, ...],
    BeforeValidator(lambda value: (value,) if isinstance(value, str) else value),
    Field(strict=False, max_length=20),
]
"""Some names; a name alone is one of them."""
Angle = Annotated[float, Field(ge=-math.pi, le=math.pi)]


class Condition(FrozenModel):
    """What differs from a stage's scene and traffic in a part of its episodes."""

    lanes: Annotated[int, Field(ge=2, le=8)] | None = None
    density: Positive | None = None
    duration_s: Positive | None = None
    profile: ProfileLike | None = None
    ego_slots: Annotated[int, Field(ge=1)] | None = None
    """How many of the first vehicles can be the ego, by default 1 on roads; all of them, if there
    are fewer. Scenarios and recorded scenes say themselves which vehicle the ego is."""
    traffic: TrafficSpec | None = None
    """A scenario's `points` are `random`, because trainings have other seeds than evaluations."""
    roads: (
        Annotated[tuple[RoadEntry, ...], Field(strict=False, min_length=1, max_length=100)] | None
    ) = None
    """Roads as in the suite of an evaluation; the condition counts once for each of them."""

    @model_validator(mode="after")
    def _points_are_drawn(self) -> "Condition":
        scenario = self.traffic and self.traffic.scenario
        if scenario and scenario.points != "random":
            raise ValueError("traffic.scenario.points: expected random, for episodes of a training")
        return self

    @property
    def by_road(self) -> tuple["Condition", ...]:
        """The condition of each road; itself on the straight road."""
        return tuple(self.model_copy(update={"roads": (road,)}) for road in self.roads or ()) or (
            self,
        )

    def applied(self, scene: SceneSettings, traffic: TrafficSpec) -> SceneSettings:
        """The scene of these episodes, with the traffic's scenario, on the first of the roads.

        Raises:
            InputError: The road does not exist, its configuration is wrong, or the ego is given
                and cannot be one of several vehicles.
        """
        configurations = [road.configuration or {} for road in (self.roads or ())[:1]]
        is_recorded = any(each.get("start", DRAWN) != DRAWN for each in configurations)
        if self.ego_slots is not None and (is_recorded or traffic.scenario is not None):
            what = "the recorded scene" if is_recorded else "the scenario"
            raise InputError(f"{what} says which vehicle the ego is; remove ego_slots")
        names = {"lanes", "density", "duration_s", "profile"}
        changes = self.model_dump(include=names, exclude_none=True)
        if self.ego_slots is not None and not self.roads:
            changes["ego_slots"] = min(self.ego_slots, 1 + scene.traffic_vehicles)
        found = SceneSettings.model_validate({**scene.model_dump(), **changes})
        for road in (self.roads or ())[:1]:
            from charms_bench.roads.settings import on_road  # slow to import

            found = on_road(found, road.road, road.duration_s, traffic.scenario)
            slots = min(self.ego_slots or 1, 1 + found.traffic_vehicles)
            return found.model_copy(update={"ego_slots": slots})
        return found.of_scenario(traffic.scenario)


class StageStyle(FrozenModel):
    """The style in which a network drives."""

    weights: Name
    """A name in the suite's `weights`."""
    svo: Svo
    svo_angle_rad: Angle | None = None
    """phi of eq. 8; by default, the angle of `svo`."""

    @property
    def angle_rad(self) -> float:
        """phi of eq. 8."""
        return SVO_ANGLES_RAD[self.svo] if self.svo_angle_rad is None else self.svo_angle_rad


class Stage(FrozenModel):
    """A network that learns by reinforcement: its style (weights and SVO), scene and traffic."""

    steps: Count
    weights: Name | None = None
    svo: Svo | None = None
    svo_angle_rad: Angle | None = None
    styles: dict[Name, StageStyle] = Field(default={}, max_length=100)
    """Instead of `weights` and `svo`, the styles of a network that is given the style in which it
    drives."""
    scene: RecordedScene = SceneSettings()
    traffic: TrafficSpec
    """The traffic. A name means a stage of this file, which can be this one, or else an installed
    agent or traffic; a name that ends in `.onnx` is the path of a network, from the suite file's
    folder."""
    conditions: Names = ()
    """Names in the suite's `conditions`, among which environments are divided equally."""
    prior: Name | None = None
    """The stage under `human` whose network is the prior that regularises this one."""
    reward: RewardScales | None = None
    """What completes the paper's reward; without it, the reward is the paper's."""

    @model_validator(mode="after")
    def _has_a_style(self) -> "Stage":
        given = {name for name in ("weights", "svo") if getattr(self, name) is not None}
        if given != (set() if self.styles else {"weights", "svo"}):
            raise ValueError("expected weights and svo, or styles instead")
        if self.styles and self.reward is None:
            raise ValueError("the paper's reward is of one style; expected a reward beside styles")
        return self

    @property
    def all_styles(self) -> Mapping[str, StageStyle]:
        """The styles in which its network drives, by name; that of one style has no name."""
        if self.weights is None or self.svo is None:
            return self.styles
        angle = self.svo_angle_rad
        return {"": StageStyle(weights=self.weights, svo=self.svo, svo_angle_rad=angle)}

    def reward_of(self, weights: Mapping[str, Weights]) -> Reward[Any]:
        """The reward of this stage with the suite's weights."""
        of_styles = [weights[style.weights] for style in self.all_styles.values()]
        angles = [style.angle_rad for style in self.all_styles.values()]
        if self.reward is None:
            return StyleReward(of_styles[0], angles[0])
        return CompletedReward(of_styles, angles, self.reward)


class HumanStage(FrozenModel):
    """A network that learns from human driving."""

    fine_tunes: Name | None = None
    """The stage whose network is fine-tuned; by default an untrained network imitates."""
    settings: Supervised | None = None
    """By default, `fine_tuning` or `imitation` of the suite."""
    drivers: Literal["recorded", "simulated"] = "recorded"
    """Whether it learns from the recordings, or from simulated calibrated drivers."""
    hidden_layers: Annotated[tuple[Width, ...], Field(strict=False, max_length=8)] | None = None
    """Of an untrained network; by default, those of the suite's `hyperparameters`."""


class SimulatedDrivers(FrozenModel):
    """Calibrated drivers who drive the egos of simulated episodes; see `human.simulated`."""

    agents: Annotated[tuple[AgentSpec, ...], Field(strict=False, min_length=1, max_length=20)]
    """Installed driver models."""
    scene: RecordedScene
    traffic: TrafficSpec
    conditions: Names = ()
    """Names in the suite's `conditions`."""
    episodes: Annotated[int, Field(ge=2, le=10_000)]
    """Episodes of each agent in each condition; a tenth of them is held out."""


class Human(FrozenModel):
    """Recordings of human driving, and the networks that learn from them."""

    recordings: FilePath
    """Folder of recordings; a relative path starts at the suite file's folder."""
    samples: SampleSettings = SampleSettings()
    simulated: SimulatedDrivers | None = None
    """For the stages that learn from simulated drivers."""
    fine_tuning: Supervised = Supervised()
    imitation: Supervised = Supervised(learning_rate=3e-4, epochs=40, pull=0.0)
    stages: Annotated[dict[Name, HumanStage], Field(min_length=1, max_length=100)]

    def settings_of(self, stage: HumanStage) -> Supervised:
        """The settings of a stage."""
        return stage.settings or (self.fine_tuning if stage.fine_tunes else self.imitation)


def _learnt(observation: str | dict[str, Any]) -> str | dict[str, Any]:
    """Rejects an observation from which the pipeline's networks cannot learn."""
    try:
        found = named_observation(observation)
    except InputError as error:
        raise ValueError(str(error)) from error
    if isinstance(found, Kinematics) or getattr(found, "action_mask", False):
        raise ValueError(
            "expected neighbours or paper_neighbours, without an action mask, or interaction"
        )
    return observation


class TrainingSuite(FrozenModel):
    """A training: its stages, each named like the network that it makes."""

    pipeline: Literal["charms"]
    title: Line = ""
    seed: Annotated[int, Field(ge=0, lt=2**23)] = 0
    observation: Annotated[str | dict[str, Any], AfterValidator(_learnt)] = "neighbours"
    """What the networks observe: `paper_neighbours`, as in the paper, or `neighbours`, each with
    the option `commands`; or `interaction`, on all roads."""
    actions: MetaActionsField = DEFAULT_ACTIONS
    """The meta-actions of all networks: names of highway-env's, and objects with a `name` and what
    the action does, such as `{name: BRAKE, speed_from_present_mps: -6.0}`; see
    `charms_bench.world.actions.MetaAction`. Steps of the profile become the network's own."""
    hyperparameters: Hyperparameters = Hyperparameters()
    curve_steps: Count = 10_000
    """Steps between two points of the learning curve."""
    checkpoint_s: Positive = 60.0
    """Seconds between two checkpoints."""
    weights: dict[Name, Weights]
    conditions: dict[
        Name, Annotated[tuple[Condition, ...], Field(strict=False, min_length=1, max_length=100)]
    ] = Field(default={})
    """Conditions in which stages learn side by side, which they can name."""
    stages: Annotated[dict[Name, Stage], Field(min_length=1, max_length=100)]
    """Stages of reinforcement learning; `like` names a stage to copy missing settings from."""
    human: Human | None = None

    @model_validator(mode="after")
    def _keywords_are_no_stages(self) -> "TrainingSuite":
        for name in self.names & {ENVIRONMENT, PRESCRIBED}:
            raise ValueError(f"'{name}' is no agent: expected another name of the stage")
        return self

    @model_validator(mode="after")
    def _people_take_the_actions(self) -> "TrainingSuite":
        if self.human is not None:
            try:
                columns_of(self.actions)
            except InputError as error:
                raise ValueError(str(error)) from error
        sees_at_once = any(
            stage.drivers == "recorded" or stage.fine_tunes for stage in self.human_stages.values()
        )
        if sees_at_once and delay_of(self.observed):
            raise ValueError(
                "observation: delay_decisions has no meaning for stages that learn from recordings "
                "or fine-tune; expected human.stages with `drivers: simulated`, or no delay"
            )
        return self

    def actions_in(self, scene: SceneSettings) -> tuple[MetaAction, ...]:
        """The meta-actions of a network that learns in a scene, with the profile's steps."""
        steps = scene.profile.target_speed_steps_mps
        return with_speed_steps(*steps, actions=self.actions) if steps else self.actions

    @property
    def interface(self) -> Interface:
        """The meta-actions of recorded drivers, carried out as in the scene of the first stage."""
        first = next(iter(self.stages.values()))
        return Interface(self.actions, first.scene)

    @property
    def observed(self) -> NamedObservation:
        """The observation that `observation` describes."""
        return named_observation(self.observation)

    @property
    def first_episode_seed(self) -> int:
        """Seed of the first training episode of each stage."""
        return FIRST_TRAINING_SEED + self.seed * EPISODES_OF_A_SEED

    @property
    def first_simulated_seed(self) -> int:
        """Seed of the first episode of simulated drivers, beyond those of the stages."""
        return self.first_episode_seed + EPISODES_OF_A_SEED - 2**27

    def styles_of(self, stage: Stage) -> dict[str, tuple[float, ...]]:
        """What a network is given of each of its styles, if it drives in several."""
        return {
            name: style_numbers(self.weights[style.weights], style.angle_rad)
            for name, style in stage.styles.items()
        }

    def name_of(self, stage: Stage) -> str:
        """The name of a stage."""
        return next(name for name, each in self.stages.items() if each is stage)

    @property
    def human_stages(self) -> dict[str, HumanStage]:
        """The stages that learn from human driving."""
        return self.human.stages if self.human else {}

    @property
    def names(self) -> set[str]:
        """The names of all stages."""
        return {*self.stages, *self.human_stages}

    def traffic_of(self, traffic: TrafficSpec) -> Traffic:
        """The traffic of a stage.

        Raises:
            InputError: The traffic is not installed, or does not take the options.
        """
        if traffic.name in self.names and not traffic.options:
            return OneAgent(traffic.name)
        return traffic.make()

    def conditions_of(self, stage: Stage | SimulatedDrivers) -> tuple[Condition, ...]:
        """What differs between the episodes in which a stage learns."""
        named = (each for name in stage.conditions for each in self.conditions[name])
        return tuple(road for each in named for road in each.by_road) or (Condition(),)

    def places_of(self, stage: Stage | SimulatedDrivers) -> list[tuple[SceneSettings, Traffic]]:
        """The scenes and traffic models in which a stage learns; see `traffic_of`."""
        found = []
        for each in self.conditions_of(stage):
            traffic = each.traffic or stage.traffic
            found.append((each.applied(stage.scene, traffic), self.traffic_of(traffic)))
        return found

    def drivers_of(self, stage: Stage | SimulatedDrivers) -> tuple[str, ...]:
        """The names of all agents in the traffic models of a stage; see `traffic_of`."""
        agents = (traffic.agents for _, traffic in self.places_of(stage))
        named = dict.fromkeys(name for names in agents for name in names)
        return tuple(name for name in named if name != PRESCRIBED)

    @property
    def needs(self) -> dict[str, tuple[str, ...]]:
        """All stages, with the stages whose networks each of them needs."""
        needed = {}
        for name, stage in self.stages.items():
            others = self.names - {name}  # what it trains itself can be in its traffic
            needed[name] = tuple(each for each in self.drivers_of(stage) if each in others)
            if stage.prior is not None:
                needed[name] += (stage.prior,)
        for name, human in self.human_stages.items():
            needed[name] = (human.fine_tunes,) if human.fine_tunes else ()
        return needed

    @property
    def order(self) -> tuple[str, ...]:
        """The names of all stages, each after the stages that it needs."""
        return tuple(TopologicalSorter(self.needs).static_order())

    def needed_for(self, name: str) -> tuple[str, ...]:
        """The names of a stage and of all stages that it needs, in order."""
        needs, needed = self.needs, {name}
        for later in reversed(self.order):
            if later in needed:
                needed.update(needs[later])
        return tuple(each for each in self.order if each in needed)
