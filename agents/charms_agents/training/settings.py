"""Training suites: what is trained, from YAML."""

from graphlib import CycleError, TopologicalSorter
from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field, model_validator

from charms_agents.training.rewards import Svo, Weights
from charms_bench.document import Document
from charms_bench.errors import RegistryError
from charms_bench.profile import FrozenModel, NonNegative, Positive
from charms_bench.registry import AGENTS, find
from charms_bench.suite import Name as AgentName
from charms_bench.suite import SuiteScene

FIRST_TRAINING_SEED = 2**40
"""Evaluations draw their scenes from seeds below 10^9, trainings from here on: none meet."""
EPISODES_OF_A_SEED = 2**32
"""The k-th training episode's seed: FIRST_TRAINING_SEED + seed * EPISODES_OF_A_SEED + k."""

Name = Annotated[str, Field(pattern=r"^[a-z][a-z0-9_]{0,63}$")]
Count = Annotated[int, Field(ge=1, le=10**9)]
Share = Annotated[float, Field(ge=0, le=1)]


class Hyperparameters(FrozenModel):
    """Of Double DQN; steps are decisions of one ego."""

    learning_rate: Positive = 1e-4
    batch_size: Count = 32
    discount: Share = 0.99
    replay_buffer: Count = 50_000
    """Decisions kept."""
    learning_starts: Annotated[int, Field(ge=0)] = 10_000
    """Steps before the first gradient step, in which all actions are random."""
    steps_per_gradient_step: Count = 2
    target_update_steps: Count = 500
    """Steps between two copies of the network to the target network."""
    exploration_initial: Share = 1.0
    exploration_final: Share = 0.05
    exploration_share: Share = 0.1
    """Share of all steps in which exploration falls from initial to final."""
    max_gradient_norm: Positive = 10.0
    hidden_layers: Annotated[tuple[Count, ...], Field(strict=False, max_length=8)] = (256, 256)
    scenes: Annotated[int, Field(ge=1, le=1000)] = 10
    """Episodes played side by side."""

    @model_validator(mode="after")
    def _rates_fit(self) -> "Hyperparameters":
        """Counts are in steps, and `scenes` steps are taken at once."""
        if self.scenes % self.steps_per_gradient_step:
            raise ValueError(
                f"scenes {self.scenes} is no multiple of "
                f"steps_per_gradient_step {self.steps_per_gradient_step}"
            )
        for name in ("replay_buffer", "target_update_steps"):
            if getattr(self, name) % self.scenes:
                raise ValueError(
                    f"{name} {getattr(self, name)} is no multiple of scenes {self.scenes}"
                )
        return self


class Supervised(FrozenModel):
    """Of learning from human driving; by default the paper's fine-tuning."""

    learning_rate: Positive = 1e-6
    batch_size: Count = 128
    epochs: Count = 8
    pull: NonNegative = 0.2
    """Lambda of eq. 11: how strongly weights are pulled to where they started."""
    label_floor: Annotated[float, Field(gt=0, le=0.1)] = 0.01
    """Least probability of an action in a label; the divergence of eq. 11 is infinite at 0."""


class StageTraffic(FrozenModel):
    """Who drives the others: an installed agent, or the network of another stage."""

    agent: AgentName | None = None
    stage: Name | None = None

    @model_validator(mode="after")
    def _one_of_two(self) -> "StageTraffic":
        if (self.agent is None) == (self.stage is None):
            raise ValueError("give the name of an agent, or that of a stage of this file")
        return self


class Stage(FrozenModel):
    """One network: a style, which is a choice of weights and an SVO, and where it is learnt."""

    steps: Count
    weights: Name
    """One of the suite's `weights`."""
    svo: Svo
    scene: SuiteScene = SuiteScene()
    traffic: StageTraffic


class TrainingSuite(FrozenModel):
    """The stages of a training, by the name of the network that each of them makes."""

    pipeline: Literal["charms"]
    title: str = ""
    seed: Annotated[int, Field(ge=0, lt=2**23)] = 0
    hyperparameters: Hyperparameters = Hyperparameters()
    curve_steps: Count = 10_000
    """Steps between two points of the learning curve."""
    checkpoint_s: Positive = 60.0
    """Seconds between two checkpoints."""
    weights: dict[Name, Weights]
    stages: Annotated[dict[Name, Stage], Field(min_length=1)]

    @property
    def order(self) -> tuple[str, ...]:
        """The stages' names, each after those it needs."""
        needs = {
            name: [stage.traffic.stage] if stage.traffic.stage else []
            for name, stage in self.stages.items()
        }
        return tuple(TopologicalSorter(needs).static_order())

    def needed_for(self, name: str) -> tuple[str, ...]:
        """A stage's name, after those of all stages it needs."""
        before = self.stages[name].traffic.stage
        return (*(self.needed_for(before) if before else ()), name)


def load_training(path: Path) -> TrainingSuite:
    """The training suite of a YAML file.

    Raises:
        SuiteError: Something in it is wrong, or names what does not exist.
    """
    document = Document(path)
    suite = document.validate(TrainingSuite)
    for name, stage in suite.stages.items():
        at, scenes = ("stages", name), suite.hyperparameters.scenes
        for steps, where in ((stage.steps, (*at, "steps")), (suite.curve_steps, ("curve_steps",))):
            if steps % scenes:
                raise document.error(where, f"{steps} is no multiple of scenes {scenes}")
        if stage.weights not in suite.weights:
            there = f"this file has: {', '.join(suite.weights) or 'none'}"
            raise document.error((*at, "weights"), f"no weights named '{stage.weights}'; {there}")
        if stage.traffic.stage is not None and stage.traffic.stage not in suite.stages:
            there = f"this file has: {', '.join(suite.stages)}"
            what = f"no stage named '{stage.traffic.stage}'; {there}"
            raise document.error((*at, "traffic", "stage"), what)
        if stage.traffic.agent is not None:
            try:
                find(AGENTS, stage.traffic.agent)
            except RegistryError as error:
                raise document.error((*at, "traffic", "agent"), str(error)) from error
    try:
        suite.order  # noqa: B018  # raises
    except CycleError as error:
        what = f"stages need each other: {' <- '.join(error.args[1])}"
        raise document.error(("stages",), what) from error
    return suite
