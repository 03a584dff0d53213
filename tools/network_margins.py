"""Compares how close the networks' decisions are with how much kernels' values differ.

`python tools/network_margins.py [--episodes N] [--qemu PATH]` prints, for each network in the
package, the smallest margin between its two best actions. For each kernel, it prints the largest
difference of the values from those of onnxruntime on this processor, and the number of observations
in which the action differs. The observations are those of policies in two suites.

A kernel is a library's code for a generation of processors; kernels differ in whether they round
between multiplying and adding, and in the order of sums. OpenBLAS runs any of its kernels that the
processor supports. With `--qemu`, the path of `qemu-x86_64`, onnxruntime also runs on emulated
processors, on every 200th observation. Needs the extra `train`, and 300 MB of disk.

Each kernel calculates in a process of its own, `network_margins.py LIBRARY NETWORK OBSERVATIONS
OUTPUT`. Such a process imports little, because it may run on an emulated processor.
"""

import argparse
import os
import subprocess
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

ROOT = Path(__file__).parent.parent
SUITES = ("environment", "crossplay")
EMULATED_EVERY = 200
ROWS_AT_ONCE = 512
Values = NDArray[np.floating]


class Kernel(NamedTuple):
    """A library, and the processor for which it calculates; by default, this one."""

    library: str
    processor: str = ""
    qemu: str = ""

    def values(self, network: Path, folder: Path) -> Values:
        """The network's values (M, 5) for the observations in the folder."""
        observations = folder / f"every_{EMULATED_EVERY if self.qemu else 1}.npy"
        script = (sys.executable, __file__, self.library)
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


def by_onnxruntime(network: str) -> Callable[[Values], Values]:
    """The network as onnxruntime calculates it on one thread."""
    import onnxruntime

    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = options.inter_op_num_threads = 1
    session = onnxruntime.InferenceSession(network, options, providers=["CPUExecutionProvider"])
    return lambda rows: np.asarray(session.run(None, {"observations": rows})[0])


def by_numpy(network: str, dtype: str) -> Callable[[Values], Values]:
    """The network, linear layers with ReLU between them, as NumPy's BLAS calculates it."""
    import onnx

    tensors = onnx.load(network).graph.initializer
    arrays = [onnx.numpy_helper.to_array(tensor).astype(dtype) for tensor in tensors]
    layers = list(zip(arrays[::2], arrays[1::2], strict=True))

    def values(rows: Values) -> Values:
        rows = rows.reshape(len(rows), -1).astype(dtype)
        for weight, bias in layers[:-1]:
            rows = np.maximum(rows @ weight.T + bias, 0)
        return rows @ layers[-1][0].T + layers[-1][1]

    return values


def calculate(library: str, network: str, observations: str, output: str) -> None:
    """Writes the values (M, 5) of observations (M, rows, columns), both as `.npy` files.

    The library is `onnxruntime`, or the type in which NumPy calculates: `float32` or `float64`.
    """
    values = by_onnxruntime(network) if library == "onnxruntime" else by_numpy(network, library)
    rows = np.load(observations, mmap_mode="r")
    starts = range(0, len(rows), ROWS_AT_ONCE)
    np.save(output, np.concatenate([values(rows[k : k + ROWS_AT_ONCE]) for k in starts]))


def record(suite: str, episodes: int) -> list[Values]:
    """All observations of policies in the first episodes of each cell of a suite."""
    from charms_bench.engine.simulation import Simulation
    from charms_bench.plugins.agent import Policy
    from charms_bench.plugins.registry import make_agent
    from charms_bench.runs.suite import load_suite

    kept: list[Values] = []

    class Recorded(Policy):
        """A policy whose observations are kept."""

        def __init__(self, policy: Policy) -> None:
            self.observation, self.decision_hz = policy.observation, policy.decision_hz
            self._policy = policy

        def decide(self, observations: Any) -> Any:
            kept.append(observations)
            return self._policy.decide(observations)

    loaded = load_suite(ROOT / f"suites/{suite}.yaml")
    for cell in loaded.cells:
        traffic, ego = cell.traffic.traffic.make(), str(cell.ego.agent.name)
        agents = {name: make_agent(name) for name in {ego, *traffic.agents}}
        for name, agent in agents.items():
            agents[name] = Recorded(agent) if isinstance(agent, Policy) else agent
        simulation = Simulation(loaded.scene, episodes, ego, traffic, agents)
        simulation.reset(np.arange(episodes, dtype=np.uint64))
        while simulation.scene.active.any():
            simulation.step()
    return kept


def main(episodes: int, qemu: str, folder: Path) -> None:
    """Prints the table; values go through files in `folder`."""
    observations = np.concatenate([part for name in SUITES for part in record(name, episodes)])
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
    if len(sys.argv) == 5 and sys.argv[1] in ("onnxruntime", "float32", "float64"):
        sys.exit(calculate(*sys.argv[1:]))
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--episodes", type=int, default=30, help="of each cell")
    parser.add_argument("--qemu", default="", help="path of qemu-x86_64")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        main(options.episodes, options.qemu, Path(folder))
