"""Reads the rows of a shard and checks that they are of its episodes and can have been recorded.

A checksum shows that a file has not changed by accident. Whoever edits a file can also write its
checksum, and `audit` simulates only some shards again. These checks are quick, so every shard is
checked whenever it is read.
"""

from collections.abc import Mapping, Sequence
from io import BytesIO
from math import isfinite
from pathlib import Path
from typing import cast

import numpy as np
import polars as pl

from charms_bench.errors import RunFolderError
from charms_bench.foundation.words import counted
from charms_bench.recording.columns import (
    DRIVER_KEYS,
    EGO_INDEX,
    OPTIONAL,
    SCHEMAS,
    keys_of,
    with_ego_index,
)
from charms_bench.runs.shard_names import Shard
from charms_bench.world.following_bins import BINS, QUANTITIES
from charms_bench.world.scene import DECISIONS_LIMIT

ROWS_LIMIT = 150 * DECISIONS_LIMIT
"""Most rows of a shard; a Parquet file of a few bytes can repeat a row without end."""
ENDINGS = ("time", "rear_end", "side", "off_road", "goal")
_KEYS = {
    "steps": ("episode", "step"),
    "counts": ("episode", "quantity", "bin"),
    "drivers": DRIVER_KEYS,
    "episodes": ("episode",),
}
"""The columns that tell rows of a kind apart."""
_WITHOUT_NULL = {
    "steps": (
        *_KEYS["steps"], "x", "y", "heading", "speed", "acceleration", "steering",
        "length", "lane", "target_lane", "vehicles_near",
    ),
    "counts": (*_KEYS["counts"], "count"),
    "drivers": SCHEMAS["drivers"].names(),
    "episodes": ("episode", "ending", "steps", "duration_s", "distance_m"),
}  # fmt: skip
_PARTS = {
    "episodes": (("traffic_crashed", "traffic_vehicles"),),
    "drivers": (
        ("crashed", "vehicles"), ("pet_below_2s_by", "pet_by"), ("pet_below_2s_to", "pet_to"),
    ),
}  # fmt: skip
"""Columns that count some of what another column counts."""


def rows_in(data: bytes, kind: str, shard: Shard, path: Path) -> pl.DataFrame:
    """The rows of a kind of a shard in the Parquet file `path`; raises a `RunFolderError`.

    They are of its episodes, in order and complete. `check_values` looks at their values.
    """
    schema = SCHEMAS[kind]
    try:
        held = pl.read_parquet_schema(BytesIO(data))
        if EGO_INDEX in held:
            schema = with_ego_index(schema.to_frame(), 0).schema
        names = [name for name in schema if name in held or name not in OPTIONAL]
        wrong = [name for name in names if held.get(name) != schema[name]]
        if not wrong:
            rows = pl.read_parquet(BytesIO(data), columns=names, n_rows=ROWS_LIMIT + 1)
    except (pl.exceptions.PolarsError, OSError) as error:
        raise RunFolderError(f"{path}: is not a Parquet file; run the suite again") from error
    if wrong:
        problem = f"the columns {', '.join(wrong)} are missing or have other types"
    elif len(rows) > ROWS_LIMIT:
        problem = f"holds more than {ROWS_LIMIT:,} rows"
    else:
        rows = pl.concat([schema.to_frame(), rows], how="diagonal")
        problem = _problem_of_keys(kind, rows, shard)
    if problem:
        raise RunFolderError(f"{path}: {problem}; run the suite again")
    return rows


def check_seeds(data: bytes, shard: Shard, path: Path) -> None:
    """Raises a `RunFolderError` if rows that have just been made are not of a shard's episodes."""
    if problem := _problem_of_seeds(pl.read_parquet(BytesIO(data), columns=["episode"]), shard):
        raise RunFolderError(f"{path}: {problem}; run the suite again")


def _problem_of_seeds(rows: pl.DataFrame, shard: Shard) -> str:
    first, last = shard.seeds[0], shard.seeds[-1]
    is_known = rows["episode"].is_between(first, last).all()
    return "" if is_known else f"an episode is not one of {first} to {last}"


def _problem_of_keys(kind: str, rows: pl.DataFrame, shard: Shard) -> str:
    """What is wrong with the keys of the rows of one of `SCHEMAS`; empty if nothing is."""
    first, count = shard.first_seed, shard.episodes
    if problem := _problem_of_seeds(rows, shard):
        return problem
    if any(rows[name].null_count() for name in _WITHOUT_NULL[kind]):
        return "a value is missing"
    egos = rows[EGO_INDEX].n_unique() if EGO_INDEX in rows.columns else 1
    if kind == "episodes" and len(rows) != count * egos:
        episodes = f"{counted(count, 'episode')} {first} to {first + count - 1}"
        return f"it has {len(rows)} of the {episodes}"
    keys = dict.fromkeys((*keys_of(rows), *_KEYS[kind]))
    if not _is_in_order(rows, [*keys]):
        return f"its rows are not in order of {', '.join(keys)}, or two have the same"
    return ""


def check_values(kind: str, parts: Mapping[Path, pl.DataFrame]) -> pl.DataFrame:
    """The rows of some files in one frame; raises a `RunFolderError` where a value cannot be."""
    rows = pl.concat(parts.values())
    if _problem_of_values(kind, rows):  # looking at each file takes as many times as long
        for path, part in parts.items():
            if problem := _problem_of_values(kind, part):
                raise RunFolderError(f"{path}: {problem}; run the suite again")
    return rows


def _problem_of_values(kind: str, rows: pl.DataFrame) -> str:
    """Returns what is wrong with the values of the rows of one of `SCHEMAS`; empty if nothing."""
    for name, column in zip(rows.columns, rows, strict=True):
        # A sum is quicker than looking at every number, and finite only if all of these are.
        if column.dtype.is_float() and not isfinite(column.sum()):
            return f"{name}: a number is not finite"
        is_signed = column.dtype.is_signed_integer() or (kind == "drivers" and name.endswith("_s"))
        if is_signed and cast(float, column.min() or 0) < 0:
            return f"{name}: a number is negative"
    for part, whole in _PARTS.get(kind, ()):
        if (rows[part] > rows[whole]).any():
            return f"{part} is larger than {whole}"
    if kind == "episodes" and not rows["ending"].is_in(ENDINGS).all():
        return f"an ending is not one of {', '.join(ENDINGS)}"
    if kind == "drivers" and rows["agent"].str.contains(r"\p{Cc}").any():
        return "an agent has control characters"
    if kind == "counts" and not rows["quantity"].is_in(QUANTITIES).all():
        return f"a quantity is not one of {', '.join(QUANTITIES)}"
    if kind == "counts" and (rows["bin"] >= BINS).any():
        return f"a bin is not below {BINS}"
    return ""


def _is_in_order(rows: pl.DataFrame, keys: Sequence[str]) -> bool:
    """Whether every row comes after the one before it; keys further to the left decide first."""
    comes_after = np.zeros(max(0, len(rows) - 1), dtype=np.bool_)
    for key in reversed(keys):
        values = rows[key].to_numpy()
        before, after = values[:-1], values[1:]
        comes_after = (after > before) | ((after == before) & comes_after)
    return bool(comes_after.all())


def problem_of_egos(drivers: pl.DataFrame, ego: str | None) -> str:
    """What is wrong if driver rows are those of another ego; empty if nothing, or for None."""
    others = set(drivers.filter("is_ego")["agent"]) - {ego}
    return f"the ego is {min(others)}, expected {ego}" if ego is not None and others else ""


def problem_between(rows: Mapping[str, pl.DataFrame], ego: str | None = None) -> str:
    """Returns what is wrong between the kinds of rows of a shard; empty if nothing is.

    `rows_in` and `check_values` find nothing in the rows. `ego` is its agent in driver rows; None
    is any.
    """
    if what := problem_of_steps(rows["episodes"], rows["steps"]):
        return what
    egos = rows["drivers"].filter("is_ego")
    if not egos.select(keys_of(egos)).equals(rows["episodes"].select(keys_of(rows["episodes"]))):
        return "not every episode has one driver row of its ego"
    return problem_of_egos(rows["drivers"], ego)


def problem_of_steps(episodes: pl.DataFrame, steps: pl.DataFrame) -> str:
    """Returns where step rows, in order, are not those of their episode rows; empty if nowhere."""
    keys = keys_of(steps)
    if keys != keys_of(episodes):
        return "step rows and episode rows have other keys"
    found = steps.group_by(keys).agg(rows=pl.len(), last=pl.last("step"))
    both = episodes.select(*keys, "steps").join(found, on=keys, how="left", maintain_order="left")
    is_same = pl.all_horizontal(pl.col("rows", "last").eq_missing(pl.col("steps")))
    for row in both.filter(~is_same).head(1).iter_rows(named=True):
        return (
            f"episode {row['episode']} has {row['steps']} steps, but there are {row['rows'] or 0} "
            "step rows"
        )
    return ""
