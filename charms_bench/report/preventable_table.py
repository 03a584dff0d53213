"""The table of preventable collisions: those in episodes in which a reference driver has none.

All egos of a suite drive the same episodes, so in a suite of scenarios the reference driver meets
the same concrete scenario. If a suite has two reference drivers, the collisions that only one of
them avoids have their own columns.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import polars as pl
from numpy.typing import NDArray

from charms_bench.metrics.collisions import ENDED_BADLY
from charms_bench.metrics.rows import join_rows
from charms_bench.report.definitions import INTERVALS, LEFT_OUT, said_of_left_out
from charms_bench.report.table import ESTIMATE, Column, Table, long_schema
from charms_bench.runs.cells import CellRows
from charms_bench.runs.suite import Suite
from charms_bench.statistics.intervals import wilson

KEYS = ("agent", "traffic")
LONG = {"share": "name", **ESTIMATE}
BRAKING = "strongest_braking"
ONLY = "preventable only by "
"""Begins the name of a kind of collisions, which ends with a reference driver's."""


def crashed(cell: CellRows) -> NDArray[np.bool_]:
    """Returns whether the ego crashed, in each episode of a cell, by seed."""
    rows = cell.episodes.sort("episode").group_by("episode", maintain_order=True).agg(ENDED_BADLY)
    return rows["ending"].to_numpy().astype(np.bool_)


def strongest_braking(suite: Suite, cell: CellRows) -> float:
    """The largest mean deceleration of the ego between two decisions of a cell, m/s²."""
    acceleration = (
        join_rows(episodes, steps, suite.scene)["mean_acceleration_mps2"].min()
        for episodes, steps in cell.parts
    )
    return max([0.0, *(-each for each in acceleration if isinstance(each, float))])


Kinds = dict[str, NDArray[np.bool_]]
"""The episodes (E,) with each kind of collision, by the kind's name."""


def kinds_of(suite: Suite, cells: Sequence[CellRows]) -> dict[tuple[str, ...], Kinds]:
    """Returns the episodes with each kind of collision, by the labels of the cell.

    Cells whose reference drivers are not among the cells are left out. Every collision is of one
    kind: `preventable` if all reference drivers avoid it, `not_preventable` if none does, and
    otherwise `ONLY` and the name of the one that does.
    """
    has_crashed = {cell.labels: crashed(cell) for cell in cells}
    found = {}
    for labels, mine in has_crashed.items():
        references = [(name, *labels[1:]) for name in suite.preventable_by]
        if not has_crashed.keys() >= {*references}:
            continue
        avoided = ~np.array([has_crashed[reference] for reference in references])
        kinds = {"preventable": mine & avoided.all(axis=0)}
        if len(avoided) > 1:
            for name, each in zip(suite.preventable_by, avoided, strict=True):
                kinds[ONLY + name] = mine & each & (avoided.sum(axis=0) == 1)
        found[labels] = {**kinds, "not_preventable": mine & ~avoided.any(axis=0)}
    return found


def verdicts(suite: Suite, cells: Sequence[CellRows]) -> dict[tuple[str | int, ...], str]:
    """Whether each collision is preventable, by the labels of its cell and its episode.

    It is `yes`, `no` or by whom. The cells are as in `kinds_of`.
    """
    seeds = {each.labels: each.episodes["episode"].sort() for each in cells}
    words = {"preventable": "yes", "not_preventable": "no"}
    return {
        (*cell, seed): words.get(name, name.removeprefix("preventable "))
        for cell, kinds in kinds_of(suite, cells).items()
        for name, has_it in kinds.items()
        for seed in seeds[cell].filter(pl.Series(has_it))
    }


def preventable_table(suite: Suite, cells: Sequence[CellRows]) -> Table:
    """The proportions of preventable and other collisions of every cell, with 95 % intervals."""
    records: list[tuple[object, ...]] = []
    by_cell = {cell.labels: cell for cell in cells}
    for labels, kinds in kinds_of(suite, cells).items():
        cell = by_cell[labels]
        proportions: list[tuple[object, ...]] = []
        for name, each in {"crashed": crashed(cell), **kinds}.items():
            count = int(each.sum())
            bounds = wilson(count, each.size)
            proportions.append((name, count / each.size, *bounds, each.size))
        braking = (BRAKING, strongest_braking(suite, cell), None, None, cell.size)
        every = cell.size + cell.left_out
        left = (LEFT_OUT, cell.left_out / every, None, None, every)
        numbers = (*proportions[:2], braking, *proportions[2:], left)
        records += [(*labels, *each) for each in numbers]
    schema = long_schema(suite.with_road(KEYS), LONG)
    return from_frame(pl.DataFrame(records, schema=schema, orient="row"), suite)


def from_frame(frame: pl.DataFrame, suite: Suite) -> Table:
    """The table of preventable collisions from its long frame."""
    references, several = " and ".join(suite.preventable_by), len(suite.preventable_by) > 1
    definitions = {
        "crashed": "proportion of episodes in which the ego collides or leaves the road",
        "preventable": f"proportion of episodes in which it does so and {references} "
        f"{'do' if several else 'does'} not",
        "not_preventable": f"proportion of episodes in which it and {references} do so",
        BRAKING: "largest deceleration of the ego in any episode: change of speed between two "
        "decisions, divided by their interval",
        LEFT_OUT: "proportion of concrete scenarios that nothing else counts, because "
        "prescribed vehicles collide with one another in them",
    }
    for name in suite.preventable_by:
        definitions[ONLY + name] = (
            f"proportion of episodes in which it does so and, of {references}, only {name} does not"
        )

    def column(_: str, name: str) -> Column:
        label = f"{name[0].upper()}{name[1:]}".replace("_", " ")
        known = Column(name, "", definitions.get(name, ""), "episodes", form=".1%", label=label)
        if name == BRAKING:
            return replace(known, unit="m/s²", form=".1f")
        if name == LEFT_OUT:
            return replace(known, counted="concrete scenarios")
        return replace(known, interval=INTERVALS["wilson"])

    return Table.from_frame(
        frame,
        f"{suite.suite}-preventable",
        "Preventable collisions",
        suite.with_road(KEYS),
        LONG,
        column,
        note=f"A collision is preventable if {references} {'avoid' if several else 'avoids'} it in "
        f"the same episode. {said_of_left_out(frame, 'share')}".rstrip(),
    )
