"""Training one network on human driving: fine-tuning another stage's, or imitation from nothing."""

import hashlib
import json
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
import torch
from stable_baselines3.common.logger import Logger, configure

from charms_agents.training import supervised
from charms_agents.training.export import export
from charms_agents.training.job import StageFolder
from charms_agents.training.manifest import write_manifest
from charms_agents.training.network import read_network, untrained
from charms_agents.training.settings import Supervised, TrainingSuite
from charms_agents.training.stage import Interrupted
from charms_agents.training.supervised import Epoch, Fit
from charms_bench.errors import RunFolderError
from charms_bench.people.samples import Samples, SampleSettings, load_samples


@dataclass(frozen=True)
class HumanData:
    """Samples of human driving, by where they are from."""

    recordings: Path
    cache: Path
    settings: SampleSettings
    fingerprint: str
    """Of recordings and settings."""

    def load(self) -> Samples:
        """The samples, from the cache if they are there."""
        return load_samples(self.recordings, self.cache, self.settings)


@dataclass(frozen=True)
class HumanJob:
    """A stage that learns from human driving: everything its network depends on."""

    name: str
    settings: Supervised
    suite: TrainingSuite
    data: HumanData
    before: str = ""
    """The stage whose network is fine-tuned; empty for imitation."""
    network: Path | None = None
    """Its file."""
    sha256: str = ""
    """Hash of its weights."""
    style: str = "human"
    """In words."""

    @property
    def steps(self) -> int:
        """Epochs."""
        return self.settings.epochs

    @property
    def inputs(self) -> dict[str, Any]:
        """Everything that decides the resulting network, for JSON."""
        start = {"stage": self.before, "weights_sha256": self.sha256}
        layers = list(self.suite.hyperparameters.hidden_layers)
        return {
            "stage": self.name,
            "starts_from": start if self.before else {"hidden_layers": layers},
            "style": self.style,
            "seed": self.suite.seed,
            "supervised": self.settings.inputs,
            "samples": {
                "fingerprint": self.data.fingerprint,
                "settings": self.data.settings.model_dump(mode="json"),
            },
            "charms_bench": version("charms-bench"),
        }

    @property
    def key(self) -> str:
        """Hash of `inputs`."""
        return hashlib.sha256(json.dumps(self.inputs, sort_keys=True).encode()).hexdigest()


def fit_stage(
    job: HumanJob,
    output: Path,
    suite_sha256: str,
    report: Callable[[Epoch], None],
    stop: Callable[[], bool],
) -> StageFolder:
    """Trains a stage, or goes on with it, and writes its network; a finished one is left alone.

    Raises:
        Interrupted: `stop` said so; the folder holds a checkpoint.
        CharmsBenchError: The samples, the network or the folder cannot be used.
    """
    folder = StageFolder(output, job)
    if folder.finished:
        return folder
    for partial in folder.path.glob(".*.partial"):
        partial.unlink(missing_ok=True)  # of a training that was killed while it wrote
    torch.set_num_threads(1)
    samples = job.data.load()
    seed = job.suite.seed
    start = untrained(job.suite.hyperparameters.hidden_layers, seed)
    fit = Fit(read_network(job.network) if job.network else start, samples, job.settings, seed)
    wall_s = _restore(fit, folder, job)
    logger = configure(str(folder.tensorboard), ["tensorboard"])
    while not fit.finished:
        _log(logger, fit.curve[-1])
        report(fit.curve[-1])
        if stop():
            logger.close()
            raise Interrupted
        began = time.monotonic()
        fit.step()
        wall_s += time.monotonic() - began
        progress = {"key": job.key, "wall_s": wall_s}
        folder.write_checkpoint({**fit.arrays(), "progress": np.array(json.dumps(progress))})
    _log(logger, fit.curve[-1])
    logger.close()
    report(fit.curve[-1])
    decision_hz = str(job.data.settings.decision_hz)
    facts = {"stage": job.name, "style": job.style, "decision_hz": decision_hz}
    checked = export(fit.network, folder.network, facts, samples.observations)
    supervised.write_csv(folder.curve_csv, fit.curve)
    supervised.write_png(folder.curve_png, fit.curve, f"{job.name} ({job.style})")
    held_out = int(samples.held_out.sum())
    results = {
        "export_check": checked,
        "used": {"training": len(samples.labels) - held_out, "held_out": held_out},
        "before": asdict(fit.curve[0]),
        "after": asdict(fit.curve[-1]),
        "wall_s": round(wall_s, 1),
    }
    write_manifest(folder, job, suite_sha256, results)
    return folder


def _log(logger: Logger, point: Epoch) -> None:
    for name, value in asdict(point).items():
        if name != "epoch" and value is not None:
            logger.record(f"charms/{name}", value)
    logger.dump(point.epoch)


def _restore(fit: Fit, folder: StageFolder, job: HumanJob) -> float:
    """Goes back to the last checkpoint, if there is one; the seconds it took to get there."""
    stored = folder.read_checkpoint()
    if stored is None:
        return 0.0
    try:
        progress = json.loads(str(stored["progress"]))
        if progress["key"] != job.key:
            raise ValueError("it is that of other settings")
        fit.load_arrays(stored)
        return float(progress["wall_s"])
    except (KeyError, ValueError, TypeError, RuntimeError) as error:
        raise RunFolderError(
            f"{folder.checkpoint}: cannot be continued: {error}; delete it to begin this stage anew"
        ) from error
