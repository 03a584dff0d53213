"""Replays the actions of golden traces, and compares every hash and every number."""

import json
from collections.abc import Callable, Iterator, Mapping
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray
from recorded_traces import OF_VEHICLES, Episode, Floats, Traces, hash_of

Numbers = dict[str, Floats]
"""The canonical numbers of each quantity in a frame."""


class Replayed(Protocol):
    """Episodes of this project with one configuration, which advance together."""

    def start(self, seeds: NDArray[np.uint64]) -> list[Numbers]:
        """Starts all episodes; returns the frame of each."""

    def step(self, actions: NDArray[Any]) -> list[Numbers]:
        """Carries out the actions (B, agents, ...) of a decision; returns the frame of each."""

    def words(self) -> NDArray[np.uint64]:
        """[B, 6] the states of the random generators."""

    def start_again(self, row: int) -> Numbers:
        """Starts an episode with the random generator as it is; returns its frame."""

    def place(self, row: int, placed: Mapping[str, float]) -> None:
        """Moves a vehicle; see `Episode.placed`."""


def differences(traces: Traces, made: Callable[[int, dict[str, Any]], Replayed]) -> Iterator[str]:
    """Replays all episodes in what is `made` for so many with one configuration.

    Describes the first difference of each episode.
    """
    groups: dict[str, list[Episode]] = {}
    for each in traces.episodes:
        key = json.dumps([each.config, str(each.actions.dtype), each.actions.shape[1:]])
        groups.setdefault(key, []).append(each)
    for group in groups.values():
        replayed = made(len(group), group[0].config)
        for row, number, what in _differences(traces, group, replayed):
            seed = group[row].seed
            when = f"decision {number}" if number <= group[row].decisions else "the second start"
            yield f"{traces.name}, episode {seed} {group[row].config}, {when}: {what}"


def _differences(
    traces: Traces, group: list[Episode], replayed: Replayed
) -> Iterator[tuple[int, int, str]]:
    """The row, the frame and the description of each episode's first difference."""
    longest = max(each.decisions for each in group)
    given = np.zeros((longest, len(group), *group[0].actions.shape[1:]), group[0].actions.dtype)
    for row, each in enumerate(group):
        given[: each.decisions, row] = each.actions
    frames = replayed.start(np.array([each.seed for each in group], dtype=np.uint64))
    running = dict(enumerate(group))
    for number in range(longest + 1):
        if number:
            frames = replayed.step(given[number - 1])
        for row, each in [*running.items()]:
            what = _difference(traces, each, number, frames[row], replayed.words()[row])
            for placed in each.placed if number == 0 else ():
                replayed.place(row, placed)
            if not what and number == each.decisions < len(each.hashes) - 1:
                frame = replayed.start_again(row)
                what = _difference(traces, each, number + 1, frame, replayed.words()[row])
                if what:
                    yield row, number + 1, what
            elif what:
                yield row, number, what
            if what or number == each.decisions:
                del running[row]


def _difference(
    traces: Traces, episode: Episode, number: int, frame: Numbers, words: NDArray[np.uint64]
) -> str:
    """The first difference between a frame and that of highway-env; empty if there is none."""
    for name, expected in zip(traces.quantities, episode.hashes[number], strict=True):
        numbers = frame[name]
        is_same = hash_of(numbers) == expected
        if is_same and not episode.values:
            continue
        if not episode.values:
            return f"{name}: {numbers.tolist()} (ours)"
        known = episode.values[name][number]
        found = np.full(known.shape, np.nan)
        found[: numbers.size] = numbers.ravel()[: found.size]
        apart = np.nonzero(~((found == known) | (np.isnan(found) & np.isnan(known))))[0]
        if apart.size:
            k, each = int(apart[0]), max(numbers.size // max(len(frame["x"]), 1), 1)
            where = f" of vehicle {k // each}" if name in OF_VEHICLES else f"[{k}]"
            return f"{name}{where}: {float(found[k])!r} (ours), {float(known[k])!r} (highway-env)"
        if not is_same:
            return f"{name}: {numbers.size} numbers (ours), {known.size} at most (highway-env)"
    if not np.array_equal(words, episode.words[number]):
        ours, theirs = words.tolist(), episode.words[number].tolist()
        return f"random generator: {ours} (ours), {theirs} (highway-env)"
    return ""
