"""Compares the compiled engine with stock highway-env: `python tools/against_stock.py FOLDER`.

Stock highway-env has nothing replaced. The compiled engine, and stock highway-env under another
NumPy dispatch, are each compared with it in the same episodes. FOLDER keeps the results in chunks
of 50 episodes, so the command continues where it was interrupted. `--chunks N` sets the number of
chunks of each profile, by default 20. An episode of highway-env takes one core about a second.

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

from charms_bench.engine import MakeEngine
from charms_bench.engine.batched import BatchedEngine
from charms_bench.engine.simulation import Simulation
from charms_bench.foundation.threads import ONE_THREAD
from charms_bench.plugins.registry import make_agent
from charms_bench.plugins.traffic import OneAgent
from charms_bench.statistics.intervals import wilson
from charms_bench.statistics.paired import tango
from charms_bench.testing.reference_engine import HighwayEnvEngine
from charms_bench.world.actions import ACTIONS
from charms_bench.world.profile import PROFILES
from charms_bench.world.scene import SceneSettings

DRIVER = "idm_mobil"
EPISODES = 50
"""The episodes of a chunk."""
DISPATCHED = np.show_config(mode="dicts")["SIMD Extensions"].get("found", [])
"""The processor's features for which NumPy has functions of their own."""
VARIABLES = {
    "stock": {},
    "dispatch": {"NPY_DISABLE_CPU_FEATURES": " ".join(DISPATCHED)},
    "ours": {},
}
"""The variables in the environment of each contestant's process."""
TITLES = {"ours": "compiled engine", "dispatch": "stock under another NumPy dispatch"}


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


def simulate(chunk: Chunk, engine: MakeEngine, path: Path) -> None:
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
    ends = {"ending": simulation.ending, "steps": simulation.steps}
    keep(path, events=np.stack(events, axis=1).astype(np.int8), x=np.stack(x, axis=1), **ends)


def keep(path: Path, **arrays: Any) -> None:
    """Writes arrays to a file, whole or not at all."""
    path.parent.mkdir(parents=True, exist_ok=True)
    unfinished = path.with_suffix(".unfinished.npz")
    np.savez_compressed(unfinished, **arrays)
    unfinished.replace(path)


def simulate_in_processes(script: str) -> None:
    """Runs a script once per contestant; NumPy reads its variables when it is imported."""
    for name, variables in VARIABLES.items():
        subprocess.run(
            [sys.executable, script, *sys.argv[1:], "--simulate", name],
            env={**os.environ, **ONE_THREAD, **variables},
            check=True,
        )


def asked(description: str, unit: str, count: int) -> argparse.ArgumentParser:
    """What both tools ask for."""
    parser = argparse.ArgumentParser(description=description.splitlines()[0])
    parser.add_argument("folder", type=Path)
    parser.add_argument(f"--{unit}", type=int, default=count)
    parser.add_argument("--simulate", choices=VARIABLES, help=argparse.SUPPRESS)
    return parser


def counted(differs: NDArray[np.bool_]) -> str:
    """How many episodes (E,) differ, with an interval."""
    count, n = int(differs.sum()), differs.size
    low, high = wilson(count, n)
    return f"{count} of {n} episodes differ, {count / n:.2%} [{low:.2%}, {high:.2%}]"


def print_difference(ours: NDArray[np.bool_], theirs: NDArray[np.bool_]) -> None:
    """Prints the difference between the proportions of episodes (E,) that differ."""
    only_ours, only_theirs = int((ours & ~theirs).sum()), int((theirs & ~ours).sum())
    low, high = tango(only_ours, only_theirs, ours.size)
    print(f"  difference: {(only_ours - only_theirs) / ours.size:+.2%} [{low:+.2%}, {high:+.2%}]")


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


def report(chunks: list[Chunk], folder: Path) -> None:
    """Prints how often the contestants differ from stock highway-env."""
    events = np.concatenate([results(chunk, "stock", folder)["events"] for chunk in chunks])
    lane_changes = int((np.diff(events[:, :, 1], axis=1) != 0).sum())
    print(*dict.fromkeys(chunk.profile for chunk in chunks), sep=" and ", end=": ")
    print(
        f"{len(events)} episodes with {lane_changes} lane changes and "
        f"{int(events[:, -1, 2].sum())} crashed vehicles"
    )
    found = {name: compare(chunks, name, folder) for name in TITLES}
    for name, each in found.items():
        text = counted(each.differs)
        if each.differs.any():
            steps = each.step[each.differs]
            text += f", first in steps {steps.min()} to {steps.max()}, median {np.median(steps):g}"
        if not each.differs.all():
            text += f"; else x differs by at most {each.distance_m[~each.differs].max():.1e} m"
        print(f"  {TITLES[name]}: {text}")
    print_difference(found["ours"].differs, found["dispatch"].differs)


def main() -> None:
    given = asked(__doc__, "chunks", 20).parse_args()
    chunks = [Chunk(profile, k) for k in range(given.chunks) for profile in PROFILES]
    if name := given.simulate:
        for chunk in chunks:
            if not chunk.path(given.folder, name).exists():
                engine = BatchedEngine if name == "ours" else HighwayEnvEngine
                simulate(chunk, engine, chunk.path(given.folder, name))
        return
    simulate_in_processes(__file__)
    groups = [[chunk for chunk in chunks if chunk.profile == profile] for profile in PROFILES]
    for group in (*groups, chunks):
        report(group, given.folder)


if __name__ == "__main__":
    main()
