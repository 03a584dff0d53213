"""Shards on a Dask cluster, whose workers share no files with us: a shard's files come as bytes."""

import logging
import time
import warnings
from collections.abc import Callable, Generator, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import astuple
from functools import partial
from os import getpid
from queue import Empty, SimpleQueue
from typing import TYPE_CHECKING, Any, TypeVar
from urllib.parse import urlsplit

from charms_bench.errors import ClusterError, InputError
from charms_bench.runs.cluster_worker import Job, differences, run_shard, software
from charms_bench.runs.folder import Shard, ShardFiles, recorded_versions
from charms_bench.runs.keys import harness_sha256
from charms_bench.runs.runner import Elsewhere
from charms_bench.runs.suite import Suite

if TYPE_CHECKING:
    from distributed import Client, Future

T = TypeVar("T")
WORKERLESS_S = 60.0
"""How long a cluster may have no workers: they may be starting, or being replaced."""
_FETCH_S = 60.0
_POLL_S = 1.0


def on_cluster(address: str) -> Elsewhere:
    """What runs shards on the Dask cluster whose scheduler is at `address`.

    Raises:
        InputError: It is no such address, or Dask is not installed.
    """
    _check_address(address)
    try:
        import distributed  # noqa: F401  # only whether it is there
    except ImportError as error:
        raise InputError(
            f"--cluster needs Dask ({error}); pip install 'charms-bench[cluster]'"
        ) from error
    return partial(_run_shards, address)


def _check_address(address: str) -> None:
    try:
        url = urlsplit(address)
        rest = url.path or url.query or url.fragment or url.username
        valid = url.scheme in ("tcp", "tls") and url.hostname and url.port and not rest
    except ValueError:  # of a port that is none
        valid = False
    if not valid:
        raise InputError(
            f"--cluster {address}: expected tcp://HOST:PORT or tls://HOST:PORT, as the scheduler "
            "says when it starts"
        )


def _run_shards(
    address: str,
    suite: Suite,
    agents: Mapping[str, Any],
    shards: Sequence[Shard],
    title: Callable[[Shard], str],
    limit_s: float,
) -> Generator[tuple[Shard, ShardFiles], None, None]:
    """See `Elsewhere`; without its client, a scheduler forgets the shards that are left.

    Raises:
        ClusterError: The cluster cannot be reached or used, or is gone.
        CharmsBenchError: A worker raised it.
    """
    if not shards:
        return
    plugins = {agent["distribution"] for agent in agents.values() if "distribution" in agent}
    distributions = sorted({"charms-bench", "distributed", *recorded_versions(), *plugins})
    networks = _networks(suite)
    with _connected(address) as client:
        # Where there are no workers yet, one is waited for, or started because of this task.
        list(_finished(client, {client.submit(getpid, pure=False): "a first task"}, str, limit_s))
        job = client.submit(  # a task itself: a worker is sent it once, and it is never lost
            Job,
            suite=suite.model_dump_json(),
            distributions=distributions,
            software=_same_software(client, distributions),
            code_sha256=harness_sha256(),
            agents=agents,
            networks=networks,
            pure=False,
        )
        futures = client.map(run_shard, [astuple(shard) for shard in shards], job=job, pure=False)
        sent = dict(zip(futures, shards, strict=True))
        del futures  # a worker keeps a shard's files as long as there is a future of them
        yield from _finished(client, sent, title, limit_s)


@contextmanager
def _connected(address: str) -> Iterator["Client"]:
    from distributed import CancelledError, Client, Security
    from distributed.versions import VersionMismatchWarning

    if address.startswith("tls:") and not Security().get_connection_args("client")["ssl_context"]:
        raise ClusterError(
            f"{address} needs a certificate, and Dask's configuration has none; expected "
            "distributed.comm.tls.ca-file, distributed.comm.tls.client.cert and .key"
        )
    for handler in logging.getLogger("distributed").handlers:
        handler.setLevel(logging.CRITICAL)  # our errors say what is wrong
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", VersionMismatchWarning)  # `_same_software` says more
            client = Client(address, set_as_default=False)
    except OSError as error:
        raise ClusterError(f"no Dask scheduler answers at {address}: {error}") from error
    with client:
        try:
            yield client
        except (CancelledError, OSError) as error:
            raise ClusterError(f"{address}: the scheduler is gone") from error


def _same_software(client: "Client", distributions: Sequence[str]) -> dict[str, str | None]:
    """What this machine and all workers have installed.

    Raises:
        ClusterError: A worker, or the scheduler, has something else.
    """
    versions = client.get_versions(packages=distributions)
    here = software(versions["client"], distributions)
    scheduler = software(versions["scheduler"], ["charms-bench"])
    found = {"the scheduler": differences(scheduler, {name: here[name] for name in scheduler})}
    for worker, there in versions["workers"].items():
        found[f"worker {worker}"] = differences(software(there, distributions), here)
    for where, different in found.items():
        if different:
            others = sum(map(bool, found.values())) - 1
            more = f" ({others} more differ)" if others else ""
            raise ClusterError(f"{where}: {different}; install the same there as here{more}")
    return here


def _networks(suite: Suite) -> dict[str, bytes]:
    """The files of networks given by path, by that path."""
    paths = [ego.agent.onnx for ego in suite.egos if ego.agent.onnx is not None]
    return {str(path): (suite.folder / path).read_bytes() for path in paths}


def _finished(
    client: "Client", sent: dict["Future", T], title: Callable[[T], str], limit_s: float
) -> Iterator[tuple[T, Any]]:
    """Takes futures out of `sent` as they finish: what they are of, and their results.

    Raises:
        ClusterError: The cluster has no workers, or a shard is too much for it.
        CharmsBenchError: A worker raised it.
    """
    from distributed import KilledWorker

    address = client.scheduler.address
    done: SimpleQueue[Future] = SimpleQueue()
    for future in sent:
        future.add_done_callback(done.put)
    finished_s = manned_s = time.monotonic()
    while sent:
        try:
            future = done.get(timeout=_POLL_S)
        except Empty:
            now = time.monotonic()
            manned_s = now if _has_workers(client) else manned_s
            if now - manned_s > WORKERLESS_S:
                raise ClusterError(
                    f"{address} has had no workers for {WORKERLESS_S:g} s; "
                    f"`dask worker {address} --nthreads 1` starts one"
                ) from None
            if now - finished_s > limit_s:
                raise ClusterError(f"{address} has finished nothing for {limit_s:g} s") from None
            continue
        try:
            result = future.result(timeout=_FETCH_S)
        except TimeoutError:  # lost with its worker, and simulated again
            future.add_done_callback(done.put)
            continue
        except KilledWorker as error:
            lost = f"{error.allowed_failures + 1} workers, the last at {error.last_worker.address}"
            raise ClusterError(f"{title(sent[future])}: has cost {lost}") from error
        finished_s = manned_s = time.monotonic()
        yield sent.pop(future), result


def _has_workers(client: "Client") -> bool:
    try:
        return bool(client.nthreads())
    except OSError:  # the futures will say that it is gone
        return True
