"""Cells of handmade rows, and tables as lines of text."""

from collections.abc import Mapping, Sequence
from typing import Any

import polars as pl
from rich.console import Console, RenderableType

from charms_bench.recording.columns import EPISODE_SCHEMA, NO_DRIVERS, STEP_SCHEMA
from charms_bench.runs.cells import CellRows

Rows = Sequence[Mapping[str, Any]]


def cell_of(
    agent: str, episodes: Rows, steps: Rows, traffic: str = "idm", **fields: Any
) -> CellRows:
    """A cell of these rows in one part, by default without drivers."""
    parts = [
        (
            pl.DataFrame(episodes, schema=EPISODE_SCHEMA),
            pl.DataFrame(steps, schema=STEP_SCHEMA),
        )
    ]
    fields = {"drivers": [(NO_DRIVERS,)]} | fields
    return CellRows(agent=agent, traffic=traffic, size=len(episodes), parts=parts, **fields)


def lines(shown: RenderableType, width: int = 80) -> list[str]:
    """What a terminal of this width shows, without colours."""
    console = Console(width=width, color_system=None)
    with console.capture() as capture:
        console.print(shown)
    return [line.rstrip() for line in capture.get().splitlines()]
