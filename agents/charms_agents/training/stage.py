"""The life of a stage: from a job to a finished folder, with checkpoints on the way."""

import hashlib
import json
import platform
import time
from collections.abc import Callable
from dataclasses import asdict
from importlib.metadata import version
from pathlib import Path

import numpy as np
import torch
from stable_baselines3.common.logger import configure

from charms_agents.training.curve import write_csv
from charms_agents.training.export import export
from charms_agents.training.job import Job, Learner, StageFolder
from charms_agents.training.progress import Tell
from charms_bench.errors import RunFolderError
from charms_bench.world.files import write_bytes

_VERSIONS = ("charms-bench", "numba", "numpy", "onnx", "onnxruntime", "stable-baselines3", "torch")


class Interrupted(Exception):
    """The training was asked to stop and has written a checkpoint."""


def train_stage(
    job: Job, output: Path, suite_sha256: str, tell: Tell, stop: Callable[[], bool]
) -> StageFolder:
    """Trains a stage from its last checkpoint, and writes its network, curve and manifest.

    A finished stage is left as it is.

    Args:
        job: The stage.
        output: The run folder.
        suite_sha256: For the manifest.
        tell: Told of the progress.
        stop: Whether to write a checkpoint and stop.

    Raises:
        Interrupted: `stop` returned True; the folder holds a checkpoint.
        RunFolderError: The folder cannot be read or written, or its checkpoint does not fit.
        CharmsBenchError: The samples or the network to start from cannot be used.
    """
    folder = StageFolder(output, job)
    if folder.finished:
        return folder
    for partial in folder.path.glob(".*.partial"):
        partial.unlink(missing_ok=True)  # from a training that was killed while it wrote
    torch.set_num_threads(1)
    learner = job.make_learner()
    wall_s = _Life(job, folder, learner, tell, stop).run()
    facts = {"stage": job.name, "style": job.style, "decision_hz": f"{job.decision_hz:g}"}
    checked = export(learner.network, folder.network, facts, learner.observations)
    manifest = {
        **job.inputs,
        "key": job.key,
        "suite_sha256": suite_sha256,
        "onnx_sha256": hashlib.sha256(folder.network.read_bytes()).hexdigest(),
        "export_check": checked,
        **learner.results(wall_s),
        "wall_s": round(wall_s, 1),
        "versions": {
            "python": platform.python_version(),
            **{name: version(name) for name in _VERSIONS},
        },
        "machine": {"system": platform.system(), "processor": platform.machine()},
    }
    text = json.dumps(manifest, indent=2) + "\n"
    # Written last: from now on, the stage is finished.
    write_bytes(folder.manifest, text.encode())
    return folder


class _Life:
    """Restores a learner, and reports and saves it while it learns.

    The times at which checkpoints are written do not change what is learnt.
    """

    def __init__(
        self,
        job: Job,
        folder: StageFolder,
        learner: Learner,
        tell: Tell,
        stop: Callable[[], bool],
    ) -> None:
        self._job, self._folder, self._learner = job, folder, learner
        self._tell, self._stop = tell, stop
        self._wall_s = 0.0
        self._reported = 0
        self._restore()
        self._logger = configure(str(folder.tensorboard), ["tensorboard"])
        self._saved_at = time.monotonic()

    def run(self) -> float:
        """Learns to the end; returns the seconds that the stage took, over all its runs."""
        try:
            self._learner.learn(self._pause)
            self._report()
            self._save()
        finally:
            self._logger.close()
        return self._wall_s

    def _pause(self) -> None:
        self._report()
        if self._stop():
            self._save()
            raise Interrupted
        if time.monotonic() - self._saved_at >= self._job.checkpoint_s:
            self._save()

    def _report(self) -> None:
        """Tells how far the learner is, and logs the points that were not logged before."""
        points, words = self._learner.curve[self._reported :], ""
        for point in points:
            (_, at), *values = asdict(point).items()
            for name, value in values:
                if value is not None:
                    self._logger.record(f"charms/{name}", value)
            self._logger.dump(at)
            words = point.in_words
        self._reported += len(points)
        self._tell(self._job.name, self._learner.done, self._job.total, words)

    def _save(self) -> None:
        now = time.monotonic()
        self._wall_s += now - self._saved_at
        self._saved_at = now
        progress = {"key": self._job.key, "wall_s": self._wall_s}
        arrays = {**self._learner.arrays(), "progress": np.array(json.dumps(progress))}
        self._folder.write_checkpoint(arrays)
        write_csv(self._folder.curve_csv, self._learner.point, self._learner.curve)

    def _restore(self) -> None:
        arrays = self._folder.read_checkpoint()
        if arrays is None:
            return
        try:
            progress = json.loads(str(arrays["progress"]))
            if progress["key"] != self._job.key:
                raise ValueError("it was written with other settings")
            self._wall_s = float(progress["wall_s"])
            self._learner.load_arrays(arrays)
            self._reported = len(self._learner.curve)
        except (KeyError, ValueError, TypeError, RuntimeError) as error:
            raise RunFolderError(
                f"{self._folder.checkpoint}: cannot be continued: {error}; "
                "delete it to start this stage from the beginning"
            ) from error
