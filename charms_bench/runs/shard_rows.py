"""Reads the rows of a shard and checks that they are of its episodes and can have been recorded.

A checksum shows that a file has not changed by accident. Whoever edits a file can also write its
checksum, and `audit` simulates only some shards again. These checks are quick, so every shard is
checked whenever it is read.
"""

from collections.abc import Mapping
from io import BytesIO
from pathlib import Path

import numpy as np
import polars as pl
import polars.selectors as cs

from charms_bench.engine.columns import DRIVER_KEYS, SCHEMAS
from charms_bench.errors import RunFolderError
from charms_bench.runs.shards import Shard
from charms_bench.world.following import BINS, QUANTITIES
from charms_bench.world.scene import DECISIONS_LIMIT

ROWS_LIMIT = 150 * DECISIONS_LIMIT
"""Most rows of a shard; a Parquet file of a few bytes can repeat a row without end."""
ENDINGS = ("time", "rear_end", "side", "off_road")
_KEYS = {
    "steps": ("episode", "step"),
    "counts": ("episode", "quantity", "bin"),
    "drivers": DRIVER_KEYS,
    "episodes": ("episode",),
}
"""The columns that tell rows of a kind apart."""
_WITHOUT_NULL = {
    "steps": (
        *_KEYS["steps"], "x", "y", "heading", "speed", "acceleration", "steering", "lane",
        "target_lane", "vehicles_near",
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
    """Returns the rows of one kind of a shard, read from the content of the Parquet file `path`.

    Raises:
        RunFolderError: It is not such a file, or has other rows.
    """
    schema = SCHEMAS[kind]
    try:
        rows = pl.scan_parquet(BytesIO(data))
        found = rows.collect_schema()
        wrong = [name for name in schema if found.get(name) != schema[name]]
        if not wrong:
            # Later versions may add columns.
            read = rows.select(schema.names()).head(ROWS_LIMIT + 1).collect()
            problem = (
                problem_of(kind, read, shard.first_seed, shard.episodes)
                if len(read) <= ROWS_LIMIT
                else f"holds more than {ROWS_LIMIT:,} rows"
            )
            if not problem:
                return read
        else:
            problem = f"the columns {', '.join(wrong)} are missing or have other types"
    except pl.exceptions.PolarsError as error:
        raise RunFolderError(f"{path}: is not a Parquet file; run the suite again") from error
    raise RunFolderError(f"{path}: {problem}; run the suite again")


def check_seeds(data: bytes, shard: Shard, path: Path) -> None:
    """Checks that rows which have just been made are of a shard's episodes; see also `rows_in`.

    Raises:
        RunFolderError: They are of other episodes.
    """
    last = shard.first_seed + shard.episodes - 1
    seeds = pl.read_parquet(BytesIO(data), columns=["episode"])["episode"]
    if not seeds.is_between(shard.first_seed, last).all():
        raise RunFolderError(
            f"{path}: an episode is not one of {shard.first_seed} to {last}; run the suite again"
        )


def problem_of(kind: str, rows: pl.DataFrame, first_seed: int, episodes: int) -> str:
    """Returns what is wrong with the rows of one kind; empty if nothing is.

    Args:
        kind: One of `engine.columns.SCHEMAS`.
        rows: The rows, with the columns of that schema.
        first_seed: The seed of the shard's first episode.
        episodes: The number of its episodes; the next episodes have the next seeds.
    """
    last = first_seed + episodes - 1
    keys = rows.select(_KEYS[kind])
    wrong = {
        f"an episode is not one of {first_seed} to {last}": ~pl.col("episode").is_between(
            first_seed, last
        ),
        "a value is missing": pl.any_horizontal(pl.col(_WITHOUT_NULL[kind]).is_null()),
        "a number is not finite": ~pl.all_horizontal(cs.float().is_finite()),
        "a number is negative": pl.any_horizontal(cs.signed_integer() < 0),
    }
    for part, whole in _PARTS.get(kind, ()):
        wrong[f"{part} is larger than {whole}"] = pl.col(part) > pl.col(whole)
    if kind == "episodes":
        wrong[f"an ending is not one of {', '.join(ENDINGS)}"] = ~pl.col("ending").is_in(ENDINGS)
    if kind == "drivers":
        wrong["a time is negative"] = pl.any_horizontal(cs.ends_with("_s") & cs.float() < 0)
        wrong["an agent has control characters"] = pl.col("agent").str.contains(r"\p{Cc}")
    if kind == "counts":
        wrong[f"a quantity is not one of {', '.join(QUANTITIES)}"] = ~pl.col("quantity").is_in(
            QUANTITIES
        )
        wrong[f"a bin is not below {BINS}"] = pl.col("bin") >= BINS
    found = rows.select(each.any().alias(what) for what, each in wrong.items()).row(0, named=True)
    if what := next((what for what, is_wrong in found.items() if is_wrong), ""):
        return what
    if kind == "episodes" and len(rows) != episodes:
        return f"it has {len(rows)} of the {episodes} episodes {first_seed} to {last}"
    if not keys.equals(keys.unique().sort(keys.columns)):
        return f"its rows are not in order of {', '.join(keys.columns)}, or two have the same"
    return ""


def problem_between(rows: Mapping[str, pl.DataFrame], ego: str | None = None) -> str:
    """Returns what is wrong between the kinds of rows of a shard; empty if nothing is.

    Args:
        rows: The rows of every kind, in which `problem_of` finds nothing.
        ego: The agent of the ego, as driver rows name it; None for any.
    """
    if what := problem_of_steps(rows["episodes"], rows["steps"]):
        return what
    egos = rows["drivers"].filter("is_ego")
    if not np.array_equal(egos["episode"], rows["episodes"]["episode"]):
        return "not every episode has one driver row of its ego"
    others = set(egos["agent"]) - {ego}
    if ego is not None and others:
        return f"the ego is {min(others)}, expected {ego}"
    return ""


def problem_of_steps(episodes: pl.DataFrame, steps: pl.DataFrame) -> str:
    """Returns where step rows are not those of their episode rows; empty if nowhere."""
    counted = steps.group_by("episode").agg(found=pl.len(), last=pl.col("step").max())
    both = episodes.select("episode", "steps").join(counted, on="episode", how="left")
    is_same = (pl.col("steps") == pl.col("found")) & (pl.col("steps") == pl.col("last"))
    for episode, said, found, _ in both.filter(~is_same.fill_null(False)).iter_rows():
        return f"episode {episode} has {said} steps, but there are {found or 0} step rows"
    return ""
