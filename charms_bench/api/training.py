"""Trains networks, and opens the folder of a training."""

from pathlib import Path
from typing import TYPE_CHECKING

from charms_bench.api.arguments import PathLike, check_positive
from charms_bench.api.warming import warm_up
from charms_bench.errors import InputError, RunFolderError
from charms_bench.foundation.files import absolute
from charms_bench.plugins.registry import PIPELINES, load
from charms_bench.runs.document import Document
from charms_bench.runs.resumable_folder import MANIFEST

if TYPE_CHECKING:
    from charms_bench.report.training_tables import Training


def train(
    suite: PathLike,
    output: PathLike | None = None,
    *,
    workers: int | None = None,
    only: str | None = None,
    recordings: PathLike | None = None,
    seed: int | None = None,
    steps: int | None = None,
) -> "Training":
    """Trains the networks of a training suite, or continues; needs the extra `train`.

    Args:
        suite: The YAML file.
        output: The run folder; by default `runs/NAME`, with the name of the file.
        workers: How many stages to train at the same time; by default one per core.
        only: The stage to train, with those that it needs; by default all.
        recordings: The folder of human recordings, instead of the suite's.
        seed: The seed of every stage, instead of the suite's.
        steps: The environment steps of every stage that has some, instead of the suite's: fewer
            for a trial. The networks of other steps stay in the folder.

    Raises:
        CharmsBenchError: The suite, the recordings or the folder cannot be used.
        KeyboardInterrupt: The training was interrupted; its note names the folder.
    """
    check_positive(workers=workers, steps=steps)
    document = Document(Path(suite))
    if "pipeline" not in document.data:
        raise InputError(f"{suite}: is not a training suite; use charms_bench.run")
    name = document.data["pipeline"]
    if not isinstance(name, str):
        raise document.error(("pipeline",), f"expected the name of a pipeline, found {name!r}")
    folder = absolute(output or Path("runs") / document.path.stem)
    file, recordings = absolute(document.path), recordings and absolute(recordings)
    pipeline = load(PIPELINES, name)
    warm_up()
    try:
        pipeline(file, folder, workers, only, recordings, seed, steps)
    except KeyboardInterrupt as interrupt:
        interrupt.add_note(f"checkpoints are in {folder}")
        raise
    return open_training(folder)


def open_training(path: PathLike) -> "Training":
    """Opens the run folder of a training.

    Raises:
        RunFolderError: It holds no training, or a damaged one.
    """
    from charms_bench.report.stored import holds
    from charms_bench.report.training_tables import STAGES, stored_training

    path = absolute(path)
    if holds(path, MANIFEST):
        raise RunFolderError(f"{path}: holds an evaluation; use charms_bench.open_run")

    training = stored_training(path)
    if training.stages is None and training.curves is None:
        raise RunFolderError(
            f"{path}: holds no evaluation ({MANIFEST}) and no finished training ({STAGES})"
        )
    return training
