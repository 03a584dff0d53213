"""Jobs: what is known of a stage before it learns, and the folder that it is kept in."""

import hashlib
import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, Protocol
from zipfile import BadZipFile

import numpy as np
from numpy.typing import NDArray
from torch.nn import Sequential

from charms_agents.training.curve import Epoch, Point
from charms_bench.errors import RunFolderError
from charms_bench.world.files import write_atomically
from charms_bench.world.scene import Observations

Arrays = dict[str, NDArray[Any]]
"""The content of a checkpoint: plain arrays, which are read without running any code."""


class Learner(Protocol):
    """A network while it learns."""

    @property
    def point(self) -> type[Point | Epoch]:
        """The kind of points in the learning curve."""

    @property
    def curve(self) -> Sequence[Point | Epoch]:
        """The points so far."""

    @property
    def done(self) -> int:
        """Steps or epochs so far."""

    @property
    def network(self) -> Sequential:
        """The network so far."""

    @property
    def observations(self) -> Observations:
        """(M, 7, 5) observations on which the exported network is compared with this one."""

    def learn(self, pause: Callable[[], None]) -> None:
        """Learns to the end; calls `pause` wherever `arrays` can be called."""

    def arrays(self) -> Arrays:
        """Everything that further learning depends on, as plain arrays."""

    def load_arrays(self, arrays: Arrays) -> None:
        """Takes over what `arrays` returned for the same job."""

    def results(self, wall_s: float) -> dict[str, Any]:
        """What the manifest says of the learning, which took `wall_s` seconds."""


@dataclass(frozen=True)
class Job:
    """A stage that is ready to be trained."""

    name: str
    style: str
    """The style of the network in words."""
    total: int
    """Number of steps or epochs to learn."""
    decision_hz: float
    """The network's decisions per second."""
    checkpoint_s: float
    """Seconds between two checkpoints."""
    inputs: dict[str, Any]
    """Everything that decides the resulting network, ready for JSON."""
    make_learner: Callable[[], Learner]
    """Makes the learner, before it has learnt anything."""

    @cached_property
    def key(self) -> str:
        """SHA-256 of `inputs`."""
        return hashlib.sha256(json.dumps(self.inputs, sort_keys=True).encode()).hexdigest()


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
