"""The pipeline `charms`: trains the networks of a training suite, stage by stage."""

import hashlib
import os
import signal
import sys
import threading
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from types import FrameType

from rich.console import Console

from charms_agents.human.samples import SampleStore
from charms_agents.training.job import Job, human_job, reinforcement_job
from charms_agents.training.schedule import run_stages
from charms_agents.training.settings import SimulatedDrivers, Stage, TrainingSuite
from charms_agents.training.stage import Interrupted
from charms_agents.training.stage_progress import progress
from charms_agents.training.suite_file import load_training
from charms_agents.training.summary import write_curves, write_summary
from charms_bench.errors import InputError
from charms_bench.plugins.agent import Agent
from charms_bench.plugins.onnx_policy import OnnxPolicy
from charms_bench.plugins.registry import is_network, make_agent
from charms_bench.runs.document import Document
from charms_bench.runs.lock import locked
from charms_bench.world.observations import Neighbours


def run(
    suite_file: Path,
    output: Path,
    workers: int | None = None,
    only: str | None = None,
    recordings: Path | None = None,
    seed: int | None = None,
    steps: int | None = None,
) -> None:
    """Trains the stages of a suite that are not finished, each from its last checkpoint.

    Each stage has a folder in `output`, whose name contains a hash of the stage's inputs;
    `networks` has the networks, manifests and curves of all stages by name; `curves.csv`,
    `curves.png`, `stages.csv` and `columns.json` cover all stages. See `charms_bench.train` for the
    other arguments.

    Raises:
        KeyboardInterrupt: The training was interrupted; `output` holds checkpoints.
        InputError: The suite, the recordings or the run folder cannot be used.
    """
    suite = load_training(suite_file, seed, steps)
    suite_sha256 = hashlib.sha256(suite_file.read_bytes()).hexdigest()
    if only is not None and only not in suite.needs:
        raise InputError(f"{suite_file}: no stage named '{only}'; it has: {', '.join(suite.needs)}")
    names = suite.order if only is None else suite.needed_for(only)
    console = Console(stderr=True, force_interactive=None if sys.stderr.isatty() else False)

    def say(text: str) -> None:
        console.print(text, highlight=False, markup=False, soft_wrap=True)

    samples = None
    if any(
        suite.human_stages[name].drivers == "recorded" for name in names if name not in suite.stages
    ):
        samples = _sample_store(suite_file, suite, output, recordings)

    needs = {name: suite.needs[name] for name in names}
    with locked(output):
        if samples is not None:
            samples.load()
        with _stop_on_signals() as stop, progress(console) as tell:
            make_job = partial(_make_job, output, suite_file.parent, suite, samples)
            workers = workers or os.cpu_count() or 1
            finished = run_stages(needs, make_job, suite_sha256, workers, tell, say, stop)
        jobs = {name: finished[name] for name in names}
        for job in jobs.values():
            job.publish()
        write_curves(output, suite, jobs)
        write_summary(output, jobs.values())


def _sample_store(
    suite_file: Path, suite: TrainingSuite, output: Path, recordings: Path | None
) -> SampleStore:
    """The samples of the recordings, which are kept in the run folder."""
    assert suite.human is not None
    folder = recordings or suite_file.parent / suite.human.recordings
    if not folder.is_dir():
        if recordings is not None:
            what = "expected the folder of recordings in highD's format"
            raise InputError(f"--recordings: no folder '{folder}'; {what}")
        what = f"no folder '{folder}'; name one in highD's format with --recordings"
        raise Document(suite_file).error(("human", "recordings"), what)
    assert isinstance(suite.observed, Neighbours)
    seen = suite.observed, suite.interface
    store = SampleStore(folder, output / "samples", suite.human.samples, *seen)
    store.fingerprint  # noqa: B018  # names unusable recordings before the run folder is made
    return store


def _make_job(
    output: Path,
    folder: Path,
    suite: TrainingSuite,
    samples: SampleStore | None,
    name: str,
    finished: Mapping[str, Job],
) -> Job:
    """The job of a stage whose needs are finished, of a suite in a folder."""

    def network(stage: str) -> Path:
        return finished[stage].file(".onnx")

    def agent(driver: str) -> Agent:
        if driver in suite.names:
            return OnnxPolicy(network(driver))
        return OnnxPolicy(folder / driver) if is_network(driver) else make_agent(driver)

    def drivers(stage: Stage | SimulatedDrivers | None) -> dict[str, Agent]:
        others = suite.drivers_of(stage) if stage else ()
        return {each: agent(each) for each in others if each != name}

    if (stage := suite.stages.get(name)) is not None:
        prior = network(stage.prior) if stage.prior else None
        return reinforcement_job(output, name, suite, drivers(stage), prior)
    assert suite.human is not None
    human = suite.human.stages[name]
    start = network(human.fine_tunes) if human.fine_tunes else None
    if human.drivers == "simulated":
        among, samples = drivers(suite.human.simulated), None
    else:
        among = drivers(suite.stages[human.fine_tunes] if human.fine_tunes else None)
    return human_job(output, name, suite, samples, start, among)


@contextmanager
def _stop_on_signals() -> Iterator[Callable[[], bool]]:
    """Turns the first Ctrl-C or SIGTERM into a request to stop, which the result returns.

    When the training has stopped, the signal has its usual effect. A second signal has it at once.
    """
    if threading.current_thread() is not threading.main_thread():
        yield lambda: False
        return
    requests: list[int] = []

    def request(number: int, frame: FrameType | None) -> None:
        requests.append(number)
        signal.signal(signal.SIGINT, signal.default_int_handler)
        signal.signal(signal.SIGTERM, before[signal.SIGTERM])

    before = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}
    for number in before:
        signal.signal(number, request)
    try:
        yield lambda: bool(requests)
    except Interrupted:
        signal.raise_signal(requests[0])
        raise KeyboardInterrupt from None
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
