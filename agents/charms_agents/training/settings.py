"""Training suites: which networks are trained, and how, from YAML."""

import math
from graphlib import CycleError, TopologicalSorter
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import (
    AfterValidator,
    Field,
    SerializerFunctionWrapHandler,
    model_serializer,
    model_validator,
)

from charms_agents.human.interface import DECISION_HZ, SIMULATION_HZ
from charms_agents.human.samples import SampleSettings
from charms_agents.training.completed_reward import CompletedReward, RewardScales
from charms_agents.training.rewards import SVO_ANGLES_RAD, StyleReward, Svo, Weights
from charms_bench.envs.learners import Reward
from charms_bench.errors import InputError, RegistryError
from charms_bench.foundation.fields import FilePath, FrozenModel, Line, NonNegative, Positive
from charms_bench.plugins.onnx_policy import OnnxPolicy
from charms_bench.plugins.registry import AGENTS, find, is_network
from charms_bench.plugins.specs import AgentSpec, TrafficSpec
from charms_bench.plugins.traffic import OneAgent, Traffic
from charms_bench.runs.document import Document
from charms_bench.world.observations import Neighbours, named_observation
from charms_bench.world.scene import SceneSettings

FIRST_TRAINING_SEED = 2**40
"""Trainings use seeds from here on; evaluations use seeds below 10^9, so none coincide."""
EPISODES_OF_A_SEED = 2**32
"""The seed of training episode k is FIRST_TRAINING_SEED + seed * EPISODES_OF_A_SEED + k."""

Name = Annotated[str, Field(pattern=r"^[a-z][a-z0-9_]{0,63}$")]
Count = Annotated[int, Field(ge=1, le=10**9)]
Width = Annotated[int, Field(ge=1, le=4096)]
"""Number of neurons in a layer."""
Share = Annotated[float, Field(ge=0, le=1)]
Seed = Annotated[int, Field(ge=0, lt=2**23)]


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
    prior_weight: NonNegative = 0.0
    """Lambda: what a stage with a `prior` pays per nat that its policy departs from the prior."""
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
    "prior_weight",
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
    loss: Literal["divergence", "cross_entropy"] = "divergence"
    """The divergence of the policy from the labels, as in eq. 11, or the cross-entropy, which is
    smallest where the policy has the labels' probabilities."""

    @model_serializer(mode="wrap")
    def _without_the_papers_loss(self, dump: SerializerFunctionWrapHandler) -> dict[str, Any]:
        """As before there was another loss: stages with the paper's keep their keys."""
        fields: dict[str, Any] = dump(self)
        if self.loss == "divergence":
            del fields["loss"]
        return fields

    def learning_rate_at(self, epoch: int) -> float:
        """The learning rate of an epoch; epochs are counted from 1."""
        remaining = 1 - (epoch - 1) / self.epochs
        return self.learning_rate * min(1.0, remaining / (self.learning_rate_decay or remaining))


class Condition(FrozenModel):
    """What differs from a stage's scene and traffic in a part of its episodes."""

    lanes: Annotated[int, Field(ge=2, le=8)] | None = None
    density: Positive | None = None
    duration_s: Positive | None = None
    traffic: TrafficSpec | None = None

    def applied(self, scene: SceneSettings) -> SceneSettings:
        """The scene of these episodes."""
        changes = self.model_dump(include={"lanes", "density", "duration_s"}, exclude_none=True)
        return SceneSettings.model_validate({**scene.model_dump(), **changes})


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
    conditions: Name | None = None
    """A name in the suite's `conditions`, among which the environments are divided equally."""
    prior: Name | None = None
    """The stage under `human` whose network is the prior that regularises this one."""
    reward: RewardScales | None = None
    """What completes the paper's reward; without it, the reward is the paper's."""

    def reward_of(self, weights: Weights) -> Reward[Any]:
        """The reward of this stage with the weights that it names."""
        if self.reward is None:
            return StyleReward(weights, self.angle_rad)
        return CompletedReward(weights, self.angle_rad, self.reward)

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
    drivers: Literal["recorded", "simulated"] = "recorded"
    """Whether it learns from the recordings, or from simulated calibrated drivers."""
    hidden_layers: Annotated[tuple[Width, ...], Field(strict=False, max_length=8)] | None = None
    """Of an untrained network; by default, those of the suite's `hyperparameters`."""


class SimulatedDrivers(FrozenModel):
    """Calibrated drivers who drive the egos of simulated episodes; see `human.simulated`."""

    agents: Annotated[tuple[AgentSpec, ...], Field(strict=False, min_length=1, max_length=20)]
    """Installed driver models."""
    scene: SceneSettings
    traffic: TrafficSpec
    conditions: Name | None = None
    """A name in the suite's `conditions`."""
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
    """Refuses an observation from which the pipeline's networks cannot learn."""
    try:
        found = named_observation(observation)
    except InputError as error:
        raise ValueError(str(error)) from error
    if not isinstance(found, Neighbours) or found.action_mask:
        raise ValueError("expected neighbours or paper_neighbours, without an action mask")
    return observation


class TrainingSuite(FrozenModel):
    """A training: its stages, each named like the network that it makes."""

    pipeline: Literal["charms"]
    title: Line = ""
    seed: Seed = 0
    seeds: Annotated[tuple[Seed, ...], Field(strict=False, max_length=100)] = ()
    """If given, every stage is trained once with each of these seeds instead of `seed`; the stages
    of a seed need only stages of the same seed."""
    observation: Annotated[str | dict[str, Any], AfterValidator(_learnt)] = "neighbours"
    """What the networks observe: `paper_neighbours`, as in the paper, or `neighbours`, each with
    the option `commands`."""
    hyperparameters: Hyperparameters = Hyperparameters()
    variants: dict[Name, Hyperparameters] = Field(default={})
    """Further hyperparameters, which stages can name."""
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
    def _seeds_differ(self) -> "TrainingSuite":
        if len(set(self.seeds)) < len(self.seeds):
            raise ValueError("a seed is given twice in seeds")
        return self

    @property
    def observed(self) -> Neighbours:
        """The observation that `observation` describes."""
        found = named_observation(self.observation)
        assert isinstance(found, Neighbours)
        return found

    @property
    def first_episode_seed(self) -> int:
        """Seed of the first training episode of each stage."""
        return FIRST_TRAINING_SEED + self.seed * EPISODES_OF_A_SEED

    @property
    def first_simulated_seed(self) -> int:
        """Seed of the first episode of simulated drivers, beyond those of the stages."""
        return self.first_episode_seed + EPISODES_OF_A_SEED - 2**27

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
        return self.conditions[stage.conditions] if stage.conditions else (Condition(),)

    def places_of(self, stage: Stage | SimulatedDrivers) -> list[tuple[SceneSettings, Traffic]]:
        """The scenes and traffics in which a stage learns; see `traffic_of`."""
        return [
            (each.applied(stage.scene), self.traffic_of(each.traffic or stage.traffic))
            for each in self.conditions_of(stage)
        ]

    def drivers_of(self, stage: Stage | SimulatedDrivers) -> tuple[str, ...]:
        """The names of all agents in the traffics of a stage; see `traffic_of`."""
        agents = (traffic.agents for _, traffic in self.places_of(stage))
        return tuple(dict.fromkeys(name for names in agents for name in names))

    @property
    def needs(self) -> dict[str, tuple[str, ...]]:
        """All stages, with the stages whose networks each of them needs."""
        needed = {}
        for name, stage in self.stages.items():
            needed[name] = tuple(each for each in self.drivers_of(stage) if each in self.names)
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
        h = suite.hyperparameters_of(stage)
        counts = [(stage.steps, (*at, "steps")), (suite.curve_steps, ("curve_steps",))]
        for steps, where in counts:
            if steps % h.scenes:
                raise document.error(where, f"{steps} is not a multiple of scenes {h.scenes}")
        if stage.conditions is not None:
            if stage.conditions not in suite.conditions:
                there = f"this file has: {', '.join(suite.conditions) or 'none'}"
                what = f"no conditions named '{stage.conditions}'; {there}"
                raise document.error((*at, "conditions"), what)
            if h.scenes % (count := len(suite.conditions[stage.conditions])):
                what = f"scenes {h.scenes} is not a multiple of {count} conditions"
                raise document.error((*at, "conditions"), what)
        if stage.prior is not None:
            _check_prior(document, suite, name)
        slowest = stage.scene.profile.target_speed_min_mps
        if stage.reward is not None and stage.reward.desired_speed_mps <= slowest:
            what = f"{stage.reward.desired_speed_mps:g}; expected more than {slowest:g} m/s"
            where = (*at, "reward", "desired_speed_mps")
            raise document.error(where, f"{what}, the lowest target speed of the profile")
        if stage.weights not in suite.weights:
            there = f"this file has: {', '.join(suite.weights) or 'none'}"
            raise document.error((*at, "weights"), f"no weights named '{stage.weights}'; {there}")
        try:
            for driver in suite.drivers_of(stage):
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
        if human.drivers == "simulated":
            _check_simulated(document, suite, name)
    try:
        suite.order  # noqa: B018  # raises
    except CycleError as error:
        what = f"stages depend on each other: {' <- '.join(error.args[1])}"
        raise document.error(("stages",), what) from error
    return suite


def _check_prior(document: Document, suite: TrainingSuite, name: str) -> None:
    """Refuses a stage whose prior cannot regularise it."""
    stage = suite.stages[name]
    at, h = ("stages", name, "prior"), suite.hyperparameters_of(stage)
    if (prior := suite.human_stages.get(str(stage.prior))) is None:
        there = f"this file has: {', '.join(suite.human_stages) or 'none'}"
        raise document.error(at, f"no stage named '{stage.prior}' under human.stages; {there}")
    if not h.prior_weight or not h.standardised:
        raise document.error(at, "needs hyperparameters with a prior_weight, and standardised")
    layers = prior.hidden_layers or suite.hyperparameters.hidden_layers
    if len(layers) != len(h.hidden_layers):
        what = f"has {len(layers)} hidden layers; expected as many as the stage has"
        raise document.error(at, f"{what}, {len(h.hidden_layers)}")


def _check_simulated(document: Document, suite: TrainingSuite, name: str) -> None:
    """Refuses a stage that cannot learn from simulated drivers."""
    assert suite.human is not None
    if suite.human_stages[name].fine_tunes is not None:
        what = "a stage that fine-tunes learns from recorded drivers; expected no fine_tunes"
        raise document.error(("human", "stages", name, "drivers"), what)
    if (simulated := suite.human.simulated) is None:
        raise document.error(("human",), "a stage learns from `simulated` drivers: none given")
    at = ("human", "simulated")
    if simulated.conditions not in (None, *suite.conditions):
        there = f"this file has: {', '.join(suite.conditions) or 'none'}"
        what = f"no conditions named '{simulated.conditions}'; {there}"
        raise document.error((*at, "conditions"), what)
    rates = simulated.scene.simulation_hz, simulated.scene.decision_hz
    if rates != (SIMULATION_HZ, DECISION_HZ):
        what = f"expected simulation_hz {SIMULATION_HZ} and decision_hz {DECISION_HZ}"
        raise document.error((*at, "scene"), f"{what}, found {rates[0]} and {rates[1]}")
    key = "agents"
    try:
        for agent in simulated.agents:
            if not is_network(agent.name):
                find(AGENTS, agent.name)
        key = "traffic"
        for driver in suite.drivers_of(simulated):
            if driver in suite.names:
                raise RegistryError(f"'{driver}' is a stage; expected installed agents or networks")
            if not is_network(driver):
                find(AGENTS, driver)
    except RegistryError as error:
        raise document.error((*at, key), str(error)) from error


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
