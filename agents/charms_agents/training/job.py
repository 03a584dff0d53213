"""Jobs: what is known of a stage before it learns, and the folder that it is kept in."""

import hashlib
import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from importlib.metadata import version
from pathlib import Path, PurePosixPath
from typing import Any

from torch.nn import Sequential

from charms_agents.human.samples import Samples, SampleStore
from charms_agents.human.simulated import simulated_samples
from charms_agents.training.hyperparameters import Supervised
from charms_agents.training.network import untrained
from charms_agents.training.network_file import read_network
from charms_agents.training.own_driving import EPISODES, EXPLORATION, own_driving
from charms_agents.training.reinforcement import Reinforcement
from charms_agents.training.settings import SimulatedDrivers, Stage, TrainingSuite
from charms_agents.training.standardised import folded, unfolded
from charms_agents.training.supervised import Fit
from charms_bench.foundation.files import write_bytes
from charms_bench.plugins.agent import Agent, DriverModel, Policy
from charms_bench.plugins.registry import is_network
from charms_bench.plugins.specs import by_content
from charms_bench.world.actions import DEFAULT_ACTIONS, MetaAction
from charms_bench.world.scene import Observations

INTERFACE = {"observation", "actions"}
"""What a suite says of the networks' inputs and outputs."""


def title_of(seed_folder: str, name: str) -> str:
    """The name of a stage, after the folder of its seed if it has one."""
    return (PurePosixPath(seed_folder) / name).as_posix()


@dataclass(frozen=True)
class Job:
    """A stage that is ready to be trained, and its folder."""

    output: Path
    seed_folder: str
    """The folder of the stage's seed in the run folder; empty if the suite has one seed."""
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
    actions: tuple[MetaAction, ...] = DEFAULT_ACTIONS
    """The meta-actions with which the network has learnt."""
    draws: bool = False
    """Whether the network's values are logits, by which its actions are drawn."""

    @cached_property
    def key(self) -> str:
        """SHA-256 of `inputs`."""
        return hashlib.sha256(json.dumps(self.inputs, sort_keys=True).encode()).hexdigest()

    @property
    def title(self) -> str:
        return title_of(self.seed_folder, self.name)

    @property
    def folder(self) -> Path:
        """The folder of the stage."""
        return self.output / self.seed_folder / f"{self.name}-{self.key[:12]}"

    def file(self, ending: str) -> Path:
        """The stage's network (`.onnx`), manifest (`.json`) or learning curve (`.csv`)."""
        return self.folder / f"{self.name}{ending}"

    def publish(self) -> None:
        """Copies the stage's files to paths without the hash of its inputs, for suites to name."""
        for ending in (".onnx", ".json", ".csv"):
            data = self.file(ending).read_bytes()
            copy = self.output / self.seed_folder / "networks" / f"{self.name}{ending}"
            if not copy.exists() or copy.read_bytes() != data:
                write_bytes(copy, data)

    @property
    def finished(self) -> bool:
        """Whether the stage is finished; its manifest is written last."""
        return self.file(".json").exists() and self.file(".onnx").exists()


def reinforcement_job(
    output: Path,
    seed_folder: str,
    name: str,
    suite: TrainingSuite,
    drivers: Mapping[str, Agent],
    prior: Path | None = None,
) -> Job:
    """The job of the suite's stage `name`, whose traffic `drivers` drive, in a run folder.

    `prior` is the network of the stage's prior, if it has one.
    """
    stage = suite.stages[name]
    first_seed = suite.first_episode_seed
    weights = {"name": stage.weights, **suite.weights[stage.weights].model_dump()}
    # An option at the paper's value is left out, so that stages without it keep their keys.
    options = _conditions(suite, stage)
    if stage.reward is not None:
        options["reward"] = stage.reward.model_dump(mode="json", exclude_none=True)
    interface = suite.model_dump(include=INTERFACE, exclude_defaults=True)
    angle = stage.model_dump(include={"svo_angle_rad"}, exclude_defaults=True)
    if prior is not None:
        options["prior_sha256"] = hashlib.sha256(prior.read_bytes()).hexdigest()
    inputs = {
        "stage": name,
        "steps": stage.steps,
        "style": {"svo": stage.svo, "weights": weights, **angle},
        "seed": suite.seed,
        "first_episode_seed": first_seed,
        "hyperparameters": suite.hyperparameters_of(stage).inputs,
        "curve_steps": suite.curve_steps,
        "scene": stage.scene.model_dump(mode="json"),
        "traffic": _traffic_inputs(stage, drivers),
        "charms_bench": version("charms-bench"),
        **interface,
        **options,
    }
    return Job(
        output,
        seed_folder,
        name,
        suite,
        style=f"{stage.weights}, {stage.svo}",
        total=stage.steps,
        decision_hz=Policy.decision_hz,
        inputs=inputs,
        make_learner=partial(_reinforcement, suite, stage, drivers, first_seed, prior),
        actions=suite.actions_in(stage.scene),
        draws=prior is not None,
    )


def _conditions(suite: TrainingSuite, stage: Stage | SimulatedDrivers) -> dict[str, Any]:
    """The conditions in which a stage learns, for its inputs; nothing if there is only one."""
    if not stage.conditions:
        return {}
    found = suite.conditions_of(stage)
    return {"conditions": [each.model_dump(mode="json", exclude_none=True) for each in found]}


def _reinforcement(
    suite: TrainingSuite,
    stage: Stage,
    drivers: Mapping[str, Agent],
    first_seed: int,
    prior: Path | None,
) -> Reinforcement:
    network = None if prior is None else unfolded(read_network(prior))
    return Reinforcement(suite, stage, drivers, first_seed, network)


def _traffic_inputs(stage: Stage, drivers: Mapping[str, Agent]) -> dict[str, Any]:
    hashes = {
        name: driver.weights_sha256 if isinstance(driver, Policy) else ""
        for name, driver in drivers.items()
    }
    if len(hashes) == 1:
        ((name, sha256),) = hashes.items()
        return {"agent": sha256 if is_network(name) else name, "weights_sha256": sha256}
    spec = stage.traffic.model_dump(mode="json", exclude_defaults=True)
    contents = {name: sha256 for name, sha256 in hashes.items() if is_network(name)}
    return {**by_content(spec, contents), "weights_sha256": by_content(hashes, contents)}


def human_job(
    output: Path,
    seed_folder: str,
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
    assert suite.human is not None
    stage = suite.human.stages[name]
    settings = suite.human.settings_of(stage)
    layers = stage.hidden_layers or suite.hyperparameters.hidden_layers
    starts_from: dict[str, Any] = {"hidden_layers": list(layers)}
    style, standardised, draws = "human", True, settings.loss == "cross_entropy"
    actions = suite.actions
    learnt: dict[str, Any] = {}
    drive: Callable[[Sequential], Observations] | None = None
    if stage.fine_tunes is not None and start is not None:
        sha256 = hashlib.sha256(start.read_bytes()).hexdigest()
        starts_from = {"stage": stage.fine_tunes, "weights_sha256": sha256}
        tuned = suite.stages[stage.fine_tunes]
        style = f"{tuned.weights}, {tuned.svo}, fine-tuned on human driving"
        standardised = suite.hyperparameters_of(tuned).standardised
        actions = suite.actions_in(tuned.scene)
        draws = tuned.prior is not None
        if settings.rehearsal:
            first_seed = suite.first_episode_seed
            learnt["rehearsed"] = {
                "scene": tuned.scene.model_dump(mode="json"),
                **_conditions(suite, tuned),
                "traffic": _traffic_inputs(tuned, drivers),
                "episodes": EPISODES,
                "first_episode_seed": first_seed,
                "exploration": EXPLORATION,
            }
            drive = partial(
                own_driving,
                places=suite.places_of(tuned),
                drivers=drivers,
                first_seed=first_seed,
                observation=suite.observed,
                meta_actions=suite.actions,
            )
    if samples is not None:
        load: Callable[[], Samples] = samples.load
        learnt["samples"] = {
            "fingerprint": samples.fingerprint,
            "settings": samples.settings.model_dump(mode="json"),
        }
        decision_hz = samples.settings.decision_hz
    else:
        assert suite.human.simulated is not None
        actions = suite.actions_in(suite.human.simulated.scene)
        load, decision_hz = (
            partial(_simulated, suite, drivers),
            suite.human.simulated.scene.decision_hz,
        )
        learnt["simulated"] = {
            **suite.human.simulated.model_dump(mode="json", exclude={"conditions"}),
            **_conditions(suite, suite.human.simulated),
            "files_sha256": [_files_sha256(each.make({})) for each in suite.human.simulated.agents],
            "first_episode_seed": suite.first_simulated_seed,
        }
    inputs = {
        "stage": name,
        "starts_from": starts_from,
        "style": style,
        "seed": suite.seed,
        "supervised": settings.model_dump(mode="json"),
        "standardised": standardised,
        **suite.model_dump(include=INTERFACE, exclude_defaults=True),
        **learnt,
        "charms_bench": version("charms-bench"),
    }
    return Job(
        output,
        seed_folder,
        name,
        suite,
        style=style,
        total=settings.epochs,
        decision_hz=decision_hz,
        inputs=inputs,
        make_learner=partial(_fit, start, layers, load, settings, suite, standardised, drive),
        actions=actions,
        draws=draws,
    )


def _files_sha256(agent: Agent) -> str:
    return agent.files_sha256 if isinstance(agent, DriverModel) else agent.weights_sha256


def _simulated(suite: TrainingSuite, drivers: Mapping[str, Agent]) -> Samples:
    """The samples of the suite's simulated drivers among others."""
    assert suite.human is not None
    simulated = suite.human.simulated
    assert simulated is not None
    return simulated_samples(
        [each.make({}) for each in simulated.agents],
        suite.places_of(simulated),
        drivers,
        simulated.episodes,
        suite.first_simulated_seed,
        suite.observed,
        suite.actions,
    )


def _fit(
    start: Path | None,
    layers: Sequence[int],
    load: Callable[[], Samples],
    settings: Supervised,
    suite: TrainingSuite,
    standardised: bool,
    drive: Callable[[Sequential], Observations] | None,
) -> Fit:
    rows, columns = suite.observed.shape
    fresh = folded(untrained(layers, suite.seed, rows * columns, len(suite.actions)))
    network = read_network(start) if start else fresh
    driven = drive(network) if drive else None
    return Fit(network, load(), settings, suite.seed, standardised, driven)
