"""What a Dask worker does with a shard: checks itself, simulates, sends the files as bytes.

Scheduler and workers import this module to read what they are sent. So it imports nothing heavy,
and what is sent is text, numbers and bytes.
"""

import os
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from hashlib import sha256
from os import PathLike
from pathlib import Path, PosixPath
from threading import Lock
from typing import TYPE_CHECKING, Any

from charms_bench.errors import ClusterError

if TYPE_CHECKING:
    from charms_bench.runs.suite import Suite

_one_at_a_time = Lock()
"""Agents are made once a process, and need not bear several threads."""


@dataclass(frozen=True, eq=False)
class Job:
    """What all shards of a run have in common."""

    suite: str
    """As JSON."""
    distributions: Sequence[str]
    """What must be of the same version everywhere."""
    software: Mapping[str, str | None]
    """What the client has; see `software`."""
    code_sha256: str
    """Of the client's charms_bench, whose version may stand for much where it is developed."""
    agents: Mapping[str, Any]
    """Who takes part; see `runner.plan`."""
    networks: Mapping[str, bytes]
    """The ONNX files of agents given by path, by that path."""


def run_shard(shard: tuple[int, int, int, str], job: Job) -> dict[str, bytes]:
    """The files of a shard, whose fields are those of `results.Shard`, by kind.

    Raises:
        ClusterError: This worker's software or agents are not the client's.
        CharmsBenchError: As at home.
    """
    from distributed import get_worker

    from charms_bench.runs.workers import THREADS

    with _one_at_a_time:
        os.environ |= dict.fromkeys(THREADS, "1")
        worker = get_worker()
        suite = _checked_suite(job, worker.address, Path(worker.local_directory))

        from charms_bench.runs import runner
        from charms_bench.runs.folder import Shard

        return dict(runner.run_shard(suite, "batched", Shard(*shard)))


def software(versions: Mapping[str, Any], distributions: Iterable[str]) -> dict[str, str | None]:
    """What decides a shard's bytes besides its agents, from what Dask says of a machine."""
    packages = versions["packages"]
    return {
        "processor": versions["host"]["machine"],
        "python": packages["python"],
        **{name: packages[name] for name in distributions},
    }


def differences(found: Mapping[str, Any], expected: Mapping[str, Any]) -> str:
    """In words, where what was found is not what was expected; empty where it is."""
    return "; ".join(
        f"{name} is {found.get(name) or 'missing'}, expected {wanted}"
        for name, wanted in expected.items()
        if found.get(name) != wanted
    )


@lru_cache(maxsize=1)
def _checked_suite(job: Job, address: str, folder: Path) -> "Suite":
    """The job's suite, with its networks below `folder`, once this worker is found to fit."""
    from distributed.versions import get_versions

    from charms_bench.runs.keys import harness_sha256
    from charms_bench.runs.runner import plan
    from charms_bench.runs.suite import Suite

    here = software(get_versions(job.distributions), job.distributions)
    found = differences(
        {**here, "code of charms-bench": harness_sha256()},
        {**job.software, "code of charms-bench": job.code_sha256},
    )
    suite = Suite.model_validate_json(job.suite)
    if not found:
        suite = suite.model_copy(update={"folder": _Networks.below(folder, job.networks)})
        _, agents = plan(suite, "batched")
        found = differences(_by_line(agents), _by_line(job.agents))
    if found:
        raise ClusterError(f"worker {address}: {found}; install the same there as here")
    return suite


def _by_line(agents: Mapping[str, Mapping[str, str]]) -> dict[str, str]:
    """What tells agents from others of their names, each by what it is."""
    return {
        f"{field} of {agent}": value
        for agent, identity in agents.items()
        for field, value in identity.items()
    }


class _Networks(PosixPath):
    """A folder that has a file under any path that a suite may give, `/home/me/it.onnx` too."""

    @classmethod
    def below(cls, folder: Path, networks: Mapping[str, bytes]) -> "_Networks":
        """The folder of these files, which another run's files of the same paths are not in."""
        from charms_bench.world.files import write_bytes

        contents = sha256(b"".join(sha256(networks[path]).digest() for path in sorted(networks)))
        made = cls(folder, "networks", contents.hexdigest())
        for path, content in networks.items():
            write_bytes(made / path, content)
        return made

    def __truediv__(self, path: str | PathLike[str]) -> Path:  # type: ignore[override]  # no Self
        return Path(self, sha256(str(path).encode()).hexdigest(), Path(path).name)
