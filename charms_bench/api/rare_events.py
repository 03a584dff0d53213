"""Estimates the probability of a rare event."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import polars as pl

from charms_bench.api.arguments import PathLike, asked, check_positive
from charms_bench.api.warming import note_roads, warm_up
from charms_bench.foundation.progress import note, progress
from charms_bench.runs.lock import locked
from charms_bench.world.named_road import DRAWN

if TYPE_CHECKING:
    from charms_bench.report.table import Table


@dataclass(frozen=True)
class Rare:
    """The estimated probability of a rare event in every cell of a suite."""

    path: Path
    """The folder."""
    table: "Table"
    """The probability of every cell with its interval, and the number of simulated episodes."""
    runs: pl.DataFrame
    """One row per independent run: `agent`, `traffic`, `run`, `probability`, `episodes`, and the
    lists `thresholds`, `shares` and `acceptance` of its levels. A pilot has no row."""

    def __repr__(self) -> str:
        return f"<Rare {self.path}: {len(self.table.rows)} cells, {self.runs.height} runs>"

    def __str__(self) -> str:
        return f"{self!r}\n{self.table}"

    def _repr_html_(self) -> str:
        return self.table._repr_html_()

    @property
    def files(self) -> list[Path]:
        """The Markdown tables in the folder."""
        return sorted(self.path.glob("tables/*.md"))


def rare(
    suite: PathLike,
    event: str = "crash",
    output: PathLike | None = None,
    *,
    agents: Sequence[str] = (),
    runs: int = 10,
    samples: int = 1000,
    seed: int | None = None,
    workers: int | None = None,
    notice: Callable[[str], None] = note,
) -> Rare:
    """Estimates the probability of a rare event in an episode, or continues; see `Rare`.

    The estimate is subset simulation over an episode's random draws: a pilot, whose episodes are
    not in the estimate, and independent runs.

    Args:
        suite: The YAML file; `episodes` can be left out, because their number does not matter.
        event: `crash`, `ttc:below_s=1.0`, or an event of a plugin.
        output: The folder; by default `runs/NAME-rare-EVENT`, followed by the `agents`.
        agents: Installed agents or paths of networks that drive the ego besides the suite's egos.
        runs: Independent runs per cell, 5 to 1,000; more runs give a narrower interval.
        samples: Episodes per level of a run and of the pilot, a multiple of 5, at least 100.
        seed: Seed of all random draws, instead of the suite's.
        workers: Processes; by default one per core.
        notice: Called with messages about problems that were solved, such as a worker that died.

    Raises:
        CharmsBenchError: The suite, an agent, the event or the folder cannot be used; finished runs
            stay.
        KeyboardInterrupt: It was interrupted; the note names the folder.
    """
    from charms_bench.runs.rare import check_sizes, run_rare
    from charms_bench.runs.rare_task import event_of
    from charms_bench.runs.runner import raise_failed

    check_positive(workers=workers)
    kind = f"-rare-{event.partition(':')[0]}"
    document, loaded, name, folder = asked(suite, output, agents, kind, seed=seed, episodes=1)
    definition = event_of(event).definition
    placing: list[tuple[str | int, ...]] = []
    placing += [("scene", "recording")] if loaded.scene.recording is not None else []
    placing += [("roads", k) for k, road in enumerate(loaded.roads) if road.start != DRAWN]
    for k, entry in enumerate(loaded.traffics):
        placing += [("traffic_models", k, "traffic", "scenario")] if entry.traffic.scenario else []
    if placing:
        what = "rare draws where vehicles start, and this places them; remove it"
        raise document.error(placing[0], what)
    check_sizes(loaded, runs, samples)
    warm_up()
    note_roads(loaded)
    try:
        with progress("pilots and runs", (runs + 1) * len(loaded.cells)) as tell:
            cells, failed = run_rare(loaded, folder, event, runs, samples, workers, tell, notice)
        from charms_bench.report.rare_table import rare_runs, rare_table
        from charms_bench.report.run_files import write_table

        table = rare_table(loaded, name, definition, samples, cells)
        with locked(folder):
            write_table(folder, table)
        raise_failed(loaded, failed, folder)
    except KeyboardInterrupt as interrupt:
        interrupt.add_note(f"finished runs are in {folder}")
        raise
    return Rare(folder, table, rare_runs(cells))
