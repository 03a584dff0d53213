"""Estimates the probability of a rare event in every cell of a suite, in a folder of its own.

The folder has a manifest and one file per finished pilot or run of subset simulation. A file is
written whole or not at all, so an interrupted estimation continues with the runs that are missing.
"""

from collections.abc import Callable, Sequence
from contextlib import closing
from dataclasses import asdict, dataclass, replace
from pathlib import Path

from pydantic import TypeAdapter

from charms_bench.engine.draws import count_of
from charms_bench.errors import CharmsBenchError, InputError
from charms_bench.foundation.progress import Tell
from charms_bench.plugins.specs import networks_of
from charms_bench.runs.checked_result import read_result, write_result
from charms_bench.runs.manifest import opened_for_suite
from charms_bench.runs.rare_task import RareTask, estimate, event_of, software_of
from charms_bench.runs.runner import combined, note_failures, on_this_machine
from charms_bench.runs.shard import forget_agents, traffic_of
from charms_bench.runs.suite import Cell, Suite
from charms_bench.statistics.subset_simulation import LEVEL_PROBABILITY, SubsetRun

FORMAT = 2
MANIFEST = "rare.json"
LEAST_RUNS = 5
"""With fewer, the interval says nothing."""
MOST_RUNS = 1000
LEAST_SAMPLES = 100
"""With fewer, a level often has no episode below its threshold."""
FEW_SAMPLES = 1000
"""With fewer, the intervals of the suite `rare` were wider than those of as many plain episodes, as
docs/stress-tests.md shows."""
DRAWS_LIMIT = 2**27
"""Most random draws of a level, which are kept in memory."""
RUN_LIMIT_S = 4 * 3600.0
"""Far longer than a run takes whose agents answer."""
_SUBSET_RUN = TypeAdapter(SubsetRun)


@dataclass(frozen=True)
class RareCell:
    """The independent runs of one ego in one traffic, after one pilot."""

    cell: Cell
    pilot: SubsetRun
    runs: tuple[SubsetRun, ...]


def check_sizes(suite: Suite, runs: int, samples: int) -> None:
    """Raises an `InputError` if an estimation cannot have so many runs or samples per level."""
    most = DRAWS_LIMIT // max(count_of(cell.scene) for cell in suite.cells)
    if not LEAST_RUNS <= runs <= MOST_RUNS:
        raise InputError(f"runs is {runs}; expected {LEAST_RUNS} to {MOST_RUNS:,}")
    if not LEAST_SAMPLES <= samples <= most or samples % round(1 / LEVEL_PROBABILITY):
        raise InputError(
            f"samples is {samples}; expected a multiple of {1 / LEVEL_PROBABILITY:g} from "
            f"{LEAST_SAMPLES} to {most:,}"
        )


def run_rare(
    suite: Suite,
    output: Path,
    event: str,
    runs: int,
    samples: int,
    workers: int | None,
    tell: Tell,
    notice: Callable[[str], None],
) -> tuple[list[RareCell], dict[int, CharmsBenchError]]:
    """Estimates the probability of an event in every cell; see `charms_bench.rare`.

    Returns the finished cells, and the errors of those whose agents fail, by their indices.
    `tell` is called for every finished run, first for those already in the folder, and `notice`
    with a message about what went wrong and was put right. If a `CharmsBenchError` is raised, the
    folder keeps the runs finished so far.
    """
    if samples < FEW_SAMPLES:
        notice(
            f"{samples} samples per level are few: the intervals are often wider than those of as "
            f"many plain episodes; use --samples {FEW_SAMPLES} or more (in Python: samples)"
        )
    event_of(event)
    failed: dict[int, CharmsBenchError] = {}

    def finished(tasks: Sequence[RareTask]) -> dict[tuple[int, int], SubsetRun]:
        """The runs or pilots of some tasks by their places, from the folder if they are there."""
        kept = {task: read_result(_file(output, task), _SUBSET_RUN) for task in tasks}
        found = {task.place: made for task, made in kept.items() if made is not None}
        for cell, _ in found:
            tell(suite.cells[cell].ego.title, 1)
        missing = [task for task, made in kept.items() if made is None]
        fail = note_failures(suite, failed, notice, missing)
        running = on_this_machine(estimate, workers, missing, RUN_LIMIT_S, notice, fail)
        with closing(running):
            for task, made in running:
                write_result(_file(output, task), asdict(made))
                found[task.place] = made
                tell(suite.cells[task.cell].ego.title, 1)
        return found

    ours = {"format": FORMAT, "event": event, "samples": samples}
    with opened_for_suite(output, MANIFEST, "estimation of a rare event", suite, ours):
        tasks = _pilots(suite, event, samples)
        try:
            pilots = finished(tasks)
            made = finished(
                [
                    replace(
                        task,
                        title=f"{suite.cells[task.cell].title}, run {run}",
                        run=run,
                        pilot=pilots[task.place],
                    )
                    for task in tasks
                    if task.place in pilots  # else it has failed
                    for run in range(1, runs + 1)
                ]
            )
            if len(failed) == len(suite.cells):
                raise combined(suite, failed)
        except CharmsBenchError as error:
            if any(_file(output, pilot).exists() for pilot in tasks):
                error.add_note(f"finished runs are in {output}; the same command continues there")
            raise
    return [
        RareCell(cell, pilots[index, 0], tuple(made[index, run] for run in range(1, runs + 1)))
        for index, cell in enumerate(suite.cells)
        if index not in failed
    ], failed


def damaged_files(folder: Path) -> list[Path]:
    """Returns the files of runs that have changed since they were written."""
    files = sorted((folder / "runs").glob("*.json"))
    return [path for path in files if read_result(path, _SUBSET_RUN) is None]


def _pilots(suite: Suite, event: str, samples: int) -> list[RareTask]:
    """Returns the pilot of each cell."""
    forget_agents()
    tasks = []
    for index, cell in enumerate(suite.cells):
        ego, traffic = cell.ego.agent, cell.traffic.traffic
        networks = networks_of(ego, traffic_of(traffic), suite.folder)
        task = RareTask(
            title=f"{cell.title}, pilot",
            cell=index,
            scene=cell.scene,
            ego=ego,
            traffic=traffic,
            networks=networks,
            software=software_of(ego, traffic, networks, event, cell.road is not None),
            event=event,
            samples=samples,
            seed=suite.seed,
        )
        tasks.append(task)
    return tasks


def _file(folder: Path, task: RareTask) -> Path:
    return folder / "runs" / f"{task.cell:03d}-{task.run:03d}-{task.key[:16]}.json"
