"""The life of a stage: from a job to a finished folder, with checkpoints on the way."""

import hashlib
import json
import platform
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass
from importlib.metadata import version
from pathlib import Path
from zipfile import BadZipFile

import numpy as np
import torch
from torch.utils.tensorboard import SummaryWriter

from charms_agents.training.curve import write_csv
from charms_agents.training.job import Job
from charms_agents.training.network_file import export, write_manifest
from charms_agents.training.reinforcement import Reinforcement
from charms_agents.training.stage_progress import Tell
from charms_agents.training.supervised import Fit
from charms_bench.errors import RunFolderError
from charms_bench.foundation.files import write_atomically

_VERSIONS = ("charms-bench", "numba", "numpy", "onnx", "onnxruntime", "torch")
_UNSUITABLE = (OSError, EOFError, BadZipFile, KeyError, ValueError, TypeError, RuntimeError)
"""What reading a checkpoint raises that is damaged or does not fit."""


class Interrupted(Exception):
    """The training was asked to stop and has written a checkpoint."""


def train_stage(job: Job, suite_sha256: str, tell: Tell, stop: Callable[[], bool]) -> None:
    """Trains a stage from its last checkpoint, and writes its network, curve and manifest.

    `tell` is told of the progress; `stop` says whether to write a checkpoint and stop.

    Raises:
        Interrupted: `stop` returned True; the folder holds a checkpoint.
        RunFolderError: The folder cannot be read or written, or its checkpoint does not fit.
    """
    for partial in job.folder.glob(".*.partial"):
        partial.unlink(missing_ok=True)  # from a training that was killed while it wrote
    torch.set_num_threads(1)
    learner, network = job.make_learner(), job.file(".onnx")
    life = _Life(job, learner, tell, stop)
    life.run()
    facts = {"stage": job.name, "style": job.style, "decision_hz": f"{job.decision_hz:g}"}
    given = network, facts, learner.observations, job.suite.observed
    checked = export(
        learner.network,
        *given,
        stochastic=job.draws,
        actions=job.actions,
        styles=job.styles,
    )
    manifest = {
        **job.inputs,
        "key": job.key,
        "suite_sha256": suite_sha256,
        "onnx_sha256": hashlib.sha256(network.read_bytes()).hexdigest(),
        "export_check": checked,
        **learner.results(life.wall_s),
        "wall_s": round(life.wall_s, 1),
        "cpu_s": round(life.cpu_s, 1),
        "versions": {
            "python": platform.python_version(),
            **{name: version(name) for name in _VERSIONS},
        },
        "machine": {"system": platform.system(), "processor": platform.machine()},
    }
    # Written last: from now on, the stage is finished.
    write_manifest(job.file(".json"), manifest)


@dataclass
class _Life:
    """Restores a learner, and reports and saves it while it learns.

    The times at which checkpoints are written do not change what is learnt.
    """

    job: Job
    learner: Reinforcement | Fit
    tell: Tell
    stop: Callable[[], bool]
    wall_s: float = 0.0
    """Seconds that the stage took until the last checkpoint, over all its runs."""
    cpu_s: float = 0.0
    """Processor time that the stage took until the last checkpoint, over all its runs."""
    reported: int = 0

    def run(self) -> None:
        """Learns to the end."""
        self.checkpoint = self.job.folder / "checkpoint.npz"
        if self.checkpoint.exists():
            self._restore()
        self.logger = SummaryWriter(str(self.job.folder / "tensorboard"))
        self.saved_at, self.used_s = time.monotonic(), time.process_time()
        try:
            self.learner.learn(self._pause)
            self._report()
            self._save()
        finally:
            self.logger.close()

    def _pause(self) -> None:
        self._report()
        if self.stop():
            self._save()
            raise Interrupted
        if time.monotonic() - self.saved_at >= self.job.suite.checkpoint_s:
            self._save()

    def _report(self) -> None:
        """Tells how far the learner is, and logs the points that were not logged before."""
        points, words = self.learner.curve[self.reported :], ""
        for point in points:
            (_, at), *values = asdict(point).items()
            for name, value in values:
                if value is not None:
                    self.logger.add_scalar(f"charms/{name}", value, at)
            words = point.in_words
        self.reported += len(points)
        self.tell(self.job.name, self.learner.done, self.job.total, words)

    def _save(self) -> None:
        now, used_s = time.monotonic(), time.process_time()
        self.wall_s += now - self.saved_at
        self.cpu_s += used_s - self.used_s
        self.saved_at, self.used_s = now, used_s
        progress = {"key": self.job.key, "wall_s": self.wall_s, "cpu_s": self.cpu_s}
        arrays = {**self.learner.arrays(), "progress": np.array(json.dumps(progress))}

        def write(partial: Path) -> None:
            with partial.open("wb") as file:
                np.savez(file, **arrays)  # type: ignore[arg-type]  # for `allow_pickle`

        write_atomically(self.checkpoint, write)
        write_csv(self.job.file(".csv"), self.learner.point, self.learner.curve)

    def _restore(self) -> None:
        what = "not a checkpoint"
        try:
            with self.checkpoint.open("rb") as file, np.load(file, allow_pickle=False) as stored:
                arrays = dict(stored)
            what = "cannot be continued"
            progress = json.loads(str(arrays["progress"]))
            if progress["key"] != self.job.key:
                raise ValueError("it was written with other settings")
            self.wall_s, self.cpu_s = float(progress["wall_s"]), float(progress["cpu_s"])
            self.learner.load_arrays(arrays)
            self.reported = len(self.learner.curve)
        except _UNSUITABLE as error:
            raise RunFolderError(
                f"{self.checkpoint}: {what}: {error}; "
                "delete it to start this stage from the beginning"
            ) from error
