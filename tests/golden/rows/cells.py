"""What 20 episodes of each cell of the suites record: a hash of each column, and a few words."""

import re
from collections.abc import Collection, Iterator
from io import BytesIO
from pathlib import Path

import polars as pl
from rows.hashing import hash_of
from rows.history import earlier_networks
from rows.recording import write_recording

from charms_bench.runs.runner import plan_cell
from charms_bench.runs.shard import simulate
from charms_bench.runs.suite import Suite, load_suite

PROJECT = Path(__file__).parents[3]
SUITES = {
    path.relative_to(PROJECT / "suites").with_suffix("").as_posix(): path
    for path in sorted((PROJECT / "suites").rglob("*.yaml"))
    if not path.name.startswith("train")
}
"""The suites by their path in the folder `suites`, and those of this folder."""
SUITES |= {path.stem: path for path in sorted(Path(__file__).parent.glob("*.yaml"))}
PARTS = {"roads": ("roads", "roads-traffic")}
"""The suites that have the cells recorded as those of one."""
EPISODES = 20
SHOWN = 2
"""Episodes that `shown` describes."""
EARLIER = ("memory", "released/environment")
"""The suites whose rows were recorded with networks that the checkout lacks."""
Row = dict[str, str]
"""Text by name: the ego of a cell, its road and traffic model, what is shown of it, and hashes."""


def rows_of(
    name: str, folder: Path, cells: Collection[tuple[str, str]] | None = None
) -> Iterator[Row]:
    """Yields the row of each cell of a suite, or of those of some egos in some traffic models.

    `folder` is empty and for files that the checkout lacks.
    """
    for part in PARTS.get(name, (name,)):
        suite = with_stand_ins(part, folder).model_copy(update={"episodes": EPISODES})
        for index, cell in enumerate(suite.cells):
            ego, traffic = cell.ego.title, cell.surroundings.title
            if cells is None or (ego, traffic) in cells:
                yield {"ego": ego, "traffic": traffic} | simulated(suite, index)


def simulated(suite: Suite, index: int) -> Row:
    """Simulates a cell; returns what is shown of it, and the hash of each column."""
    (task,) = plan_cell(suite, index).values()
    tables = {kind: pl.read_parquet(BytesIO(data)) for kind, data in simulate(task).items()}
    if suite.roads:  # where the traffic was not yet counted when rows were recorded
        tables["drivers"] = tables["drivers"].filter("is_ego")
        nothing = pl.col("^traffic_(vehicles|crashed|distance_m|time_s)$")
        tables["episodes"] = tables["episodes"].with_columns(pl.when(False).then(nothing))
    hashes = {
        f"{kind}.{column.name}": hash_of(column)
        for kind, table in sorted(tables.items())
        for column in table
    }
    return {"shown": shown(tables["episodes"]), **hashes}


def shown(episodes: pl.DataFrame) -> str:
    """Describes the first episodes."""
    said = []
    for row in episodes.head(SHOWN).iter_rows(named=True):
        ending = row["ending"] + (" (struck)" if row["struck"] else "")
        said.append(f"{ending} {row['duration_s']:.2f} s {row['distance_m']:.3f} m")
    crashed = (~episodes["ending"].is_in(["time", "goal"])).sum()
    others = episodes["traffic_crashed"].sum()
    return f"{'; '.join(said)}; crashed {crashed} of {len(episodes)}, others {others}"


def with_stand_ins(name: str, folder: Path) -> Suite:
    """Returns a suite; what the checkout lacks is replaced.

    A recording by hand replaces recorded drivers, and networks of this project replace those of
    the paper's authors.
    """
    path = SUITES[name]
    text = path.read_text()
    if "recording:" in text:
        write_recording(folder)
        text = re.sub(r"recording: .*", f"recording: {{folder: {folder}, main_lanes: 2}}", text)
        text = re.sub("episodes: .*", f"episodes: {EPISODES}", text)
    elif name.startswith("released/"):
        lacking = sorted(set(re.findall(r"networks/[\w/]+\.onnx", text)))
        for theirs, instead in reversed([*zip(lacking, networks(name, folder), strict=False)]):
            text = text.replace(theirs, str(instead))
    elif name == "memory":
        text = text.replace("../networks", str(earlier_networks(folder)))
    else:
        return load_suite(path)
    edited = folder / path.name
    edited.write_text(text)
    return load_suite(edited)


def networks(name: str, folder: Path) -> list[Path]:
    """Returns those of the straight road; they stand in for those of the paper's authors."""
    beside = earlier_networks(folder) if name in EARLIER else PROJECT / "networks"
    packaged = (PROJECT / "agents" / "charms_agents" / "policies").glob("charms_[eps]*.onnx")
    return [*sorted(packaged), *sorted(beside.glob("seed-*/*.onnx"))]
