"""Compares an episode that is simulated again with the rows of the run."""

from collections.abc import Sequence
from pathlib import Path

import polars as pl

from charms_bench.episodes.cell_simulation import Networks, networks_in
from charms_bench.errors import RunFolderError
from charms_bench.runs.finished import FinishedRun
from charms_bench.runs.shard import identify_agents


def recorded_steps(run: FinishedRun, cell: int, episodes: Sequence[int]) -> pl.DataFrame:
    """Returns the step rows of these episodes from the run folder.

    Raises:
        RunFolderError: The run has no such episode, or a file has changed since it was written.
    """
    first, last = run.suite.seed, run.suite.seed + run.suite.episodes - 1
    for episode in episodes:
        if not first <= episode <= last:
            raise RunFolderError(
                f"{run.folder.path}: holds the episodes {first} to {last}, not {episode}"
            )
    shards = [
        shard
        for shard in run.shards
        if shard.cell == cell
        and any(0 <= episode - shard.first_seed < shard.episodes for episode in episodes)
    ]
    return run.folder.read("steps", shards).filter(pl.col("episode").is_in(list(episodes)))


def check_steps(
    run: FinishedRun, cell: int, folder: Path, stored: pl.DataFrame, again: pl.DataFrame
) -> None:
    """Checks that episodes have the step rows of the run.

    Args:
        run: A finished run.
        cell: The index of the cell.
        folder: Where relative paths of networks in the suite start.
        stored: The rows of `recorded_steps`.
        again: The rows of the same episodes, simulated again.

    Raises:
        RunFolderError: A row differs.
    """
    if again.equals(stored):
        return
    both = stored.join(again, on=["episode", "step"], how="full", coalesce=True, suffix="_now")
    differing = [
        (row["episode"], row["step"], name, row[name], row[f"{name}_now"])
        for row in both.iter_rows(named=True)
        for name in stored.columns
        if name not in ("episode", "step") and row[name] != row[f"{name}_now"]
    ]
    episode, step, name, then, now = min(differing, key=lambda difference: difference[:2])
    raise RunFolderError(
        f"{run.folder.path}: episode {episode} of {run.suite.cells[cell].ego.title} "
        f"no longer follows the recorded trajectory: step {step}, {name} was {then}, now {now}. "
        f"{_reason(run, cell, networks_in(run, cell, folder))}"
    )


def _reason(run: FinishedRun, cell: int, networks: Networks) -> str:
    """Says which versions the run was made with, agents first."""
    manifest, chosen = run.folder.manifest(), run.suite.cells[cell]
    agents = identify_agents(chosen.ego.agent, chosen.traffic.traffic, networks)
    recorded = manifest.get("agents", {})
    changed = [name for name, identity in agents.items() if recorded.get(name) != identity]
    made = (
        f"was made with charms-bench {manifest.get('charms_bench')} and {manifest.get('versions')}"
    )
    used = f"used other versions of {', '.join(changed)}" if changed else made
    return f"The run {used}; install those to replay it"
