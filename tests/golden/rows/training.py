"""The networks that each kind of stage of the training suites makes in 20,000 steps."""

import hashlib
import os
import subprocess
import sys
from functools import partial
from pathlib import Path
from types import SimpleNamespace

from rows.cells import PROJECT
from rows.history import earlier_networks
from rows.recording import write_recording

STEPS = 20_000
PORTABLE = {
    "ATEN_CPU_CAPABILITY": "default",
    "MKL_CBWR": "COMPATIBLE",
    "OPENBLAS_CORETYPE": "Nehalem",
}
"""Without it, the bits of torch's arithmetic depend on the processor."""
KINDS = {
    "train": (
        "people", "level_1", "efficient_egoistic", "efficient_competitive", "safe_altruistic",
        "charms_efficient_egoistic", "best_response",
    ),
    "train-baselines": ("level_1", "prior_level_k", "imitation"),
    "train-paper": ("level_1", "efficient_prosocial", "charms_efficient_prosocial", "imitation"),
}  # fmt: skip
"""A stage of each kind, by training suite."""


def trained(suite: str, stage: str, folder: Path) -> str:
    """Trains a stage in an empty folder; returns the hash of its network's file."""
    done = subprocess.run(
        [sys.executable, "-m", "rows.training", suite, stage, folder],
        cwd=Path(__file__).parents[1],
        env={**os.environ, **PORTABLE},
        check=True,
        stdout=subprocess.PIPE,
        text=True,
    )
    return done.stdout.split()[-1]


def trained_here(suite_name: str, name: str, folder: Path) -> str:
    """The same in this process, whose environment has `PORTABLE`.

    Finished stages are networks of this project, also where a suite would make others, and a
    recording by hand replaces recorded drivers.
    """
    from charms_agents.training.pipeline import _make_job, _sample_store
    from charms_agents.training.stage import train_stage
    from charms_agents.training.suite_file import load_training

    path = PROJECT / "suites" / f"{suite_name}.yaml"
    suite = load_training(path, steps=STEPS)
    recordings = folder / "recordings"
    recordings.mkdir()
    write_recording(recordings)
    human = suite.human_stages.get(name)
    samples = None
    if human is not None and human.drivers == "recorded":
        samples = _sample_store(path, suite, folder, recordings)
    networks = earlier_networks(folder)
    finished = {
        each: SimpleNamespace(file=partial(network_of, networks, suite_name, each))
        for each in suite.names
    }
    job = _make_job(folder, path.parent, suite, samples, name, finished)
    train_stage(job, "", lambda *told: None, lambda: False)
    return hashlib.sha256(job.file(".onnx").read_bytes()).hexdigest()


def network_of(networks: Path, suite: str, stage: str, ending: str) -> Path:
    """Returns a file of a finished stage, from which others start or which drives among them."""
    packaged = PROJECT / "agents" / "charms_agents" / "policies"
    if suite == "train":
        kept = networks / "seed-3012" / f"{stage}{ending}"
        return kept if kept.exists() else packaged / kept.name
    if stage == "level_1":
        return networks / "baselines" / f"level_1{ending}"
    return packaged / f"prior_level_k{ending}"


CASES = {
    f"{suite}: {stage}": partial(trained, suite, stage)
    for suite, stages in KINDS.items()
    for stage in stages
}

if __name__ == "__main__":
    print(trained_here(sys.argv[1], sys.argv[2], Path(sys.argv[3])))
