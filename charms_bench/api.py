"""The Python interface: run a suite, open a run, train networks.

    run = charms_bench.run("suites/ego.yaml", episodes=200)
    run.table.select("speed_mean", "crashed_episodes").frame()
    run.edge_cases(top=3)

The command line is a thin layer over these functions. They import what they need when they run, so
that a run starts at once.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import polars as pl

from charms_bench.engine import ENGINES, EngineName
from charms_bench.errors import InputError, RunFolderError, suggestion
from charms_bench.people.reference import read_references
from charms_bench.plugins.registry import PIPELINES, load
from charms_bench.report.progress import note, progress
from charms_bench.runs import runner
from charms_bench.runs.cells import CellRows
from charms_bench.runs.document import Document
from charms_bench.runs.finished import FinishedRun, open_finished
from charms_bench.runs.folder import MANIFEST
from charms_bench.runs.lock import locked
from charms_bench.runs.runner import SHARD_LIMIT_S
from charms_bench.runs.suite import Cell, Suite, check_networks, suite_of

if TYPE_CHECKING:
    from charms_bench.episodes.avoidability import Avoidability
    from charms_bench.episodes.criticality import Kind
    from charms_bench.episodes.dataset import Format
    from charms_bench.episodes.edge_cases import EdgeCase
    from charms_bench.episodes.replay import Replay
    from charms_bench.episodes.search import Search
    from charms_bench.episodes.what_if import WhatIf
    from charms_bench.report.audit import Audit
    from charms_bench.report.table import Table
    from charms_bench.report.training_tables import Training

PathLike = str | Path


def _labelled(cell: CellRows, rows: pl.DataFrame) -> pl.DataFrame:
    """The rows after the labels of their cell."""
    return rows.select(
        pl.lit(cell.agent).alias("agent"), pl.lit(cell.traffic).alias("traffic"), "*"
    )


class Run:
    """A finished run of a suite. Rows and tables are read from its folder when they are needed."""

    def __init__(self, finished: FinishedRun, suite_folder: Path) -> None:
        self._finished = finished
        self._suite_folder = suite_folder

    @property
    def path(self) -> Path:
        """The run folder."""
        return self._finished.folder.path

    @property
    def suite(self) -> Suite:
        """The suite that was run."""
        return self._finished.suite

    @cached_property
    def manifest(self) -> dict[str, Any]:
        """What was run: the suite, hashes of agents, versions of libraries, the machine."""
        return self._finished.folder.manifest()

    @cached_property
    def cells(self) -> tuple[CellRows, ...]:
        """Every ego in every traffic, each with its episode rows and its step rows."""
        return tuple(self._finished.cells())

    @property
    def episodes(self) -> pl.DataFrame:
        """The episode rows of all cells, with columns `agent` and `traffic`."""
        return pl.concat(_labelled(cell, cell.episodes) for cell in self.cells)

    @property
    def steps(self) -> pl.DataFrame:
        """The step rows of all cells, one per decision, with columns `agent` and `traffic`."""
        return pl.concat(_labelled(cell, cell.steps) for cell in self.cells)

    @property
    def tables(self) -> "Mapping[str, Table]":
        """The tables in the folder, by name: `ego`, `ego-drivers`, `ego-pairs`."""
        from charms_bench.report.stored import stored_tables

        return {table.name: table for table in stored_tables(self.path, self.suite).each()}

    @property
    def table(self) -> "Table":
        """Every metric of every cell."""
        return self.tables[self.suite.suite]

    @property
    def summary(self) -> "Table":
        """The metrics that the suite prints."""
        from charms_bench.report.suite_table import printed

        return printed(self.table, self.suite.columns)

    @property
    def files(self) -> list[Path]:
        """The tables and figures in the folder that people read."""
        return sorted([*self.path.glob("tables/*.md"), *self.path.glob("figures/*.png")])

    def compare(
        self,
        other: "Run | None" = None,
        agents: tuple[str, str] | None = None,
        metrics: Sequence[str] = (),
        sets: Sequence[str] = (),
    ) -> "Table":
        """Compares two agents over the same episodes.

        Args:
            other: Another run of the same episodes; without one, two agents of this run.
            agents: Their labels: of this run, and of the other if there is one.
            metrics: Only these; by default all.
            sets: Metric sets, such as `standard:ttc_s=2`; by default `paper` and `standard`.

        Returns:
            One row per pair, metric set and metric: both values, the difference with its interval,
            and the p-value, corrected for the number of tests.

        Raises:
            InputError: The runs differ in more than the egos, or a name is unknown.
        """
        from charms_bench.report.comparison import compare
        from charms_bench.runs.metric_sets import metric_sets
        from charms_bench.runs.pairing import pairs_of

        pairs = pairs_of(self._finished, None if other is None else other._finished, agents)
        return compare(pairs, metric_sets(sets), self.suite.scene, self.suite.seed, metrics)

    def rescore(self, *sets: str) -> "Table":
        """Computes metrics again from the stored rows and writes the table into the folder.

        Args:
            sets: Metric sets, such as `standard:ttc_s=2`; by default `paper` and `standard`.
        """
        from charms_bench.report.run_files import write_table
        from charms_bench.report.suite_table import suite_table
        from charms_bench.runs.metric_sets import metric_sets

        found = metric_sets(sets)
        with locked(self.path):
            table = suite_table(self.suite, self.cells, found)
            write_table(self.path, table)
        return table

    def edge_cases(
        self,
        top: int = 10,
        kind: "Kind | None" = None,
        agent: str | None = None,
        traffic: str | None = None,
    ) -> "list[EdgeCase]":
        """The most critical episodes, most critical first.

        Args:
            top: How many at most.
            kind: Only episodes of this kind, such as `near-miss`.
            agent: Label of the ego; by default all.
            traffic: Label of the traffic; by default all.

        Raises:
            InputError: The kind is unknown.
            RunFolderError: A label is unknown, or an episode no longer runs as it was recorded.
        """
        from charms_bench.episodes.criticality import IS_OF_KIND
        from charms_bench.episodes.edge_cases import edge_cases
        from charms_bench.episodes.replay import find_cells

        if kind is not None and kind not in IS_OF_KIND:
            known = {str(each): each for each in IS_OF_KIND}
            raise InputError(f"no kind of episode named '{kind}'. {suggestion(kind, known)}")
        cells = find_cells(self._finished, agent, traffic)
        return edge_cases(self._finished, top, kind, cells, self._suite_folder)

    def replay(
        self, episode: int, agent: str | None = None, traffic: str | None = None
    ) -> "Replay":
        """Simulates an episode again, with the states of all vehicles.

        Args:
            episode: Its seed.
            agent: Label of the ego; needed if the run has several.
            traffic: Label of the traffic; needed if the run has several.

        Raises:
            InputError: The labels leave several episodes.
            RunFolderError: The run has no such episode, or it no longer runs as it was recorded.
        """
        from charms_bench.episodes.replay import find_cell, replay

        cell = find_cell(self._finished, agent, traffic)
        return replay(self._finished, cell, [episode], self._suite_folder)[0]

    def dataset(
        self,
        format: "Format",
        output: PathLike | None = None,
        *,
        agent: str | None = None,
        traffic: str | None = None,
        episodes: int | None = None,
    ) -> Path:
        """Simulates episodes again and writes them as a dataset for other tools.

        Args:
            format: `minari`, what the ego observed, did and gained, which needs the extra
                `dataset`; or `highd`, the trajectories of all vehicles in highD's format.
            output: The folder to write; by default one in the run folder.
            agent: Label of the ego; needed if the run has several.
            traffic: Label of the traffic; needed if the run has several.
            episodes: How many, from the first; by default all.

        Returns:
            The folder.

        Raises:
            InputError: The labels leave several egos, the folder exists, or the ego chooses no
                actions that a Minari dataset could have.
            RunFolderError: A label is unknown, or an episode no longer runs as it was recorded.
        """
        from charms_bench.episodes.dataset import write_dataset
        from charms_bench.episodes.replay import find_cell

        run, path = self._finished, None if output is None else Path(output)
        cell = find_cell(run, agent, traffic)
        with progress("episodes", episodes or run.suite.episodes) as tell:
            title = run.suite.cells[cell].ego.title
            return write_dataset(
                run, cell, format, episodes, path, self._suite_folder, lambda n: tell(title, n)
            )

    def what_if(
        self,
        episode: int,
        step: int,
        agent: str,
        vehicle: int | None = None,
        ego: str | None = None,
        traffic: str | None = None,
    ) -> "WhatIf":
        """An episode, and the same episode with another agent in a vehicle from a decision on.

        Args:
            episode: Its seed.
            step: The first decision of the other agent; an episode's decisions begin with 1.
            agent: The name of an installed agent, or the path of a network.
            vehicle: The vehicle, by its number in replays; by default the ego.
            ego: Label of the recorded ego; needed if the run has several.
            traffic: Label of the traffic; needed if the run has several.

        Raises:
            InputError: There is no such decision, vehicle or agent, or the labels leave several
                episodes.
            RunFolderError: The run has no such episode, or it no longer runs as it was recorded.
        """
        from charms_bench.episodes.replay import find_cell
        from charms_bench.episodes.what_if import what_if

        cell = find_cell(self._finished, ego, traffic, "ego and traffic")
        return what_if(self._finished, cell, episode, step, agent, vehicle, self._suite_folder)

    def avoidability(
        self,
        episodes: Sequence[int] | None = None,
        agent: str | None = None,
        traffic: str | None = None,
        budget: int | None = None,
    ) -> "list[Avoidability]":
        """What could have been done about collisions of the ego.

        Args:
            episodes: Seeds of episodes that end with such a collision; by default all of them.
            agent: Label of the ego; by default all.
            traffic: Label of the traffic; by default all.
            budget: The most decisions to simulate in the search for one collision's escape.

        Raises:
            InputError: An episode does not end with a collision, or the labels leave several.
            RunFolderError: A label is unknown, or an episode no longer runs as it was recorded.
        """
        from charms_bench.episodes.avoidability import BUDGET, avoidability, collisions
        from charms_bench.episodes.replay import find_cell, find_cells

        _check_positive(budget=budget)
        run, found = self._finished, []
        if episodes is None:
            asked = {cell: collisions(run, cell) for cell in find_cells(run, agent, traffic)}
        else:
            asked = {find_cell(run, agent, traffic): list(episodes)}
        with progress("collisions", sum(map(len, asked.values()))) as tell:
            for cell, seeds in asked.items():
                title = run.suite.cells[cell].ego.title

                def done(count: int, title: str = title) -> None:
                    tell(title, count)

                folder = self._suite_folder
                found += avoidability(run, cell, seeds, folder, budget or BUDGET, tell=done)
        return found

    def audit(
        self, shards: int | None = 10, seed: int | None = None, workers: int | None = None
    ) -> "Audit":
        """Checks whether the folder is true; see `charms_bench.audit`."""
        return audit(
            self.path, shards=shards, seed=seed, workers=workers, suite_folder=self._suite_folder
        )

    def report(self, output: PathLike = "report.html", top: int = 10) -> Path:
        """Writes tables, figures and replays into one HTML file; returns its path.

        Args:
            output: The file.
            top: How many of the most critical episodes to replay.
        """
        from charms_bench.report.html.report import write_report

        write_report([self.path], Path(output), top, (), self._suite_folder)
        return Path(output)

    def __repr__(self) -> str:
        suite = self.suite
        cells = f"{len(suite.egos)} egos x {len(suite.traffics)} traffics"
        return f"<Run {self.path}: {cells}, {suite.episodes:,} episodes each>"

    def _repr_html_(self) -> str:
        from charms_bench.report.html.table import notebook

        return notebook(self.summary)


def run(
    suite: PathLike,
    output: PathLike | None = None,
    *,
    episodes: int | None = None,
    seed: int | None = None,
    workers: int | None = None,
    engine: EngineName = "batched",
    rows: PathLike | None = None,
    cluster: str | None = None,
    shard_limit_s: float | None = None,
    notice: Callable[[str], None] = note,
) -> Run:
    """Runs a suite, or continues an interrupted run of it; finished parts are never run again.

    Args:
        suite: The YAML file.
        output: The run folder; by default `runs/NAME`.
        episodes: Episodes per cell, instead of the suite's.
        seed: Seed of the first episode, instead of the suite's.
        workers: Processes; by default one per core.
        engine: `batched`, or `highway-env`, the slow reference.
        rows: Another run's folder; episodes that it already has are copied.
        cluster: Address of a Dask scheduler, such as `tcp://HOST:8786`.
        shard_limit_s: Time limit for one shard, including the start of its worker; by default half
            an hour.
        notice: Called with messages about problems that were solved, such as a worker that died.

    Raises:
        CharmsBenchError: The suite, an agent or the folder cannot be used; finished shards stay.
        KeyboardInterrupt: The run was interrupted; its note names the folder.
    """
    if engine not in ENGINES:
        raise InputError(
            f"no engine named '{engine}'. {suggestion(engine, dict.fromkeys(ENGINES))}"
        )
    _check_positive(workers=workers, shard_limit_s=shard_limit_s)
    if cluster is not None and engine != "batched":
        raise InputError("a cluster runs the engine 'batched'; 'highway-env' runs on this machine")
    if cluster is not None and workers is not None:
        raise InputError("workers are processes on this machine; a cluster has its own")
    document = Document(Path(suite))
    if "pipeline" in document.data:
        raise InputError(f"{suite}: is a training suite; use charms_bench.train")
    changes = {"episodes": episodes, "seed": seed}
    document.data |= {name: value for name, value in changes.items() if value is not None}
    loaded = suite_of(document)
    check_networks(document, loaded)
    references = read_references(loaded.references, loaded.folder)
    folder = Path(output or Path("runs") / loaded.suite)
    on_dask = None
    if cluster is not None:
        from charms_bench.runs.cluster import on_cluster

        on_dask = on_cluster(cluster)
    try:
        with progress("episodes", loaded.episodes * len(loaded.cells)) as tell:
            finished = runner.run(
                loaded,
                folder,
                engine,
                workers,
                lambda cell, count: tell(cell.ego.title, count),
                None if rows is None else Path(rows),
                shard_limit_s or SHARD_LIMIT_S,
                notice,
                on_dask,
            )
        from charms_bench.report.run_files import write_run

        with locked(folder):
            following = finished.following() if references else []
            write_run(loaded, folder, finished.cells(), following, references)
    except KeyboardInterrupt as interrupt:
        interrupt.add_note(f"finished shards are in {folder}")
        raise
    return Run(finished, loaded.folder)


def search(
    suite: PathLike,
    agent: str | None = None,
    traffic: str | None = None,
    output: PathLike = "found.yaml",
    *,
    failures: int = 10,
    budget: int = 5000,
    seed: int = 0,
) -> "Search":
    """Searches a scenario's parameters for failures of an agent, and writes them as a suite.

    A failure is a collision that the suite's driver `preventable_by` avoids; in a suite without
    one, any collision.

    Args:
        suite: The YAML file.
        agent: Label of an ego of the suite, or the name of an installed agent; needed if the suite
            has several other egos.
        traffic: Label of the scenario; needed if the suite has several.
        output: The file to write, as soon as there is a failure.
        failures: Number of failures after which the search ends.
        budget: Number of simulated episodes after which the search ends.
        seed: Seed of the search.

    Raises:
        CharmsBenchError: The suite or an agent cannot be used, or a name is unknown.
        KeyboardInterrupt: The search was interrupted; its note names the file.
    """
    from charms_bench.episodes.found import write_found
    from charms_bench.episodes.search import Search, ego_of, scenario_of
    from charms_bench.world.placement import ScenarioError

    _check_positive(failures=failures, budget=budget)
    document = Document(Path(suite))
    loaded = suite_of(document)
    check_networks(document, loaded)
    place = scenario_of(document.path, loaded, traffic)
    reference = next((each for each in loaded.egos if each.title == loaded.preventable_by), None)
    entry = loaded.traffics[place]
    scene = loaded.scene.of_scenario(entry.traffic.scenario)
    cell = Cell(ego=ego_of(document.path, loaded, agent), traffic=entry, scene=scene)
    made = Search(cell, reference, loaded.folder)
    path = Path(output)
    made.found = lambda: write_found(made, document, place, path)
    try:
        with progress("episodes", budget) as tell:
            made.told = lambda episodes: tell(cell.ego.title, episodes)
            made.run(failures, budget, seed)
    except KeyboardInterrupt as interrupt:
        if made.failures:
            interrupt.add_note(f"{len(made.failures)} failures are in {path}")
        raise
    except ScenarioError as error:
        at = ("traffics", place, "traffic", "scenario", *error.location)
        raise document.error(at, str(error)) from error
    if made.failures:
        made.found()
    return made


@dataclass(frozen=True)
class Rare:
    """The estimated probability of a rare event in every cell of a suite."""

    path: Path
    """The folder."""
    table: "Table"
    """The probability of every cell with its interval, and what the estimate cost."""
    runs: pl.DataFrame
    """One row per independent run: `agent`, `traffic`, `run`, `probability`, `episodes`, and the
    lists `thresholds`, `shares` and `acceptance` of its levels."""

    @property
    def files(self) -> list[Path]:
        """The tables in the folder that people read."""
        return sorted(self.path.glob("tables/*.md"))


def rare(
    suite: PathLike,
    event: str = "crash",
    output: PathLike | None = None,
    *,
    runs: int = 10,
    samples: int = 1000,
    seed: int | None = None,
    workers: int | None = None,
    notice: Callable[[str], None] = note,
) -> Rare:
    """Estimates the probability of a rare event in an episode, or continues; see `Rare`.

    The estimate is subset simulation over an episode's random draws, in independent runs.

    Args:
        suite: The YAML file. Its number of episodes does not matter.
        event: `crash`, `ttc:below_s=1.0`, or an event of a plugin.
        output: The folder; by default `runs/NAME-rare-EVENT`.
        runs: Independent runs per cell, 5 to 1,000; more narrow the interval.
        samples: Episodes per level of a run, a multiple of 10 from 100.
        seed: Seed of all random draws, instead of the suite's.
        workers: Processes; by default one per core.
        notice: Called with messages about problems that were solved, such as a worker that died.

    Raises:
        CharmsBenchError: The suite, an agent, the event or the folder cannot be used; finished runs
            stay.
        KeyboardInterrupt: It was interrupted; the note names the folder.
    """
    from charms_bench.runs.rare import run_rare
    from charms_bench.runs.rare_task import event_of

    _check_positive(workers=workers)
    document = Document(Path(suite))
    if "pipeline" in document.data:
        raise InputError(f"{suite}: is a training suite; expected an evaluation")
    document.data |= {} if seed is None else {"seed": seed}
    loaded, definition = suite_of(document), event_of(event).definition
    for index, entry in enumerate(loaded.traffics):
        if entry.traffic.scenario is not None:
            what = "rare draws where vehicles start, and a scenario places them; expected a traffic"
            raise document.error(("traffics", index, "traffic", "scenario"), what)
    check_networks(document, loaded)
    name = f"{loaded.suite}-rare-{event.partition(':')[0]}"
    folder = Path(output or Path("runs") / name)
    try:
        with progress("runs", runs * len(loaded.cells)) as tell:
            cells = run_rare(
                loaded,
                folder,
                event,
                runs,
                samples,
                workers,
                lambda cell, count: tell(cell.ego.title, count),
                notice,
            )
        from charms_bench.report.rare_table import rare_runs, rare_table
        from charms_bench.report.run_files import write_table

        table = rare_table(loaded, name, definition, samples, cells)
        with locked(folder):
            write_table(folder, table)
    except KeyboardInterrupt as interrupt:
        interrupt.add_note(f"finished runs are in {folder}")
        raise
    return Rare(folder, table, rare_runs(cells))


def open_run(path: PathLike, suite_folder: PathLike = ".") -> Run:
    """Opens a finished run.

    Args:
        path: Its folder.
        suite_folder: Where relative paths in the suite start, of recordings for example. Networks
            given by path are kept in the run folder itself.

    Raises:
        RunFolderError: It holds no run, an unfinished one or a damaged one.
    """
    return Run(open_finished(Path(path)), Path(suite_folder))


def audit(
    path: PathLike,
    *,
    shards: int | None = 10,
    seed: int | None = None,
    workers: int | None = None,
    suite_folder: PathLike = ".",
    notice: Callable[[str], None] = note,
) -> "Audit":
    """Checks whether a run folder is true; nothing in it is changed.

    It compares the software, files, networks, rows and tables in the folder with the manifest, with
    a new simulation of some shards, and with tables computed from the rows.

    Args:
        path: The folder of an evaluation. Of other folders, it checks what it can.
        shards: How many shards to simulate again; None is all.
        seed: Chooses the shards; by default another seed each time.
        workers: Processes; by default one per core.
        suite_folder: Where relative paths in the suite start.
        notice: Called with messages about problems that were solved, such as a worker that died.

    Raises:
        RunFolderError: The folder holds no run, or its manifest is damaged.
        CharmsBenchError: A shard cannot be simulated.
    """
    from charms_bench.report.audit import Audit, audit_tables
    from charms_bench.report.stored import holds
    from charms_bench.runs.audit import Asked, audit_rare, audit_run
    from charms_bench.runs.folder import CHECKSUMS, RunFolder
    from charms_bench.runs.rare import MANIFEST as RARE

    _check_positive(shards=shards, workers=workers)
    path = Path(path)
    if not holds(path, MANIFEST):
        if holds(path, RARE):
            return Audit(path, tuple(audit_rare(path)))
        raise RunFolderError(
            f"{path}: holds no evaluation ({MANIFEST}); a training is checked by training it again"
        )
    folder = RunFolder(path)
    suite = folder.suite().model_copy(update={"folder": Path(suite_folder)})
    # Before the agents of the run are imported, which could change how tables are computed.
    tables = list(audit_tables(path, suite))
    count = len(list((path / CHECKSUMS).glob("*.sha256")))
    with progress("shards", min(shards or count, count) or 1) as tell:
        found = audit_run(
            folder,
            suite,
            Asked(shards, seed, workers),
            lambda cell, episodes: tell(cell.ego.title, 1),
            notice,
        )
        return Audit(path, (*found, *tables))


def _check_positive(**options: float | None) -> None:
    for name, value in options.items():
        if value is not None and value <= 0:
            raise InputError(f"{name} is {value}; expected a number above 0")


def train(
    suite: PathLike,
    output: PathLike | None = None,
    *,
    workers: int | None = None,
    only: str | None = None,
    recordings: PathLike | None = None,
) -> "Training":
    """Trains the networks of a training suite, or continues; needs the extra `train`.

    Args:
        suite: The YAML file.
        output: The run folder; by default `runs/NAME`, with the name of the file.
        workers: Most stages at a time; by default one per core.
        only: The stage to train, with those that it needs; by default all.
        recordings: The folder of human recordings, instead of the suite's.

    Raises:
        CharmsBenchError: The suite, the recordings or the folder cannot be used.
        KeyboardInterrupt: The training was interrupted; its note names the folder.
    """
    _check_positive(workers=workers)
    document = Document(Path(suite))
    if "pipeline" not in document.data:
        raise InputError(f"{suite}: is not a training suite; use charms_bench.run")
    name = document.data["pipeline"]
    if not isinstance(name, str):
        raise document.error(("pipeline",), f"expected the name of a pipeline, found {name!r}")
    folder = Path(output or Path("runs") / document.path.stem)
    pipeline = load(PIPELINES, name)
    try:
        pipeline(document.path, folder, workers, only, recordings and Path(recordings))
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

    if holds(Path(path), MANIFEST):
        raise RunFolderError(f"{path}: holds an evaluation; use charms_bench.open_run")

    training = stored_training(Path(path))
    if training.stages is None and training.curves is None:
        raise RunFolderError(
            f"{path}: holds no evaluation ({MANIFEST}) and no finished training ({STAGES})"
        )
    return training
