"""A stage to be trained: what decides its network, and where it is kept."""

import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any, Protocol
from zipfile import BadZipFile

import numpy as np
from numpy.typing import NDArray

from charms_agents.training.rewards import SAFE_TTC_S
from charms_agents.training.settings import (
    EPISODES_OF_A_SEED,
    FIRST_TRAINING_SEED,
    Hyperparameters,
    Stage,
    TrainingSuite,
)
from charms_bench.errors import RunFolderError
from charms_bench.plugins.agent import Agent, Policy
from charms_bench.world.files import write_atomically

Arrays = dict[str, NDArray[Any]]
"""What a checkpoint holds: plain arrays, read without running anything."""


class Keyed(Protocol):
    """A stage, by everything that decides its network."""

    @property
    def name(self) -> str: ...

    @property
    def inputs(self) -> dict[str, Any]: ...

    @property
    def key(self) -> str: ...


@dataclass(frozen=True)
class Job:
    """A stage whose traffic is known: everything its network depends on."""

    name: str
    stage: Stage
    suite: TrainingSuite
    drivers: Mapping[str, Agent]
    """Those of the others, by name."""

    @property
    def hyperparameters(self) -> Hyperparameters:
        """Of its Double DQN."""
        return self.suite.hyperparameters_of(self.stage)

    @property
    def inputs(self) -> dict[str, Any]:
        """Everything that decides the resulting network, for JSON."""
        inputs: dict[str, Any] = {
            "stage": self.name,
            "steps": self.stage.steps,
            "style": {
                "svo": self.stage.svo,
                "weights": {
                    "name": self.stage.weights,
                    **self.suite.weights[self.stage.weights].model_dump(),
                },
            },
            "seed": self.suite.seed,
            "first_episode_seed": self.first_episode_seed,
            "hyperparameters": self.hyperparameters.inputs,
            "curve_steps": self.suite.curve_steps,
            "scene": self.stage.scene.model_dump(mode="json"),
            "traffic": self._traffic_inputs,
            "charms_bench": version("charms-bench"),
        }
        # Only what departs from the paper, so that what follows it keeps its key.
        if self.stage.safety_horizon_s != SAFE_TTC_S:
            inputs["safety_horizon_s"] = self.stage.safety_horizon_s
        if self.stage.safe_headway_m:
            inputs["safe_headway_m"] = self.stage.safe_headway_m
        if self.stage.lane_change_cost:
            inputs["lane_change_cost"] = self.stage.lane_change_cost
        if self.stage.svo_angle_rad is not None:
            inputs["style"]["svo_angle_rad"] = self.stage.svo_angle_rad
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
    def key(self) -> str:
        """Hash of `inputs`."""
        return hashlib.sha256(json.dumps(self.inputs, sort_keys=True).encode()).hexdigest()

    @property
    def first_episode_seed(self) -> int:
        """The k-th episode has the seed k further."""
        return FIRST_TRAINING_SEED + self.suite.seed * EPISODES_OF_A_SEED

    @property
    def style(self) -> str:
        """In words."""
        return f"{self.stage.weights}, {self.stage.svo}"


class StageFolder:
    """Where a stage keeps its checkpoint and, once it is finished, its network."""

    def __init__(self, output: Path, job: Keyed) -> None:
        self.path = output / f"{job.name}-{job.key[:12]}"
        self.network = self.path / f"{job.name}.onnx"
        self.manifest = self.path / f"{job.name}.json"
        self.curve_csv = self.path / f"{job.name}.csv"
        self.curve_png = self.path / f"{job.name}.png"
        self.checkpoint = self.path / "checkpoint.npz"
        self.tensorboard = self.path / "tensorboard"

    @property
    def finished(self) -> bool:
        """Whether nothing is left to do; the manifest is written last."""
        return self.manifest.exists() and self.network.exists()

    def write_checkpoint(self, arrays: Arrays) -> None:
        """Replaces the checkpoint, so that there is a whole one at any time."""

        def write(partial: Path) -> None:
            with partial.open("wb") as file:
                np.savez(file, **arrays)  # type: ignore[arg-type]  # allow_pickle is no array

        write_atomically(self.checkpoint, write)

    def read_checkpoint(self) -> Arrays | None:
        """The last checkpoint; none before the first.

        Raises:
            RunFolderError: It cannot be read.
        """
        if not self.checkpoint.exists():
            return None
        try:
            with self.checkpoint.open("rb") as file, np.load(file, allow_pickle=False) as arrays:
                return dict(arrays)
        except (OSError, ValueError, EOFError, BadZipFile) as error:
            raise RunFolderError(
                f"{self.checkpoint}: is no checkpoint: {error}; delete it to begin this stage anew"
            ) from error
