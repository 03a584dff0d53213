"""The pipeline `charms`: a training suite -> networks, stage by stage."""

import hashlib
import os
import signal
import sys
import threading
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from types import FrameType

from rich.console import Console

from charms_agents.training.curves import write_curves
from charms_agents.training.human_stage import HumanData, HumanJob
from charms_agents.training.job import Job, StageFolder
from charms_agents.training.progress import progress
from charms_agents.training.schedule import AnyJob, run_stages
from charms_agents.training.settings import Human, TrainingSuite, load_training
from charms_agents.training.stage import Interrupted
from charms_agents.training.summary import write_summary
from charms_bench.errors import InputError
from charms_bench.people.highd import find_trios
from charms_bench.people.samples import fingerprint
from charms_bench.plugins.agent import Agent
from charms_bench.plugins.onnx_policy import OnnxPolicy
from charms_bench.plugins.registry import make_agent
from charms_bench.report.training import render_stages
from charms_bench.runs.document import Document
from charms_bench.runs.lock import locked


def run(
    suite_file: Path,
    output: Path,
    workers: int | None = None,
    only: str | None = None,
    recordings: Path | None = None,
) -> None:
    """Trains the stages of a suite, or goes on with them; a finished one is never trained again.

    Args:
        suite_file: The training suite.
        output: The run folder; every stage has its own in it, named after its inputs, and
            `curves.csv`, `curves.png` and `stages.csv` are of all of them.
        workers: Most stages at a time; by default one a core.
        only: The stage to train, with what it needs; by default all.
        recordings: The folder of human driving, instead of the suite's.

    Raises:
        KeyboardInterrupt: The training was interrupted; `output` holds a checkpoint.
        InputError: The suite, the recordings or the run folder cannot be used.
    """
    suite = load_training(suite_file)
    suite_sha256 = hashlib.sha256(suite_file.read_bytes()).hexdigest()
    if only is not None and only not in suite.needs:
        raise InputError(f"{suite_file}: no stage named '{only}'; it has: {', '.join(suite.needs)}")
    names = suite.order if only is None else suite.needed_for(only)
    console = Console(stderr=True, force_interactive=None if sys.stderr.isatty() else False)

    def say(text: str) -> None:
        console.print(text, highlight=False, markup=False, soft_wrap=True)

    data = None
    if suite.human is not None and set(names) & set(suite.human.stages):
        data = _human_data(suite_file, suite.human, output, recordings)

    def make_job(name: str, finished: Mapping[str, StageFolder]) -> AnyJob:
        if name in suite.human_stages:
            assert data is not None
            return _human_job(name, suite, data, finished)
        return _job(name, suite, finished)

    needs = {name: suite.needs[name] for name in names}
    with locked(output):
        if data is not None:
            data.load()
        with _stop_on_signals() as stop, progress(console) as tell:
            folders = run_stages(
                needs, make_job, output, suite_sha256, workers or os.cpu_count() or 1,
                tell, say, stop,
            )  # fmt: skip
        write_curves(output, suite, folders)
        folders = {name: folders[name] for name in names}
        summary = write_summary(output, folders)
    Console().print(render_stages(summary))


def _human_data(suite_file: Path, human: Human, output: Path, recordings: Path | None) -> HumanData:
    """Where the samples are from."""
    folder = recordings or suite_file.parent / human.recordings
    if not folder.is_dir():
        what = f"no folder '{folder}'; put recordings in highD's format there, or name theirs"
        if recordings is not None:
            raise InputError(f"--recordings: {what}")
        raise Document(suite_file).error(("human", "recordings"), f"{what} with --recordings")
    key = fingerprint(find_trios(folder), human.samples)
    return HumanData(folder, output / "samples", human.samples, key)


def _human_job(
    name: str, suite: TrainingSuite, data: HumanData, finished: Mapping[str, StageFolder]
) -> HumanJob:
    """A stage that learns from human driving, once the one it starts from is finished."""
    assert suite.human is not None
    stage = suite.human.stages[name]
    job = HumanJob(name, suite.human.settings_of(stage), suite, data)
    if stage.fine_tunes is None:
        return job
    network = finished[stage.fine_tunes].network
    sha256 = hashlib.sha256(network.read_bytes()).hexdigest()
    style = suite.stages[stage.fine_tunes]
    words = f"{style.weights}, {style.svo}, fine-tuned on human driving"
    return replace(job, before=stage.fine_tunes, network=network, sha256=sha256, style=words)


def _job(name: str, suite: TrainingSuite, finished: Mapping[str, StageFolder]) -> Job:
    """A stage, once those it needs are finished."""
    stage = suite.stages[name]
    drivers: dict[str, Agent] = {
        driver: OnnxPolicy(finished[driver].network)
        if driver in suite.stages
        else make_agent(driver)
        for driver in suite.traffic_of(stage).agents
    }
    return Job(name, stage, suite, drivers)


@contextmanager
def _stop_on_signals() -> Iterator[Callable[[], bool]]:
    """Turns the first Ctrl-C or SIGTERM into a wish that the training grants.

    Once it has, the signal does what it would have done; a second one does at once.
    """
    if threading.current_thread() is not threading.main_thread():
        yield lambda: False
        return
    wished: list[int] = []

    def wish(number: int, frame: FrameType | None) -> None:
        wished.append(number)
        signal.signal(signal.SIGINT, signal.default_int_handler)
        signal.signal(signal.SIGTERM, before[signal.SIGTERM])

    before = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}
    for number in before:
        signal.signal(number, wish)
    try:
        yield lambda: bool(wished)
    except Interrupted:
        signal.raise_signal(wished[0])
        raise KeyboardInterrupt from None
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
