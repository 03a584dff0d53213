"""Results as notebooks and terminals show them."""

from pathlib import Path
from typing import TypeVar

from charms_bench.episodes.replay import Replay
from charms_bench.episodes.what_if import WhatIf

T = TypeVar("T")


class Lines(list[T]):
    """A list that is printed with one item per line."""

    def __repr__(self) -> str:
        shown = [repr(each) for each in self[:LINES]]
        more = [f"{len(self) - LINES} more"][: len(self) > LINES]
        return "\n".join([*shown, *more]) or "[]"


LINES = 20


class ShownReplay(Replay):
    """A replay with its views; a notebook shows it with the player of the report."""

    def animate(self, path: str | Path, caption: str | None = None) -> None:
        """Writes the episode as an animated GIF that plays in real time.

        There is one picture per simulation step. A vehicle's colour is that of its agent; the ego
        has its own colour. The number on a vehicle is its index in the order of spawning. Red
        lights mean braking, amber lights a lane change, and a cross a vehicle that has crashed.

        Args:
            path: The file; its name ends in `.gif`.
            caption: One line of text below the road, by default what happened.

        Raises:
            InputError: The file's name does not end in `.gif`, or the file cannot be written.
        """
        from charms_bench.episodes.animation import animate

        animate(self, Path(path), self.what_happened() if caption is None else caption)

    def what_happened(self) -> str:
        """Returns one sentence about the most critical event of the episode."""
        from charms_bench.episodes.what_happened import what_happened

        return what_happened(self)

    def write_commonroad(self, path: str | Path) -> None:
        """Writes the episode as a CommonRoad scenario with one time step per simulation step.

        Vehicle k, the ego included, is the dynamic obstacle 1001 + k, and lane k is the lanelet
        k + 1. The planning problem has the ego's initial state and the duration of the episode. On
        one of highway-env's roads, the lanelets are its lanes with their bends and successors, and
        obstacles are static.

        Args:
            path: The file; its name ends in `.xml`.

        Raises:
            InputError: The file's name does not end in `.xml`, or the file cannot be written.
        """
        from charms_bench.episodes.commonroad import write_commonroad

        write_commonroad(self, Path(path))

    def _repr_html_(self) -> str:
        from charms_bench.report.html.single import replay_in_frame

        return replay_in_frame(self)


class ShownWhatIf(WhatIf):
    """Two futures of an episode that a notebook shows with the player of the report."""

    def _repr_html_(self) -> str:
        from charms_bench.report.html.single import replay_in_frame

        return replay_in_frame(self.recorded, self.other, self.step)
