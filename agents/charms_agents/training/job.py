"""Jobs: what is known of a stage before it learns, and the folder that it is kept in."""

import hashlib
import json
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property, partial
from importlib.metadata import version
from pathlib import Path
from typing import Any

from charms_agents.human.samples import SampleStore
from charms_agents.human.simulated import simulated_samples
from charms_agents.training.network import untrained
from charms_agents.training.network_file import read_network
from charms_agents.training.rehearsal import EPISODES, EXPLORATION, own_driving
from charms_agents.training.reinforcement import Reinforcement
from charms_agents.training.settings import (
    HumanStage,
    SimulatedDrivers,
    Stage,
    StageStyle,
    TrainingSuite,
)
from charms_agents.training.standardisation import folded
from charms_agents.training.supervised import Fit
from charms_bench.foundation.files import write_bytes
from charms_bench.plugins.agent import Agent, DriverModel, Policy
from charms_bench.plugins.registry import is_network
from charms_bench.plugins.specs import by_content
from charms_bench.world.actions import MetaAction

INTERFACE = {"observation", "actions"}
"""What a suite says of the networks' inputs and outputs."""


@dataclass(frozen=True)
class Job:
    """A stage that is ready to be trained, and its folder."""

    output: Path
    name: str
    suite: TrainingSuite
    style: str
    total: int
    """Number of steps or epochs to learn."""
    decision_hz: float
    inputs: dict[str, Any]
    """Everything that decides the resulting network, ready for JSON."""
    make_learner: Callable[[], Reinforcement | Fit]
    """Makes the learner, before it has learnt anything."""
    actions: tuple[MetaAction, ...]
    """The meta-actions with which the network has learnt."""
    draws: bool
    """Whether the network's values are logits, by which its actions are drawn."""
    styles: Mapping[str, Sequence[float]] = field(default_factory=dict)
    """What the network is given of each of its styles, if it drives in several."""

    @cached_property
    def key(self) -> str:
        """SHA-256 of `inputs`."""
        return hashlib.sha256(json.dumps(self.inputs, sort_keys=True).encode()).hexdigest()

    @property
    def folder(self) -> Path:
        """The folder of the stage."""
        return self.output / f"{self.name}-{self.key[:12]}"

    def file(self, ending: str) -> Path:
        """The stage's network (`.onnx`), manifest (`.json`) or learning curve (`.csv`)."""
        return self.folder / f"{self.name}{ending}"

    def publish(self) -> None:
        """Copies the stage's files to paths without the hash of its inputs, for suites to name."""
        for ending in (".onnx", ".json", ".csv"):
            data = self.file(ending).read_bytes()
            copy = self.output / "networks" / f"{self.name}{ending}"
            if not copy.exists() or copy.read_bytes() != data:
                write_bytes(copy, data)

    @property
    def finished(self) -> bool:
        """Whether the stage is finished; its manifest is written last."""
        return self.file(".json").exists() and self.file(".onnx").exists()


def reinforcement_job(
    output: Path,
    name: str,
    suite: TrainingSuite,
    drivers: Mapping[str, Agent],
    prior: Path | None = None,
) -> Job:
    """The job of the suite's stage `name`, whose traffic `drivers` drive, in a run folder.

    `prior` is the network of the stage's prior, if it has one.
    """
    stage = suite.stages[name]
    styles = {key: _style_inputs(suite, each) for key, each in stage.all_styles.items()}
    # An option at the paper's value is left out, so that stages without it keep their keys.
    options = _conditions(suite, stage)
    if stage.reward is not None:
        options["reward"] = stage.reward.model_dump(mode="json", exclude_none=True)
    interface = suite.model_dump(include=INTERFACE, exclude_defaults=True)
    if prior is not None:
        options["prior_sha256"] = hashlib.sha256(prior.read_bytes()).hexdigest()
    inputs = {
        "stage": name,
        "steps": stage.steps,
        "style": styles.get("", styles),
        "seed": suite.seed,
        "first_episode_seed": suite.first_episode_seed,
        "hyperparameters": suite.hyperparameters.model_dump(mode="json"),
        "curve_steps": suite.curve_steps,
        "scene": stage.scene.model_dump(mode="json"),
        "traffic": _traffic_inputs(stage, drivers, name in suite.drivers_of(stage)),
        "charms_bench": version("charms-bench"),
        **interface,
        **options,
    }
    make = partial(Reinforcement, suite, stage, drivers, prior)
    known = (_style_text(stage), stage.steps, Policy.decision_hz, inputs, make)
    actions, draws = suite.actions_in(stage.scene), prior is not None
    given = suite.styles_of(stage)
    return Job(output, name, suite, *known, actions, draws, given)


def _style_inputs(suite: TrainingSuite, style: StageStyle) -> dict[str, Any]:
    weights = {"name": style.weights, **suite.weights[style.weights].model_dump()}
    angle = style.model_dump(include={"svo_angle_rad"}, exclude_defaults=True)
    return {"svo": style.svo, "weights": weights, **angle}


def _style_text(stage: Stage) -> str:
    return f"{stage.weights}, {stage.svo}" if stage.svo else "as given"


def _conditions(suite: TrainingSuite, stage: Stage | SimulatedDrivers) -> dict[str, Any]:
    """The conditions in which a stage learns, for its inputs; nothing if there is only one."""
    if not stage.conditions:
        return {}
    found = suite.conditions_of(stage)
    return {"conditions": [each.model_dump(mode="json", exclude_none=True) for each in found]}


def _traffic_inputs(
    stage: Stage, drivers: Mapping[str, Agent], is_in_its_own: bool = False
) -> dict[str, Any]:
    """The traffic of a stage, for its inputs, in which its own network can drive, too."""
    hashes = {
        name: driver.weights_sha256 if isinstance(driver, Policy) else ""
        for name, driver in drivers.items()
    }
    if len(hashes) == 1 and not is_in_its_own:
        ((name, sha256),) = hashes.items()
        return {"agent": sha256 if is_network(name) else name, "weights_sha256": sha256}
    spec = stage.traffic.model_dump(mode="json", exclude_defaults=True)
    contents = {name: sha256 for name, sha256 in hashes.items() if is_network(name)}
    return {**by_content(spec, contents), "weights_sha256": by_content(hashes, contents)}


def human_job(
    output: Path,
    name: str,
    suite: TrainingSuite,
    samples: SampleStore | None,
    start: Path | None,
    drivers: Mapping[str, Agent],
) -> Job:
    """The job of the suite's stage `name`, which learns from human driving.

    Args:
        samples: Those of the recordings; None if the stage learns from simulated drivers.
        start: The network to fine-tune; None is imitation.
        drivers: Those among which `start` was trained, or among which simulated drivers drive.
    """
    human = suite.human
    assert human is not None
    stage = human.stages[name]
    settings = human.settings_of(stage)
    layers = stage.hidden_layers or suite.hyperparameters.hidden_layers
    starts_from: dict[str, Any] = {"hidden_layers": list(layers)}
    style, draws, scene = "human", settings.loss == "cross_entropy", None
    learnt: dict[str, Any] = {}
    if stage.fine_tunes is not None and start is not None:
        sha256 = hashlib.sha256(start.read_bytes()).hexdigest()
        starts_from = {"stage": stage.fine_tunes, "weights_sha256": sha256}
        tuned = suite.stages[stage.fine_tunes]
        style = f"{_style_text(tuned)}, fine-tuned on human driving"
        draws, scene = tuned.prior is not None, tuned.scene
        if settings.rehearsal:
            learnt["rehearsed"] = {
                "scene": scene.model_dump(mode="json"),
                **_conditions(suite, tuned),
                "traffic": _traffic_inputs(tuned, drivers),
                "episodes": EPISODES,
                "first_episode_seed": suite.first_episode_seed,
                "exploration": EXPLORATION,
            }
    if samples is not None:
        decision_hz = samples.settings.decision_hz
        learnt["samples"] = {
            "fingerprint": samples.fingerprint,
            "settings": samples.settings.model_dump(mode="json"),
        }
    else:
        simulated = human.simulated
        assert simulated is not None
        decision_hz, scene = simulated.scene.decision_hz, simulated.scene
        learnt["simulated"] = {
            **simulated.model_dump(mode="json", exclude={"conditions"}),
            **_conditions(suite, simulated),
            "files_sha256": [_files_sha256(each.make({})) for each in simulated.agents],
            "first_episode_seed": suite.first_simulated_seed,
        }
    inputs = {
        "stage": name,
        "starts_from": starts_from,
        "style": style,
        "seed": suite.seed,
        "supervised": settings.model_dump(mode="json"),
        "standardised": _is_standardised(suite, stage),
        **suite.model_dump(include=INTERFACE, exclude_defaults=True),
        **learnt,
        "charms_bench": version("charms-bench"),
    }
    make = partial(_fit, suite, stage, layers, samples, start, drivers)
    known = (style, settings.epochs, decision_hz, inputs, make)
    actions = suite.actions if scene is None else suite.actions_in(scene)
    return Job(output, name, suite, *known, actions, draws)


def _files_sha256(agent: Agent) -> str:
    return agent.files_sha256 if isinstance(agent, DriverModel) else agent.weights_sha256


def _is_standardised(suite: TrainingSuite, stage: HumanStage) -> bool:
    """Whether the weights that learn are those for standardised observations."""
    return suite.hyperparameters.standardised or stage.fine_tunes is None


def _fit(
    suite: TrainingSuite,
    stage: HumanStage,
    layers: Sequence[int],
    store: SampleStore | None,
    start: Path | None,
    drivers: Mapping[str, Agent],
) -> Fit:
    """The learner of a stage; see `human_job`."""
    human, seen, actions = suite.human, suite.observed, suite.actions
    assert human is not None
    settings = human.settings_of(stage)
    fresh = folded(untrained(layers, suite.seed, math.prod(seen.shape), len(actions)))
    network, driven = read_network(start) if start else fresh, None
    if stage.fine_tunes and settings.rehearsal:
        places = suite.places_of(suite.stages[stage.fine_tunes])
        driven = own_driving(network, places, drivers, suite.first_episode_seed, seen, actions)
    if store is not None:
        samples = store.load()
    else:
        simulated = human.simulated
        assert simulated is not None
        samples = simulated_samples(
            [each.make({}) for each in simulated.agents],
            suite.places_of(simulated),
            drivers,
            simulated.episodes,
            suite.first_simulated_seed,
            seen,
            actions,
        )
    return Fit(network, samples, settings, suite.seed, _is_standardised(suite, stage), driven)
