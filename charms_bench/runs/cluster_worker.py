"""What a Dask worker runs: it checks its software, simulates a shard and returns the files.

Scheduler and workers import this module to read what they receive. So it imports nothing heavy,
and what is sent is text, numbers and bytes.
"""

import os
import pickle
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from threading import Lock
from typing import TYPE_CHECKING, Any

from charms_bench.errors import ClusterError
from charms_bench.runs.code_hashes import differences

if TYPE_CHECKING:
    from charms_bench.runs.shard import ShardFiles, ShardTask

_one_at_a_time = Lock()
"""A process has each agent once, and agents need not be safe to use from several threads."""


@dataclass(frozen=True, eq=False)
class Job:
    """What all shards of a run have in common."""

    platform: Mapping[str, str | None]
    """The client's software; see `describe_platform`."""
    environment: Mapping[str, str]
    networks: Mapping[str, bytes]
    """The ONNX files of networks given by path, by their SHA-256."""


def describe_platform(
    versions: Mapping[str, Any], distributions: Iterable[str]
) -> dict[str, str | None]:
    """Returns what has to be equal on all machines, from an entry of `Client.get_versions`."""
    packages = versions["packages"]
    return {
        "processor": versions["host"]["machine"],
        "python": packages["python"],
        **{name: packages[name] for name in distributions},
    }


def run_shard(pickled: bytes, job: Job) -> "ShardFiles":
    """Simulates a pickled `ShardTask`; raises a `ClusterError` if the software here differs."""
    from distributed import get_worker

    with _one_at_a_time:
        os.environ |= job.environment
        worker = get_worker()
        _check_platform(job, worker.address)

        from charms_bench.foundation.files import write_bytes
        from charms_bench.runs.shard import installed, simulate

        task: ShardTask = pickle.loads(pickled)
        networks = {}
        for name in task.networks:
            sha256 = task.software.agents[name]["weights_sha256"]
            networks[name] = Path(worker.local_directory, "networks", f"{sha256}.onnx")
            if not networks[name].exists():
                write_bytes(networks[name], job.networks[sha256])
        task = replace(task, networks=networks)
        found = installed(task.ego, task.traffic, task.networks, task.scene.network is not None)
        _reject(worker.address, found.differences(task.software))
        return simulate(task)


@lru_cache(maxsize=1)
def _check_platform(job: Job, address: str) -> None:
    from distributed.versions import get_versions

    names = [name for name in job.platform if name not in ("processor", "python")]
    here = describe_platform(get_versions(names), names)
    _reject(address, differences(here, job.platform))


def _reject(address: str, different: str) -> None:
    if different:
        raise ClusterError(f"worker {address}: {different}; install the same software there")
