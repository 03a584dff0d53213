"""Compares how close the networks' decisions are with how much kernels' values differ.

`python tools/network_margins.py [--episodes N] [--qemu PATH]` prints, for each network in the
package, the smallest margin between its two best actions. For each kernel, it prints the largest
difference of the values from those of onnxruntime on this processor, and the number of observations
in which the action differs. The observations are those of policies in two suites.

A kernel is a library's code for a generation of processors; kernels differ in whether they round
between multiplying and adding, and in the order of sums. OpenBLAS runs any of its kernels that the
processor supports. With `--qemu`, the path of `qemu-x86_64`, onnxruntime also runs on emulated
processors, on every 200th observation. Needs the extra `train`, and 300 MB of disk.
"""

import argparse
import os
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from charms_bench.engine.simulation import Simulation
from charms_bench.plugins.agent import Agent, Policy
from charms_bench.plugins.registry import make_agent
from charms_bench.runs.suite import Cell, load_suite
from charms_bench.world.actions import Actions
from charms_bench.world.scene import Observations, SceneSettings

ROOT = Path(__file__).parent.parent
SUITES = ("environment", "crossplay")
EMULATED_EVERY = 200


class Kernel(NamedTuple):
    """A library, and the processor for which it calculates; by default, this one."""

    library: str
    processor: str = ""
    qemu: str = ""

    def values(self, network: Path, folder: Path) -> NDArray[np.floating]:
        """The network's values (M, 5) for the observations in the folder."""
        observations = folder / f"every_{EMULATED_EVERY if self.qemu else 1}.npy"
        script = (sys.executable, ROOT / "tools" / "network_values.py", self.library)
        command = [str(part) for part in (*script, network, observations, folder / "out.npy")]
        environment = {**os.environ, "OPENBLAS_NUM_THREADS": "1"}
        if self.qemu:
            command = [self.qemu, "-cpu", self.processor, *command]
        elif self.processor:
            environment["OPENBLAS_CORETYPE"] = self.processor
        subprocess.run(command, env=environment, check=True)
        return np.asarray(np.load(folder / "out.npy"))


HERE = Kernel("onnxruntime")
KERNELS = {
    "float64": Kernel("float64"),
    "OpenBLAS Nehalem": Kernel("float32", "Nehalem"),
    "OpenBLAS Haswell": Kernel("float32", "Haswell"),
    "OpenBLAS SkylakeX": Kernel("float32", "SkylakeX"),
}
EMULATED = ("Nehalem", "Haswell")


class Recorded(Policy):
    """A policy whose observations are kept."""

    def __init__(self, policy: Policy, kept: list[Observations]) -> None:
        self.observation, self.decision_hz = policy.observation, policy.decision_hz
        self._policy, self._kept = policy, kept

    def decide(self, observations: Observations) -> Actions:
        self._kept.append(observations)
        return self._policy.decide(observations)


def record(settings: SceneSettings, cell: Cell, episodes: int) -> list[Observations]:
    """All observations of policies in the first episodes of a cell."""
    traffic, ego = cell.traffic.traffic.make(), str(cell.ego.agent.name)
    kept: list[Observations] = []
    agents: dict[str, Agent] = {name: make_agent(name) for name in {ego, *traffic.agents}}
    for name, agent in agents.items():
        agents[name] = Recorded(agent, kept) if isinstance(agent, Policy) else agent
    simulation = Simulation(settings, episodes, ego, traffic, agents)
    simulation.reset(np.arange(episodes, dtype=np.uint64))
    while simulation.scene.active.any():
        simulation.step()
    return kept


def main(episodes: int, qemu: str, folder: Path) -> None:
    """Prints the table; values go through files in `folder`."""
    suites = [load_suite(ROOT / f"suites/{name}.yaml") for name in SUITES]
    kept = [record(suite.scene, cell, episodes) for suite in suites for cell in suite.cells]
    observations = np.concatenate([part for parts in kept for part in parts])
    for every in (1, EMULATED_EVERY):
        np.save(folder / f"every_{every}.npy", observations[::every])
    emulated = {f"onnxruntime {cpu}": Kernel("onnxruntime", cpu, qemu) for cpu in EMULATED}
    kernels = KERNELS | (emulated if qemu else {})
    print(f"{len(observations):,} observations; by kernel: difference, other actions\n")
    print("| network | smallest margin |", " | ".join(kernels), "|")
    print("| --- |", "---: |" * (1 + len(kernels)))
    for network in sorted((ROOT / "agents/charms_agents/policies").glob("*.onnx")):
        here = HERE.values(network, folder)
        second, best = np.sort(here, axis=1)[:, -2:].T
        print(f"| {network.stem} | {(best - second).min():.1e} |", end="")
        for kernel in kernels.values():
            values = kernel.values(network, folder)
            expected = here[::EMULATED_EVERY] if kernel.qemu else here
            others = (values.argmax(axis=1) != expected.argmax(axis=1)).sum()
            print(f" {np.abs(values - expected).max():.1e}, {others} |", end="", flush=True)
        print()


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--episodes", type=int, default=30, help="of each cell")
    parser.add_argument("--qemu", default="", help="path of qemu-x86_64")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        main(options.episodes, options.qemu, Path(folder))
