"""Jobs: everything that decides a stage's network, and the folder that the stage is kept in."""

import hashlib
import json
from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from importlib.metadata import version
from pathlib import Path
from typing import Any
from zipfile import BadZipFile

import numpy as np
from numpy.typing import NDArray

from charms_agents.human.samples import SampleStore
from charms_agents.training.rewards import SAFE_TTC_S
from charms_agents.training.settings import (
    EPISODES_OF_A_SEED,
    FIRST_TRAINING_SEED,
    Hyperparameters,
    Stage,
    Supervised,
    TrainingSuite,
)
from charms_bench.errors import RunFolderError
from charms_bench.plugins.agent import Agent, Policy
from charms_bench.world.files import write_atomically

Arrays = dict[str, NDArray[Any]]
"""The content of a checkpoint: plain arrays, which are read without running any code."""


@dataclass(frozen=True)
class Job(ABC):
    """A stage that is ready to be trained."""

    name: str
    suite: TrainingSuite

    @property
    @abstractmethod
    def inputs(self) -> dict[str, Any]:
        """Everything that decides the resulting network, ready for JSON."""

    @property
    @abstractmethod
    def style(self) -> str:
        """The style of the network in words."""

    @property
    @abstractmethod
    def total(self) -> int:
        """Number of steps or epochs to learn."""

    @property
    @abstractmethod
    def decision_hz(self) -> str:
        """The network's decisions per second, as its metadata says them."""

    @cached_property
    def key(self) -> str:
        """SHA-256 of `inputs`."""
        return hashlib.sha256(json.dumps(self.inputs, sort_keys=True).encode()).hexdigest()


@dataclass(frozen=True)
class ReinforcementJob(Job):
    """A stage that learns by reinforcement in a simulation."""

    drivers: Mapping[str, Agent]
    """The agents that drive the traffic, by name."""

    @property
    def stage(self) -> Stage:
        """The stage in the suite."""
        return self.suite.stages[self.name]

    @property
    def hyperparameters(self) -> Hyperparameters:
        """The hyperparameters of Double DQN for this stage."""
        return self.suite.hyperparameters_of(self.stage)

    @property
    def inputs(self) -> dict[str, Any]:
        stage = self.stage
        weights = self.suite.weights[stage.weights].model_dump()
        inputs: dict[str, Any] = {
            "stage": self.name,
            "steps": stage.steps,
            "style": {"svo": stage.svo, "weights": {"name": stage.weights, **weights}},
            "seed": self.suite.seed,
            "first_episode_seed": self.first_episode_seed,
            "hyperparameters": self.hyperparameters.inputs,
            "curve_steps": self.suite.curve_steps,
            "scene": stage.scene.model_dump(mode="json"),
            "traffic": self._traffic_inputs,
            "charms_bench": version("charms-bench"),
        }
        # An option at the paper's value is left out, so that stages without it keep their keys.
        if stage.safety_horizon_s != SAFE_TTC_S:
            inputs["safety_horizon_s"] = stage.safety_horizon_s
        if stage.safe_headway_m:
            inputs["safe_headway_m"] = stage.safe_headway_m
        if stage.lane_change_cost:
            inputs["lane_change_cost"] = stage.lane_change_cost
        if stage.svo_angle_rad is not None:
            inputs["style"]["svo_angle_rad"] = stage.svo_angle_rad
        return inputs

    @property
    def _traffic_inputs(self) -> dict[str, Any]:
        hashes = {
            name: driver.weights_sha256 if isinstance(driver, Policy) else ""
            for name, driver in self.drivers.items()
        }
        if len(hashes) == 1:
            ((name, sha256),) = hashes.items()
            return {"agent": name, "weights_sha256": sha256}
        spec = self.stage.traffic.model_dump(mode="json", exclude_defaults=True)
        return {**spec, "weights_sha256": hashes}

    @property
    def first_episode_seed(self) -> int:
        """Seed of the first training episode; each further episode adds 1."""
        return FIRST_TRAINING_SEED + self.suite.seed * EPISODES_OF_A_SEED

    @property
    def style(self) -> str:
        return f"{self.stage.weights}, {self.stage.svo}"

    @property
    def total(self) -> int:
        return self.stage.steps

    @property
    def decision_hz(self) -> str:
        return f"{Policy.decision_hz:g}"


@dataclass(frozen=True)
class HumanJob(Job):
    """A stage that learns from human driving: fine-tuning, or imitation from nothing."""

    samples: SampleStore
    start: Path | None = None
    """The network that is fine-tuned; None for imitation."""

    @property
    def settings(self) -> Supervised:
        """How the stage learns."""
        assert self.suite.human is not None
        return self.suite.human.settings_of(self.suite.human.stages[self.name])

    @property
    def inputs(self) -> dict[str, Any]:
        start: dict[str, Any] = {"hidden_layers": list(self.suite.hyperparameters.hidden_layers)}
        if self.start is not None:
            sha256 = hashlib.sha256(self.start.read_bytes()).hexdigest()
            start = {"stage": self._fine_tuned, "weights_sha256": sha256}
        return {
            "stage": self.name,
            "starts_from": start,
            "style": self.style,
            "seed": self.suite.seed,
            "supervised": self.settings.inputs,
            "samples": {
                "fingerprint": self.samples.fingerprint,
                "settings": self.samples.settings.model_dump(mode="json"),
            },
            "charms_bench": version("charms-bench"),
        }

    @property
    def _fine_tuned(self) -> str | None:
        return self.suite.human_stages[self.name].fine_tunes

    @property
    def style(self) -> str:
        if self._fine_tuned is None:
            return "human"
        stage = self.suite.stages[self._fine_tuned]
        return f"{stage.weights}, {stage.svo}, fine-tuned on human driving"

    @property
    def total(self) -> int:
        return self.settings.epochs

    @property
    def decision_hz(self) -> str:
        return str(self.samples.settings.decision_hz)


class StageFolder:
    """The files of a stage: its checkpoint and, once it is finished, its network."""

    def __init__(self, output: Path, job: Job) -> None:
        self.path = output / f"{job.name}-{job.key[:12]}"
        self.network = self.path / f"{job.name}.onnx"
        self.manifest = self.path / f"{job.name}.json"
        self.curve_csv = self.path / f"{job.name}.csv"
        self.checkpoint = self.path / "checkpoint.npz"
        self.tensorboard = self.path / "tensorboard"

    @property
    def finished(self) -> bool:
        """Whether the stage is finished; its manifest is written last."""
        return self.manifest.exists() and self.network.exists()

    def write_checkpoint(self, arrays: Arrays) -> None:
        """Replaces the checkpoint in one step, so the folder always holds a complete one."""

        def write(partial: Path) -> None:
            with partial.open("wb") as file:
                np.savez(file, **arrays)  # type: ignore[arg-type]  # for `allow_pickle`

        write_atomically(self.checkpoint, write)

    def read_checkpoint(self) -> Arrays | None:
        """The last checkpoint; None before the first.

        Raises:
            RunFolderError: The checkpoint cannot be read.
        """
        if not self.checkpoint.exists():
            return None
        try:
            with self.checkpoint.open("rb") as file, np.load(file, allow_pickle=False) as arrays:
                return dict(arrays)
        except (OSError, ValueError, EOFError, BadZipFile) as error:
            raise RunFolderError(
                f"{self.checkpoint}: not a checkpoint: {error}; "
                "delete it to start this stage from the beginning"
            ) from error
