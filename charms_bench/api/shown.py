"""Results as notebooks and terminals show them."""

from dataclasses import fields
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
    """A replay that a notebook shows with the player of the report."""

    @classmethod
    def of(cls, replay: Replay) -> "ShownReplay":
        """The same replay."""
        return cls(**{each.name: getattr(replay, each.name) for each in fields(replay)})

    def _repr_html_(self) -> str:
        from charms_bench.report.html.notebook import replay_in_frame

        return replay_in_frame(self)


class ShownWhatIf(WhatIf):
    """Two futures of an episode that a notebook shows with the player of the report."""

    @classmethod
    def of(cls, found: WhatIf) -> "ShownWhatIf":
        """The same futures."""
        return cls(**{each.name: getattr(found, each.name) for each in fields(found)})

    def _repr_html_(self) -> str:
        from charms_bench.report.html.notebook import replay_in_frame

        return replay_in_frame(self.recorded, self.other, self.step)
