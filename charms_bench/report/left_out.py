"""Says how many concrete scenarios the numbers of a table leave out; see `engine.pile_ups`."""

import polars as pl

NAME = "scenarios_left_out"
"""What the long frame of a table calls their proportion."""


def said_of(frame: pl.DataFrame, column: str) -> str:
    """The sentence for a long frame, whose `column` has the names; empty if nothing is left out."""
    rows = frame.filter(pl.col(column) == NAME, pl.col("value") > 0)
    found = dict.fromkeys(rows.select("traffic", "value", "n").iter_rows())
    counts = ", ".join(f"{round(value * n):,} of {n:,} of {traffic}" for traffic, value, n in found)
    return counts and (
        f"Left out are the concrete scenarios in which prescribed vehicles collide with one "
        f"another: {counts}."
    )
