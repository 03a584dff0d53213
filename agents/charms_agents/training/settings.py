"""Training suites: which networks are trained, and how, from YAML."""

import math
from graphlib import CycleError, TopologicalSorter
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Field, model_validator

from charms_agents.human.samples import SampleSettings
from charms_agents.training.rewards import (
    FAILURE,
    SAFE_TTC_S,
    SVO_ANGLES_RAD,
    StyleReward,
    Svo,
    Weights,
)
from charms_bench.errors import InputError, RegistryError
from charms_bench.foundation.fields import FilePath, FrozenModel, Line, NonNegative, Positive
from charms_bench.plugins.onnx_policy import OnnxPolicy
from charms_bench.plugins.registry import AGENTS, find, is_network
from charms_bench.plugins.specs import TrafficSpec
from charms_bench.plugins.traffic import OneAgent, Traffic
from charms_bench.runs.document import Document
from charms_bench.world.observations import Neighbours, neighbours, paper_neighbours
from charms_bench.world.scene import SceneSettings

FIRST_TRAINING_SEED = 2**40
"""Trainings use seeds from here on; evaluations use seeds below 10^9, so none coincide."""
EPISODES_OF_A_SEED = 2**32
"""The seed of training episode k is FIRST_TRAINING_SEED + seed * EPISODES_OF_A_SEED + k."""
FIRST_VALIDATION_SEED = 950_000_000
"""Seed of the first validation episode of every training; evaluation suites use other seeds."""

Name = Annotated[str, Field(pattern=r"^[a-z][a-z0-9_]{0,63}$")]
Count = Annotated[int, Field(ge=1, le=10**9)]
Width = Annotated[int, Field(ge=1, le=4096)]
"""Number of neurons in a layer."""
Share = Annotated[float, Field(ge=0, le=1)]
Seed = Annotated[int, Field(ge=0, lt=2**23)]


class Validation(FrozenModel):
    """Which network a stage keeps, of those that it has at the end of its training.

    Each of these networks drives the ego of the same validation episodes. The stage keeps the
    fastest network within both limits. If no network is within both, it compares crashed episodes
    first, and then `ttc_below_3s`. Networks within a limit count as equal there.
    """

    last_steps: Count
    """Steps at the end of the training whose networks are compared."""
    every_steps: Count
    """Steps between two compared networks."""
    episodes: Annotated[int, Field(ge=1, le=10_000)]
    traffic: TrafficSpec
    """The traffic of the validation episodes; their scene is the stage's."""
    ttc_below_3s: Share
    """Limit of the metric of this name in the set `paper`."""
    crashed_episodes: Share
    """Limit of the share of episodes crashed."""


class Hyperparameters(FrozenModel):
    """Hyperparameters of Double DQN; a step is one decision of one ego."""

    learning_rate: Positive = 1e-4
    batch_size: Annotated[int, Field(ge=1, le=100_000)] = 32
    discount: Share = 0.99
    replay_buffer: Annotated[int, Field(ge=1, le=10_000_000)] = 50_000
    """Number of steps that are kept."""
    learning_starts: Annotated[int, Field(ge=0, le=10**9)] = 10_000
    """Steps before the first gradient step; their actions are random."""
    steps_per_gradient_step: Count = 2
    target_update_steps: Count = 500
    """Steps between two copies of the network to the target network."""
    exploration_initial: Share = 1.0
    exploration_final: Share = 0.05
    exploration_share: Share = 0.1
    """Share of all steps over which exploration falls from initial to final."""
    max_gradient_norm: Positive = 10.0
    hidden_layers: Annotated[tuple[Width, ...], Field(strict=False, max_length=8)] = (256, 256)
    scenes: Annotated[int, Field(ge=1, le=1000)] = 10
    """Number of episodes simulated at the same time."""
    return_steps: Count = 1
    """Number of rewards in a target before the value (n-step returns)."""
    target_update_rate: Annotated[float, Field(gt=0, le=1)] = 1.0
    """Weight of the network in an update of the target network; 1 copies it."""
    learning_rate_decay: Share = 0.0
    """Share of all steps, at the end, over which the learning rate falls to 0."""
    standardised: bool = False
    """Whether the network takes standardised observations, of order 1."""
    starts_at_mean_reward: bool = False
    """Whether the untrained network's values are raised to the mean reward of the first, random
    steps divided by 1 - discount. From 0, values rise slowly, because each target has the value of
    the next step."""

    @model_validator(mode="after")
    def _rates_fit(self) -> "Hyperparameters":
        """Checks the counts: they are in steps, and `scenes` steps are taken at once."""
        if self.scenes % self.steps_per_gradient_step:
            raise ValueError(
                f"scenes {self.scenes} is not a multiple of "
                f"steps_per_gradient_step {self.steps_per_gradient_step}"
            )
        for name in ("replay_buffer", "target_update_steps"):
            if getattr(self, name) % self.scenes:
                raise ValueError(
                    f"{name} {getattr(self, name)} is not a multiple of scenes {self.scenes}"
                )
        return self

    def learning_rate_at(self, remaining: float) -> float:
        """The learning rate when the share `remaining` of all steps remains."""
        if not self.learning_rate_decay:
            return self.learning_rate
        return self.learning_rate * min(remaining / self.learning_rate_decay, 1.0)

    def exploration_at(self, remaining: float) -> float:
        """The probability of a random action when the share `remaining` of all steps remains."""
        if 1 - remaining > self.exploration_share:
            return self.exploration_final
        fall = (1 - remaining) * (self.exploration_final - self.exploration_initial)
        return self.exploration_initial + fall / self.exploration_share

    @property
    def inputs(self) -> dict[str, Any]:
        """The hyperparameters, ready for JSON; unused options that the paper lacks are left out."""
        used = self.model_dump(include=OPTIONS, exclude_defaults=True)
        return self.model_dump(mode="json", exclude=OPTIONS - used.keys())


OPTIONS = {
    "return_steps",
    "target_update_rate",
    "learning_rate_decay",
    "standardised",
    "starts_at_mean_reward",
}
"""The options that the paper's Double DQN lacks; the default of each turns it off."""


class Supervised(FrozenModel):
    """Settings of learning from human driving; the defaults are the paper's fine-tuning."""

    learning_rate: Positive = 1e-6
    batch_size: Annotated[int, Field(ge=1, le=100_000)] = 128
    epochs: Count = 8
    pull: NonNegative = 0.2
    """Lambda of eq. 11: how strongly the weights are pulled back to their start."""
    label_floor: Annotated[float, Field(gt=0, le=0.1)] = 0.01
    """Smallest probability of an action in a label; at 0, eq. 11 would be infinite."""
    rehearsal: NonNegative = 0.0
    """Weight of the change of Q in the network's own driving; 0 in the paper."""
    learning_rate_decay: Share = 0.0
    """Share of all epochs, at the end, over which the learning rate falls to 0; 0 in the paper."""

    def learning_rate_at(self, epoch: int) -> float:
        """The learning rate of an epoch; epochs are counted from 1."""
        remaining = 1 - (epoch - 1) / self.epochs
        return self.learning_rate * min(1.0, remaining / (self.learning_rate_decay or remaining))


class Stage(FrozenModel):
    """A network that learns by reinforcement: its style (weights and SVO), scene and traffic."""

    steps: Count
    weights: Name
    """A name in the suite's `weights`."""
    svo: Svo
    svo_angle_rad: Annotated[float, Field(ge=-math.pi, le=math.pi)] | None = None
    """phi of eq. 8; by default, the angle of `svo`."""
    scene: SceneSettings = SceneSettings()
    traffic: TrafficSpec
    """The traffic. A name means a stage of this file, or else an installed agent or traffic; a name
    that ends in `.onnx` is the path of a network, from the suite file's folder."""
    variant: Name | None = None
    """A name in the suite's `variants`; by default, its `hyperparameters` apply."""
    safety_horizon_s: Positive = SAFE_TTC_S
    """Time to collision from which r_s counts the ego as safe."""
    safe_headway_m: NonNegative = 0.0
    """Headway from which r_s counts the ego as safe; 0, as in the paper, ignores headways."""
    safe_in_both_lanes: bool = False
    """Whether r_s also counts the leader in the lane that the ego leaves in a lane change."""
    lane_change_cost: NonNegative = 0.0
    """Cost of a decision to change lanes; 0 in the paper."""
    failure_reward: Annotated[float, Field(ge=-1e6, le=0)] = FAILURE
    """Reward of the decision in which the ego crashes or leaves the road."""
    validation: Validation | None = None
    """Which network is kept; by default the last one."""

    def reward(self, weights: Weights) -> StyleReward:
        """The reward of this stage with the weights that it names."""
        return StyleReward(
            weights,
            self.angle_rad,
            self.safety_horizon_s,
            self.safe_headway_m,
            self.safe_in_both_lanes,
            self.lane_change_cost,
            self.failure_reward,
        )

    @property
    def angle_rad(self) -> float:
        """phi of eq. 8."""
        return SVO_ANGLES_RAD[self.svo] if self.svo_angle_rad is None else self.svo_angle_rad


class HumanStage(FrozenModel):
    """A network that learns from human driving."""

    fine_tunes: Name | None = None
    """The stage whose network is fine-tuned; by default an untrained network imitates."""
    settings: Supervised | None = None
    """By default, `fine_tuning` or `imitation` of the suite."""


class Human(FrozenModel):
    """Recordings of human driving, and the networks that learn from them."""

    recordings: FilePath
    """Folder of recordings; a relative path starts at the suite file's folder."""
    samples: SampleSettings = SampleSettings()
    fine_tuning: Supervised = Supervised()
    imitation: Supervised = Supervised(learning_rate=3e-4, epochs=40, pull=0.0)
    stages: Annotated[dict[Name, HumanStage], Field(min_length=1, max_length=100)]

    def settings_of(self, stage: HumanStage) -> Supervised:
        """The settings of a stage."""
        return stage.settings or (self.fine_tuning if stage.fine_tunes else self.imitation)


class TrainingSuite(FrozenModel):
    """A training: its stages, each named like the network that it makes."""

    pipeline: Literal["charms"]
    title: Line = ""
    seed: Seed = 0
    seeds: Annotated[tuple[Seed, ...], Field(strict=False, max_length=100)] = ()
    """If given, every stage is trained once with each of these seeds instead of `seed`; the stages
    of a seed need only stages of the same seed."""
    observation: Literal["neighbours", "paper_neighbours"] = "neighbours"
    """What the networks observe: `paper_neighbours`, as in the paper, or `neighbours`."""
    hyperparameters: Hyperparameters = Hyperparameters()
    variants: dict[Name, Hyperparameters] = Field(default={})
    """Further hyperparameters, which stages can name."""
    curve_steps: Count = 10_000
    """Steps between two points of the learning curve."""
    checkpoint_s: Positive = 60.0
    """Seconds between two checkpoints."""
    weights: dict[Name, Weights]
    stages: Annotated[dict[Name, Stage], Field(min_length=1, max_length=100)]
    """Stages of reinforcement learning; `like` names a stage to copy missing settings from."""
    human: Human | None = None

    @model_validator(mode="after")
    def _seeds_differ(self) -> "TrainingSuite":
        if len(set(self.seeds)) < len(self.seeds):
            raise ValueError("a seed is given twice in seeds")
        return self

    @property
    def observed(self) -> Neighbours:
        """The observation of the name `observation`."""
        return paper_neighbours if self.observation == "paper_neighbours" else neighbours

    @property
    def first_episode_seed(self) -> int:
        """Seed of the first training episode of each stage."""
        return FIRST_TRAINING_SEED + self.seed * EPISODES_OF_A_SEED

    @property
    def by_seed(self) -> dict[str, "TrainingSuite"]:
        """The suite of each seed, by its folder in the run folder."""
        if not self.seeds:
            return {"": self}
        return {
            f"seed-{seed}": self.model_copy(update={"seed": seed, "seeds": ()})
            for seed in self.seeds
        }

    def hyperparameters_of(self, stage: Stage) -> Hyperparameters:
        """The hyperparameters of a stage."""
        return self.hyperparameters if stage.variant is None else self.variants[stage.variant]

    @property
    def human_stages(self) -> dict[str, HumanStage]:
        """The stages that learn from human driving."""
        return self.human.stages if self.human else {}

    @property
    def names(self) -> set[str]:
        """The names of all stages."""
        return {*self.stages, *self.human_stages}

    def traffic_of(self, stage: Stage) -> Traffic:
        """The traffic of a stage.

        Raises:
            InputError: The traffic is not installed, or does not take the options.
        """
        if stage.traffic.name in self.names and not stage.traffic.options:
            return OneAgent(stage.traffic.name)
        return stage.traffic.make()

    @property
    def needs(self) -> dict[str, tuple[str, ...]]:
        """All stages, with the stages whose networks each of them needs."""
        needed = {
            name: tuple(driver for driver in self.traffic_of(stage).agents if driver in self.names)
            for name, stage in self.stages.items()
        }
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


def load_training(path: Path, seed: int | None = None, steps: int | None = None) -> TrainingSuite:
    """Reads a training suite; `seed` and `steps` replace those in the file.

    Raises:
        SuiteError: The file is invalid, or a name in it does not exist.
    """
    document = Document(path)
    _resolve_likeness(document)
    if seed is not None:
        document.data |= {"seed": seed, "seeds": []}
    stages = document.data.get("stages")
    for stage in stages.values() if steps is not None and isinstance(stages, dict) else ():
        if isinstance(stage, dict):  # anything else is refused below
            stage["steps"] = steps
    suite = document.validate(TrainingSuite)
    for name, stage in suite.stages.items():
        at = ("stages", name)
        if stage.variant is not None and stage.variant not in suite.variants:
            there = f"this file has: {', '.join(suite.variants) or 'none'}"
            raise document.error((*at, "variant"), f"no variant named '{stage.variant}'; {there}")
        scenes = suite.hyperparameters_of(stage).scenes
        counts = [(stage.steps, (*at, "steps")), (suite.curve_steps, ("curve_steps",))]
        if stage.validation is not None:
            counts.append((stage.validation.every_steps, (*at, "validation", "every_steps")))
        for steps, where in counts:
            if steps % scenes:
                raise document.error(where, f"{steps} is not a multiple of scenes {scenes}")
        if stage.weights not in suite.weights:
            there = f"this file has: {', '.join(suite.weights) or 'none'}"
            raise document.error((*at, "weights"), f"no weights named '{stage.weights}'; {there}")
        try:
            for driver in suite.traffic_of(stage).agents:
                if is_network(driver):
                    OnnxPolicy(path.parent / driver)
                elif driver not in suite.names:
                    find(AGENTS, driver)
        except RegistryError as error:
            stages = f"Stages of this file: {', '.join((*suite.stages, *suite.human_stages))}."
            raise document.error((*at, "traffic"), f"{error} {stages}") from error
        except InputError as error:
            raise document.error((*at, "traffic"), str(error)) from error
    for name, human in suite.human_stages.items():
        place = ("human", "stages", name)
        if name in suite.stages:
            raise document.error(place, f"another stage is also named '{name}'")
        if human.fine_tunes is not None and human.fine_tunes not in suite.stages:
            there = f"this file has: {', '.join(suite.stages)}"
            what = f"no stage named '{human.fine_tunes}' under stages; {there}"
            raise document.error((*place, "fine_tunes"), what)
    try:
        suite.order  # noqa: B018  # raises
    except CycleError as error:
        what = f"stages depend on each other: {' <- '.join(error.args[1])}"
        raise document.error(("stages",), what) from error
    return suite


def _resolve_likeness(document: Document) -> None:
    """Copies missing settings into each stage that is `like` another stage."""
    stages = document.data.get("stages")
    if not isinstance(stages, dict):
        return
    said = dict(stages)
    for name, stage in said.items():
        if not isinstance(stage, dict) or "like" not in stage:
            continue
        model = said.get(stage["like"]) if isinstance(stage["like"], str) else None
        if not isinstance(model, dict) or "like" in model:
            what = f"no stage named '{stage['like']}' that is not itself like another"
            raise document.error(("stages", name, "like"), what)
        stages[name] = model | {key: value for key, value in stage.items() if key != "like"}
