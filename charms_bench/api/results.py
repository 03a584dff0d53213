"""The results of a run: rows, tables, comparisons, episodes."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import cached_property, partial
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING, Any

import polars as pl

from charms_bench.api.arguments import PathLike, check_positive
from charms_bench.api.auditing import audit
from charms_bench.api.warming import warm_up
from charms_bench.errors import InputError, suggestion
from charms_bench.foundation.files import absolute
from charms_bench.foundation.progress import progress
from charms_bench.foundation.words import counted
from charms_bench.runs.cells import CellRows
from charms_bench.runs.finished_run import FinishedRun, open_finished
from charms_bench.runs.lock import locked
from charms_bench.runs.suite import Suite

if TYPE_CHECKING:
    from charms_bench.api.shown import ShownReplay
    from charms_bench.episodes.avoidability import Avoidability
    from charms_bench.episodes.criticality import Kind
    from charms_bench.episodes.dataset import Format
    from charms_bench.episodes.edge_cases import EdgeCase
    from charms_bench.episodes.recorded_cell import RecordedCell
    from charms_bench.episodes.what_if import WhatIf
    from charms_bench.report.audit import Audit
    from charms_bench.report.table import Table


def _labelled(cell: CellRows, rows: pl.DataFrame) -> pl.DataFrame:
    """The rows after the labels of their cell."""
    names = ("agent", "road", "traffic") if cell.road else ("agent", "traffic")
    return rows.select(
        *(pl.lit(each).alias(name) for name, each in zip(names, cell.labels, strict=True)), "*"
    )


class Run:
    """A finished run of a suite. Rows and tables are read from its folder when they are needed.

    Where a method takes `ego`, `road` and `traffic`, they are labels that select cells; by default,
    all. Methods about one episode raise InputError if the labels leave several cells. A label or an
    episode that the run does not have, and one that no longer runs as it was recorded, is a
    RunFolderError.

    Concrete scenarios in which prescribed vehicles collide with one another are left out of
    everything but `replay`, `what_if` and `dataset`; their rows are in the folder.
    """

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
        """Every ego on every road in every traffic, with its episode rows and its step rows."""
        return tuple(self._finished.cells())

    @property
    def episodes(self) -> pl.DataFrame:
        """The episode rows of all cells, with `agent`, `traffic`, and `road` if there are."""
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

    def remarks(self, ego: str | None = None, traffic: str | None = None) -> list[str]:
        """A line about each ego that often commands lanes that do not exist, and what it means.

        The decisions are those of its first cell, or of its first few thousand episodes there.
        """
        from charms_bench.metrics.missing_lanes import MEANING, missing_lanes
        from charms_bench.world.action_texts import actions_described

        cells, first = self.suite.cells, dict[str, int]()
        for index, cell in enumerate(cells):
            if ego in (None, cell.ego.title) and traffic in (None, cell.traffic.title):
                first.setdefault(cell.ego.title, index)
        found = []
        for index in first.values():
            rows = self._finished.cell(index)
            steps, cell = (steps for _, steps in islice(rows.parts, 1)), cells[index]
            identity = self.manifest.get("agents", {}).get(cell.ego.agent.origin, {})
            actions = actions_described(identity.get("actions", "meta"))
            lanes = cell.scene.lanes if cell.road is None else None
            if said := missing_lanes(steps, lanes, actions).remark():
                found.append(f"{cell.title}: {said}")
        return [*found, MEANING] if found else []

    def interfaces(self) -> list[str]:
        """A line about each ego that is a network: what it observes and does, and how often."""
        from charms_bench.plugins.onnx_policy import ASSUMED, OnnxPolicy
        from charms_bench.plugins.registry import is_network
        from charms_bench.world.actions import ACTIONS, meta_actions_of
        from charms_bench.world.observations import NamedObservation, described

        found = []
        for ego in self.suite.egos:
            if not is_network(ego.agent.name):
                continue
            if (path := self._finished.folder.network(ego.agent.name)) is not None:
                policy = OnnxPolicy(path, ego.agent.decision_hz, ego.agent.style)
                assert isinstance(policy.observation, NamedObservation)
                seen, _, _ = described(policy.observation).partition(": (")
                last = policy.history_length
                names = tuple(action.name for action in meta_actions_of(policy.actions))
                does = "meta actions" if names else "continuous actions"
                if names not in ((), ACTIONS):
                    does = f"the meta-actions {', '.join(names)}"
                found.append(
                    f"{ego.title}: observes {seen}{f', the last {last}' if last > 1 else ''}; "
                    f"chooses {does} at {policy.decision_hz:g} Hz"
                    f"{f'; {ASSUMED}' if policy.is_assumed else ''}"
                )
        return found

    @property
    def files(self) -> list[Path]:
        """The tables and figures in the folder that people read."""
        return sorted([*self.path.glob("tables/*.md"), *self.path.glob("figures/*.png")])

    def compare(
        self,
        other: "Run | None" = None,
        egos: tuple[str, str] | None = None,
        metrics: Sequence[str] = (),
        sets: Sequence[str] = (),
    ) -> "Table":
        """Compares two egos over the same episodes.

        Args:
            other: Another run of the same episodes; without one, two egos of this run.
            egos: Labels of the two egos. The second is of the other run if there is one.
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

        pairs = pairs_of(self._finished, None if other is None else other._finished, egos)
        chosen = metric_sets(sets, self.suite.metric_sets)
        return compare(pairs, chosen, self.suite.scene, self.suite.seed, metrics)

    def rescore(self, *sets: str) -> "Table":
        """Computes metrics again from the stored rows and writes the tables into the folder.

        The table of realism stays as it is.

        Args:
            sets: Metric sets, such as `standard:ttc_s=2`; by default those of the suite.

        Returns:
            The table of metrics.
        """
        from charms_bench.report.run_files import measure, run_tables, write_table
        from charms_bench.runs.metric_sets import metric_sets

        found = metric_sets(sets, self.suite.metric_sets)
        with locked(self.path):
            cells = [measure(self.suite, cell, found) for cell in self.cells]
            tables = run_tables(self.suite, cells, (), (), found)
            for table, introduction in tables:
                write_table(self.path, table, introduction)
        return tables[0][0]

    def edge_cases(
        self,
        top: int = 10,
        kind: "Kind | None" = None,
        ego: str | None = None,
        traffic: str | None = None,
        road: str | None = None,
    ) -> "list[EdgeCase]":
        """The most critical episodes, most critical first.

        Args:
            top: How many at most.
            kind: Only episodes of this kind, such as `near-miss`.

        Raises:
            InputError: The kind is unknown.
        """
        from charms_bench.api.shown import Lines
        from charms_bench.episodes.criticality import IS_OF_KIND
        from charms_bench.episodes.edge_cases import edge_cases
        from charms_bench.episodes.recorded_cell import find_cells
        from charms_bench.report.preventable_table import verdicts

        if kind is not None and kind not in IS_OF_KIND:
            known = {str(each): each for each in IS_OF_KIND}
            raise InputError(f"no kind of episode named '{kind}'. {suggestion(kind, known)}")
        cells = find_cells(self._finished, self._suite_folder, ego, traffic, road)
        warm_up()
        found = edge_cases(cells, top, kind)
        if self.suite.preventable_by:
            egos = {*self.suite.preventable_by, *(each.ego for each in found)}
            judged = verdicts(self.suite, [cell for cell in self.cells if cell.agent in egos])
            found = [
                replace(each, preventable=judged.get((*each.labels, each.episode)))
                if each.ego_index is None  # of several egos, an episode has several collisions
                else each
                for each in found
            ]
        return Lines(found)

    def replay(
        self,
        episode: int,
        ego: str | None = None,
        traffic: str | None = None,
        road: str | None = None,
        ego_index: int = 0,
    ) -> "ShownReplay":
        """Simulates the episode with this seed again, with the states of all vehicles.

        `ego_index` is the number of one of several egos.
        """
        from charms_bench.api.shown import ShownReplay
        from charms_bench.episodes.replay import replay

        (found,) = replay(self._cell(ego, traffic, road, ego_index), [episode])
        return ShownReplay(**vars(found))

    def _cell(
        self, ego: str | None, traffic: str | None, road: str | None, ego_index: int = 0
    ) -> "RecordedCell":
        """The only cell with these labels, ready to be simulated."""
        from charms_bench.episodes.recorded_cell import find_cell

        finished, folder = self._finished, self._suite_folder
        cell = find_cell(finished, folder, ego, traffic, road, ego_index=ego_index)
        warm_up()
        return cell

    def dataset(
        self,
        format: "Format",
        output: PathLike | None = None,
        *,
        ego: str | None = None,
        traffic: str | None = None,
        road: str | None = None,
        episodes: int | None = None,
    ) -> Path:
        """Simulates episodes of one cell again and writes them as a dataset for other tools.

        Args:
            format: `minari`, the ego's observations, actions and rewards, which needs the extra
                `dataset`; `highd`, the trajectories of all vehicles in highD's format; or
                `parquet`, their states at every simulation step (`episodes.replay`).
            output: The folder to write, which is returned; by default one in the run folder.
            episodes: How many, from the first; by default all.

        Raises:
            InputError: The folder exists, or a Minari dataset cannot contain the ego's actions.
        """
        from charms_bench.episodes.dataset import write_dataset

        path = None if output is None else absolute(output)
        cell = self._cell(ego, traffic, road)
        with progress("episodes", episodes or self.suite.episodes) as tell:
            title = cell.cell.ego.title
            return write_dataset(cell, format, episodes, path, lambda n: tell(title, n))

    def what_if(
        self,
        episode: int,
        step: int,
        agent: str,
        vehicle: int | None = None,
        ego: str | None = None,
        traffic: str | None = None,
        road: str | None = None,
        ego_index: int = 0,
    ) -> "WhatIf":
        """An episode, and the same episode with another agent driving a vehicle from a decision on.

        Args:
            episode: Its seed.
            step: The first decision of the other agent; an episode's decisions begin with 1.
            agent: The name of an installed agent, or the path of a network.
            vehicle: The vehicle, by its number in replays; by default the ego.
            ego_index: Which of several egos; it is vehicle 0.

        Raises:
            InputError: There is no such decision, vehicle or agent.
        """
        from charms_bench.api.shown import ShownWhatIf
        from charms_bench.episodes.what_if import what_if

        cell = self._cell(ego, traffic, road, ego_index)
        return ShownWhatIf(**vars(what_if(cell, episode, step, agent, vehicle)))

    def avoidability(
        self,
        episodes: Sequence[int] | None = None,
        ego: str | None = None,
        traffic: str | None = None,
        budget: int | None = None,
        road: str | None = None,
        ego_index: int = 0,
    ) -> "list[Avoidability]":
        """Until when collisions of the ego could have been avoided, and by which agents.

        Args:
            episodes: Seeds of episodes of one cell that end with such a collision; by default all
                of them, of all egos in all cells.
            budget: The most decisions to simulate in the search for one collision's escape.
            ego_index: Which of several egos collides in these episodes.

        Raises:
            InputError: An episode does not end with a collision.
        """
        from charms_bench.api.shown import Lines
        from charms_bench.episodes.avoidability import BUDGET, avoidability, collisions
        from charms_bench.episodes.recorded_cell import find_cells

        check_positive(budget=budget)
        warm_up()
        found = []
        if episodes is None:
            cells = find_cells(self._finished, self._suite_folder, ego, traffic, road)
            asked = [(cell, collisions(cell)) for cell in cells]
        else:
            asked = [(self._cell(ego, traffic, road, ego_index), list(episodes))]
        with progress("collisions", sum(len(seeds) for _, seeds in asked)) as tell:
            for cell, seeds in asked:
                done = partial(tell, cell.cell.ego.title)
                found += avoidability(cell, seeds, budget or BUDGET, tell=done)
        return Lines(found)

    def audit(
        self, shards: int | None = 10, seed: int | None = None, workers: int | None = None
    ) -> "Audit":
        """Checks whether the contents of the folder are correct; see `charms_bench.audit`."""
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
        return f"<Run {self.path}: {suite.size}, {counted(suite.episodes, 'episode')} each>"

    def _repr_html_(self) -> str:
        from charms_bench.report.html.table import notebook

        return notebook(self.summary)


def open_run(path: PathLike, suite_folder: PathLike = ".") -> Run:
    """Opens a finished run.

    Args:
        path: Its folder.
        suite_folder: Where relative paths in the suite start, for example paths of recordings.
            Networks given by path are kept in the run folder itself.

    Raises:
        RunFolderError: It holds no run, an unfinished one or a damaged one.
    """
    return Run(open_finished(absolute(path)), absolute(suite_folder))
