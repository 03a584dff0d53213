"""Checks that restored scenes continue as if never interrupted: `python tools/check_states.py`.

Episodes are simulated, and their states are kept after every simulation step and every decision.
Then scenes are restored from randomly chosen states and simulated to the end of their episodes, or
for `--steps` simulation steps. At each step, their state must be the one that was kept, to the last
bit. `--batched`, `--reference` and `--across` set how many states are restored in the compiled
engine, in highway-env, and in the engine that did not save them. All traffic models get equally
many.
"""

import argparse
import os
import subprocess
import sys
from pathlib import Path
from typing import NamedTuple

import numpy as np

sys.path.append(str(Path(__file__).parents[1] / "tests" / "engine"))

from interrupted import Whims, moments

from charms_bench.engine import MakeEngine
from charms_bench.engine.simulation import Simulation
from charms_bench.plugins.registry import make_agent
from charms_bench.plugins.traffic import Mixture
from charms_bench.testing.exact_maths import use_exact_maths, worker_environment
from charms_bench.testing.reference_engine import ENGINES
from charms_bench.world.scene import Ints, SceneSettings

FIRST_SEED = 900_000_000


class Case(NamedTuple):
    """An ego in a traffic model in a kind of scene."""

    ego: str
    traffic: dict[str, float]
    settings: SceneSettings


CASES = {
    "rule-based": Case(
        "stackelberg", {"idm_mobil": 0.5, "stackelberg": 0.5}, SceneSettings(density=1.5)
    ),
    "learned": Case(
        "charms",
        {"charms": 0.3, "charms-safe-egoistic": 0.3, "imitation": 0.4},
        SceneSettings(density=1.5),
    ),
    "mixed, control in every step": Case(
        "idm_mobil",
        {"idm_mobil": 0.4, "charms": 0.3, "whims": 0.3},
        SceneSettings.model_validate({"profile": "highway-env", "lanes": 4, "decision_hz": 5}),
    ),
    "wrecks": Case(
        "level_0", {"whims": 0.3, "quick whims": 0.2, "idm_mobil": 0.5}, SceneSettings(density=2.0)
    ),
}


def simulation(case: Case, scenes: int, engine: MakeEngine) -> Simulation:
    """Scenes of a case that have not started."""
    traffic = Mixture(case.traffic)
    own = {"whims": Whims(case.settings.decision_hz), "quick whims": Whims(15.0)}
    agents = {name: own.get(name) or make_agent(name) for name in (case.ego, *traffic.agents)}
    return Simulation(case.settings, scenes, case.ego, traffic, agents, engine)


def check(
    case: Case, engines: tuple[MakeEngine, MakeEngine], states: int, limit: int | None, first: int
) -> str:
    """Saves in one engine and continues in the other; says how many states and steps were compared.

    An `AssertionError` if a continued scene differs from the one that was not interrupted.
    """
    scenes = max(2, min(100, states // 20))
    original = simulation(case, scenes, engines[0])
    original.reset(np.arange(first, first + scenes, dtype=np.uint64))
    kept = [original.state(), *moments(original)]
    running = np.argwhere([state.active for state in kept])
    chosen = np.random.default_rng(first).choice(running, states, replace=False)
    wrecks = steps = 0
    for moment in np.unique(chosen[:, 0]):
        rows: Ints = chosen[chosen[:, 0] == moment, 1]
        start = kept[moment].take(rows)
        wrecks += int(start.crashed.any(axis=1).sum())
        later = simulation(case, rows.size, engines[1])
        later.restore(start)
        following = kept[moment + 1 :][:limit]
        for expected, found in zip(following, moments(later), strict=False):
            steps += rows.size
            assert found == expected.take(rows), (case, engines, first, moment)
        assert limit or not later.scene.active.any()
    return f"{states:,} states, {wrecks:,} with wrecks, {steps:,} simulation steps, all identical"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition(":")[0])
    for name, number in (("batched", 10_000), ("reference", 500), ("across", 200)):
        parser.add_argument(f"--{name}", type=int, default=number)
    parser.add_argument("--steps", type=int, help="by default, to the end of each episode")
    asked = parser.parse_args()
    environment = worker_environment()
    if any(os.environ.get(name) != value for name, value in environment.items()):
        again = [sys.executable, *sys.argv]
        sys.exit(subprocess.run(again, env=os.environ | environment).returncode)
    use_exact_maths()
    ours, reference = ENGINES
    pairs: list[tuple[str, tuple[MakeEngine, MakeEngine], int]] = [
        ("batched", (ours, ours), asked.batched),
        ("highway-env", (reference, reference), asked.reference),
        ("batched, then highway-env", (ours, reference), asked.across // 2),
        ("highway-env, then batched", (reference, ours), asked.across // 2),
    ]
    for what, engines, states in pairs:
        for name, case in CASES.items() if states else ():
            found = check(case, engines, states // len(CASES), asked.steps, FIRST_SEED)
            print(f"{what}; {name}: {found}", flush=True)


if __name__ == "__main__":
    main()
