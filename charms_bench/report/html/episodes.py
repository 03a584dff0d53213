"""Which episodes a report shows: the most critical of all runs, and those that are asked for."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import polars as pl

from charms_bench.episodes.criticality import criticality
from charms_bench.episodes.edge_cases import ranked
from charms_bench.episodes.replay import Replay, find_cell, replay
from charms_bench.episodes.what_happened import what_happened
from charms_bench.errors import InputError, RunFolderError
from charms_bench.report.html.sources import Evaluation


@dataclass(frozen=True)
class Episode:
    """An episode of a report."""

    id: str
    """What links call it: its run's key, its cell's place and its seed."""
    run: str
    """Title of its run, or its key."""
    criticality: float
    what: str
    """What happened, in a line."""
    replay: Replay


@dataclass(frozen=True)
class Asked:
    """An episode that somebody names."""

    run: Evaluation
    cell: int
    episode: int


def asked(text: str, runs: Sequence[Evaluation]) -> Asked:
    """The episode of `RUN:EPISODE[:EGO[:TRAFFIC]]`; with one run `EPISODE` is enough.

    Raises:
        InputError: It is written otherwise, or there is no such run, or several such episodes.
    """
    names = {name: run for run in runs for name in (str(run.path), run.path.name, run.key)}
    name = max((name for name in names if text.startswith(f"{name}:")), key=len, default=None)
    if name is None and len(runs) > 1:
        raise InputError(
            f"--episode {text}: expected RUN:EPISODE[:EGO[:TRAFFIC]], RUN one of "
            f"{', '.join(run.key for run in runs)}"
        )
    run = runs[0] if name is None else names[name]
    rest = text if name is None else text.removeprefix(f"{name}:")
    seed, *titles = rest.split(":", 2)
    try:
        episode = int(seed)
    except ValueError as error:
        raise InputError(
            f"--episode {text}: expected RUN:EPISODE[:EGO[:TRAFFIC]], EPISODE a number; "
            f"found '{seed}'"
        ) from error
    ego, traffic = [*titles, None, None][:2]
    how = f"--episode {run.key}:{seed}:EGO:TRAFFIC"
    return Asked(run, find_cell(run.run, ego, traffic, how), episode)


def choose(
    runs: Sequence[Evaluation], top: int, named: Sequence[Asked], folder: Path
) -> list[Episode]:
    """The episodes that are named, then the `top` most critical of all runs, simulated again.

    Episodes that two runs share are shown once.

    Args:
        runs: Where to look.
        top: How many of the most critical.
        named: Episodes to show whatever happens in them.
        folder: Where paths of networks in suites start.

    Raises:
        CharmsBenchError: As for `replay.replay`.
    """
    wanted = [
        {"run": runs.index(each.run), "cell": each.cell, "episode": each.episode} for each in named
    ]
    wanted += _most_critical(runs, top) if top else []
    once = list({tuple(row.values()): row for row in wanted}.values())
    found: dict[tuple[int, int, int], Episode] = {}
    for index, run in enumerate(runs):
        for cell in sorted({row["cell"] for row in once if row["run"] == index}):
            seeds = [row["episode"] for row in once if row["run"] == index and row["cell"] == cell]
            for replayed in _replays(run, cell, seeds, folder):
                found[index, cell, replayed.episode] = _episode(run, cell, replayed)
    return [found[row["run"], row["cell"], row["episode"]] for row in once]


def _most_critical(runs: Sequence[Evaluation], top: int) -> list[dict[str, Any]]:
    frames = []
    for index, run in enumerate(runs):
        cells = range(len(run.run.suite.cells))
        # Enough that those which other runs have too can be left out.
        best = ranked(run.run, cells).head(top * len(runs))
        shards = [_shard(run, cell, episode) for cell, episode in best["cell", "episode"].rows()]
        frames.append(
            best.select(
                pl.lit(index).alias("run"), "cell", pl.col("episode").cast(pl.Int64), "criticality"
            ).with_columns(shard=pl.Series(shards, dtype=pl.String))
        )
    if not frames:
        return []
    return (
        pl.concat(frames)
        .unique(["shard", "episode"], keep="first", maintain_order=True)
        .sort("criticality", descending=True, maintain_order=True)
        .head(top)
        .select("run", "cell", "episode")
        .to_dicts()
    )


def _shard(run: Evaluation, cell: int, episode: int) -> str:
    """The key of an episode's shard, which names everything that its rows depend on."""
    return next(
        shard.key
        for shard in run.run.shards
        if shard.cell == cell and 0 <= episode - shard.first_seed < shard.episodes
    )


def _replays(run: Evaluation, cell: int, seeds: list[int], folder: Path) -> list[Replay]:
    try:
        return replay(run.run, cell, seeds, folder)
    except RunFolderError as error:
        raise RunFolderError(f"{error}. `--top 0` makes a report without replays") from error


def _episode(run: Evaluation, cell: int, replayed: Replay) -> Episode:
    measured = criticality(replayed.episodes, replayed.steps, replayed.settings)
    return Episode(
        id=f"{run.key}-{cell}-{replayed.episode}",
        run=run.run.suite.title or run.key,
        criticality=measured["criticality"].item(),
        what=what_happened(replayed),
        replay=replayed,
    )
