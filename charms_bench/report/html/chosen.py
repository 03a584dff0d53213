"""Chooses the episodes of a report and simulates them again."""

import os
import re
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

from charms_bench.episodes.edge_cases import ranked
from charms_bench.episodes.recorded_cell import RecordedCell, find_cell, find_cells
from charms_bench.episodes.replay import Replay, replay
from charms_bench.episodes.what_if import WhatIf, what_if
from charms_bench.errors import InputError, RunFolderError, suggestion
from charms_bench.report.html.sources import Evaluation
from charms_bench.report.sentences import CRASHED

Place = tuple[int, int, int]
"""Where an episode is: the place of its run, the place of its cell, and its seed."""


def asked(text: str, runs: Sequence[Evaluation]) -> Place:
    """The episode of `RUN:EPISODE[:EGO[:TRAFFIC]]`; with one run `EPISODE` is enough.

    An `InputError` if it is written in another way, or there is no such episode, or several.
    """
    expected = f"--episode {text}: expected RUN:EPISODE[:EGO[:TRAFFIC]]"
    names = {name: run for run in runs for name in _names(run)}
    name = max((name for name in names if text.startswith(f"{name}:")), key=len, default=None)
    if name is None and len(runs) > 1:
        keys = ", ".join(run.key for run in runs)
        raise InputError(f"{expected}, RUN one of {keys}")
    run = runs[0] if name is None else names[name]
    rest = text if name is None else text.removeprefix(f"{name}:")
    seed, *titles = rest.split(":", 2)
    try:
        episode = int(seed)
    except ValueError as error:
        raise InputError(f"{expected}, EPISODE a number; found '{seed}'") from error
    ego, traffic = [*titles, None, None][:2]
    road, suite = None, run.run.suite
    if suite.roads and traffic is not None:
        known = {each.title: each for each in suite.surroundings}
        if traffic not in known:
            raise InputError(f"{expected}; no '{traffic}'. {suggestion(traffic, known)}")
        road, traffic = (each.title for each in known[traffic] if each is not None)
    how = f"--episode {run.key}:{seed}:EGO:{'ROAD, ' * bool(suite.roads)}TRAFFIC"
    found = find_cell(run.run, Path(), ego, traffic, road, how)
    return list(runs).index(run), found.index, episode


def _names(run: Evaluation) -> tuple[str, ...]:
    """What users may call a run: its folder in three ways, or its key."""
    return str(run.path), os.path.relpath(run.path), run.path.name, run.key


class Chosen(NamedTuple):
    """An episode of a report."""

    name: str
    """What links call it."""
    place: Place
    replay: Replay


def choose(
    runs: Sequence[Evaluation], top: int, named: Sequence[Place], folder: Path
) -> list[Chosen]:
    """The named episodes, then the `top` most critical of all runs, simulated again.

    An episode that two runs share is shown once. Relative paths of networks start at `folder`.
    Raises what `replay.replay` does.
    """
    wanted = list(dict.fromkeys([*named, *(_most_critical(runs, top) if top else [])]))
    return _simulated(runs, wanted, folder)


def choose_beside(
    runs: Sequence[Evaluation], chosen: Sequence[Chosen], folder: Path
) -> list[Chosen]:
    """Another ego in each of the chosen episodes, simulated again; those of one ego have none.

    Of the other egos, it is the one that crashes least in this traffic.
    """
    wanted = dict.fromkeys(_beside(runs, each.place) for each in chosen)
    known = {each.place for each in chosen}
    return _simulated(runs, [place for place in wanted if place and place not in known], folder)


def _beside(runs: Sequence[Evaluation], place: Place) -> Place | None:
    index, cell, seed = place
    cells, metrics = runs[index].run.suite.cells, runs[index].tables.metrics
    column = metrics.places(CRASHED)
    rates = {row.labels: row.numbers[column[0]].value for row in metrics.rows if column}
    ranked = [
        (rates.get(each.labels) or 0.0, other)
        for other, each in enumerate(cells)
        if other != cell and each.surroundings == cells[cell].surroundings
    ]
    return (index, min(ranked)[1], seed) if ranked else None


def _simulated(runs: Sequence[Evaluation], wanted: Sequence[Place], folder: Path) -> list[Chosen]:
    """The episodes at these places, simulated again."""
    found: dict[Place, Chosen] = {}
    for index, cell in sorted({place[:2] for place in wanted}):
        seeds = [seed for *place, seed in wanted if (index, cell) == tuple(place)]
        try:
            replays = replay(RecordedCell(runs[index].run, cell, folder), seeds)
        except RunFolderError as error:
            raise RunFolderError(f"{error}. `--top 0` makes a report without replays") from error
        for each in replays:
            place = (index, cell, each.episode)
            found[place] = Chosen(_name(runs, place), place, each)
    return [found[place] for place in wanted]


def futures(
    text: str, runs: Sequence[Evaluation], named: Sequence[Place], folder: Path
) -> dict[str, WhatIf]:
    """Another future of each named episode, as `STEP:AGENT[:VEHICLE]` says, by its name.

    An `InputError` if it is written in another way, no episode is named, or one has no such
    decision, vehicle or agent; else what `replay.replay` raises.
    """
    found = re.fullmatch(r"([0-9]+):(.+?)(?::([0-9]+))?", text)
    if found is None:
        raise InputError(f"--what-if {text}: expected STEP:AGENT[:VEHICLE], such as 43:idm_mobil")
    if not named:
        raise InputError("--what-if needs the episodes that --episode names")
    step, agent, vehicle = int(found[1]), found[2], None if found[3] is None else int(found[3])
    return {
        _name(runs, place): what_if(
            RecordedCell(runs[place[0]].run, place[1], folder), place[2], step, agent, vehicle
        )
        for place in named
    }


def _name(runs: Sequence[Evaluation], place: Place) -> str:
    """What links call an episode: the key of its run, the place of its cell, and its seed."""
    index, cell, seed = place
    return f"{runs[index].key}-{cell}-{seed}"


def _most_critical(runs: Sequence[Evaluation], top: int) -> list[Place]:
    found: dict[tuple[str, int], tuple[float, Place]] = {}
    for index, run in enumerate(runs):
        # Enough that episodes which other runs have too can be left out.
        best = ranked(find_cells(run.run, Path(), ego_index=0)).head(top * len(runs))
        for value, cell, episode in best.select("criticality", "cell", "episode").rows():
            # The key of its shard names everything that the rows of an episode depend on.
            key = next(
                shard.key
                for shard in run.run.shards
                if shard.cell == cell and 0 <= episode - shard.first_seed < shard.episodes
            )
            found.setdefault((key, episode), (value, (index, cell, episode)))
    return [place for _, place in sorted(found.values(), key=lambda each: -each[0])[:top]]
