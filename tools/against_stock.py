"""Compares the compiled engine with stock highway-env: `python tools/against_stock.py FOLDER`.

Stock highway-env has nothing replaced. The compiled engine, and stock highway-env as it computes on
other processors, are each held against it in the same episodes. FOLDER keeps the results in chunks
of 50 episodes, so the command continues where it was interrupted. `--chunks N` sets the number of
chunks of each profile, by default 20. `--only NAME ...` simulates only these contestants, and
`--table` only prints what FOLDER holds. An episode of highway-env takes one core about a second.

IDM+MOBIL drives the traffic. It also drives the ego in every second chunk; in the other chunks,
random meta-actions drive the ego, so that vehicles crash. An episode differs if in any simulation
step the lane or the target lane of a vehicle differs or only one of the two has crashed, or if the
endings of the episodes differ.
"""

import argparse
import os
import subprocess
import sys
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from charms_bench.engine import EngineName
from charms_bench.engine.simulation import Simulation
from charms_bench.foundation.threads import ONE_THREAD
from charms_bench.plugins.registry import make_agent
from charms_bench.plugins.traffic import OneAgent
from charms_bench.statistics.intervals import wilson
from charms_bench.statistics.paired import tango
from charms_bench.world.actions import ACTIONS
from charms_bench.world.profile import PROFILES
from charms_bench.world.scene import SceneSettings

DRIVER = "idm_mobil"
EPISODES = 50
"""The episodes of a chunk."""
DISABLED, CORE_TYPE = "NPY_DISABLE_CPU_FEATURES", "OPENBLAS_CORETYPE"
DISPATCHED = np.show_config(mode="dicts")["SIMD Extensions"].get("found", [])
"""The processor's features for which NumPy has functions of their own."""


class Contestant(NamedTuple):
    """An engine, and the variables in the environment of its processes."""

    title: str
    engine: EngineName
    variables: dict[str, str]


CONTESTANTS = {
    "stock": Contestant("stock highway-env", "highway-env", {}),
    "compiled": Contestant("compiled engine", "batched", {}),
    "dispatch": Contestant(
        "stock under another NumPy dispatch", "highway-env", {DISABLED: " ".join(DISPATCHED)}
    ),
    "openblas": Contestant(
        "stock under another core type of OpenBLAS", "highway-env", {CORE_TYPE: "Nehalem"}
    ),
}


class Chunk(NamedTuple):
    """Some episodes of a profile."""

    profile: str
    number: int

    @property
    def ego(self) -> str | None:
        """The ego's agent; None if random meta-actions drive the ego."""
        return None if self.number % 2 else DRIVER

    @property
    def seeds(self) -> NDArray[np.uint64]:
        first = self.number * EPISODES
        return np.arange(first, first + EPISODES, dtype=np.uint64)

    def path(self, folder: Path, contestant: str) -> Path:
        return folder / contestant / f"{self.profile}-{self.number}.npz"


def simulate(chunk: Chunk, engine: EngineName, path: Path) -> None:
    """Writes the events and positions of a chunk in every simulation step."""
    rates = {"ego_control_rate": "simulation", "sums_time": False}  # as stock; 60 decisions
    settings = SceneSettings.model_validate({"profile": {"name": chunk.profile, **rates}})
    agents = {DRIVER: make_agent(DRIVER, {})}
    simulation = Simulation(settings, EPISODES, chunk.ego, OneAgent(DRIVER), agents, engine)
    simulation.reset(chunk.seeds)
    generators = [np.random.default_rng([int(seed), 2]) for seed in chunk.seeds]
    events, x = [], []
    for _ in range(settings.decisions):
        actions = np.array([generator.integers(len(ACTIONS)) for generator in generators])
        for frame in range(settings.steps_per_decision):
            simulation.advance(actions if chunk.ego is None and frame == 0 else None)
            scene = simulation.scene
            events.append(np.stack([scene.lane, scene.target_lane, scene.crashed], axis=1))
            x.append(scene.x.copy())
        simulation.finish_step()
    path.parent.mkdir(parents=True, exist_ok=True)
    unfinished = path.with_suffix(".unfinished.npz")
    np.savez_compressed(
        unfinished,
        events=np.stack(events, axis=1).astype(np.int8),
        x=np.stack(x, axis=1),
        ending=simulation.ending,
        steps=simulation.steps,
    )
    unfinished.replace(path)


def simulate_in_process(chunk: Chunk, contestant: str, folder: Path) -> None:
    """Simulates a chunk in a process of its own; NumPy reads its variables when it is imported."""
    inherited = {k: v for k, v in os.environ.items() if k not in (DISABLED, CORE_TYPE)}
    subprocess.run(
        [sys.executable, __file__, str(folder), "--simulate", contestant, *map(str, chunk)],
        env={**inherited, **ONE_THREAD, **CONTESTANTS[contestant].variables},
        check=True,
    )


class Compared(NamedTuple):
    """A contestant's episodes (E,) beside those of stock highway-env."""

    differs: NDArray[np.bool_]
    step: NDArray[np.int64]
    """The first simulation step, from 1, in which an event differs; meaningless if none does."""
    distance_m: NDArray[np.float64]
    """The largest difference of any vehicle's position along the road."""


def compare(chunks: list[Chunk], contestant: str, folder: Path) -> Compared:
    parts = []
    for chunk in chunks:
        ours, stock = results(chunk, contestant, folder), results(chunk, "stock", folder)
        unlike = (ours["events"] != stock["events"]).any(axis=(2, 3))
        unlike[:, -1] |= (ours["ending"] != stock["ending"]) | (ours["steps"] != stock["steps"])
        distance_m = np.abs(ours["x"] - stock["x"]).max(axis=(1, 2))
        parts.append((unlike.any(axis=1), unlike.argmax(axis=1) + 1, distance_m))
    return Compared(*map(np.concatenate, zip(*parts, strict=True)))


def results(chunk: Chunk, contestant: str, folder: Path) -> dict[str, NDArray[Any]]:
    with np.load(chunk.path(folder, contestant)) as arrays:
        return dict(arrays)


def report(chunks: list[Chunk], other: str, folder: Path) -> None:
    """Prints how often the compiled engine and another contestant differ from stock highway-env."""
    ours, theirs = (compare(chunks, name, folder) for name in ("compiled", other))
    n = ours.differs.size
    events = np.concatenate([results(chunk, "stock", folder)["events"] for chunk in chunks])
    lane_changes = int((np.diff(events[:, :, 1], axis=1) != 0).sum())
    crashed = int(events[:, -1, 2].sum())
    only_ours = int((ours.differs & ~theirs.differs).sum())
    only_theirs = int((theirs.differs & ~ours.differs).sum())
    low, high = tango(only_ours, only_theirs, n)
    print(*dict.fromkeys(chunk.profile for chunk in chunks), sep=" and ", end=": ")
    print(f"{n} episodes with {lane_changes} lane changes and {crashed} crashed vehicles")
    print(f"  {CONTESTANTS['compiled'].title}: {summary(ours)}")
    print(f"  {CONTESTANTS[other].title}: {summary(theirs)}")
    print(f"  difference: {(only_ours - only_theirs) / n:+.2%} [{low:+.2%}, {high:+.2%}]", end="; ")
    print(f"{only_ours} episodes differ only in the former, {only_theirs} only in the latter")


def summary(found: Compared) -> str:
    count, n = int(found.differs.sum()), found.differs.size
    low, high = wilson(count, n)
    text = f"{count} of {n} episodes differ, {count / n:.2%} [{low:.2%}, {high:.2%}]"
    if count:
        steps = found.step[found.differs]
        text += f", first in steps {steps.min()} to {steps.max()}, median {np.median(steps):g}"
    if count < n:
        text += f"; else x differs by at most {found.distance_m[~found.differs].max():.1e} m"
    return text


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folder", type=Path)
    parser.add_argument("--chunks", type=int, default=20)
    parser.add_argument("--only", nargs="+", choices=CONTESTANTS, default=list(CONTESTANTS))
    parser.add_argument("--table", action="store_true")
    parser.add_argument("--simulate", nargs=3, help=argparse.SUPPRESS)
    given = parser.parse_args()
    folder = given.folder
    if given.simulate:
        name, profile, number = given.simulate
        chunk = Chunk(profile, int(number))
        simulate(chunk, CONTESTANTS[name].engine, chunk.path(folder, name))
        return
    chunks = [Chunk(profile, k) for k in range(given.chunks) for profile in PROFILES]
    for chunk in () if given.table else chunks:
        for name in given.only:
            if not chunk.path(folder, name).exists():
                simulate_in_process(chunk, name, folder)
    for other in ("dispatch", "openblas"):
        needed = ("stock", "compiled", other)
        held = [c for c in chunks if all(c.path(folder, name).exists() for name in needed)]
        groups = [[c for c in held if c.profile == profile] for profile in PROFILES]
        for group in filter(None, (*groups, held)):
            report(group, other, folder)


if __name__ == "__main__":
    main()
