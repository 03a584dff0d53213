"""Simulates shards on a Dask cluster, whose workers need no file system in common with us."""

import asyncio
import logging
import pickle
import time
import warnings
from collections.abc import Callable, Generator, Iterator, Sequence
from contextlib import contextmanager
from functools import partial
from os import getpid
from queue import Empty, SimpleQueue
from typing import TYPE_CHECKING, Any, TypeVar
from urllib.parse import urlsplit

from charms_bench.errors import ClusterError, InputError, named
from charms_bench.foundation.threads import ONE_THREAD
from charms_bench.runs.cluster_worker import Job, describe_platform, run_shard
from charms_bench.runs.code_hashes import differences
from charms_bench.runs.runner import Notice, SimulateAll
from charms_bench.runs.shard import ShardFiles, ShardTask

if TYPE_CHECKING:
    from distributed import Client, Future

T = TypeVar("T")
WORKERLESS_S = 60.0
"""Seconds that a cluster may have no workers: they may be starting, or being replaced."""
_FETCH_S = 60.0
_POLL_S = 1.0


def on_cluster(address: str) -> SimulateAll:
    """A function that simulates shards on the Dask cluster with its scheduler at `address`.

    Raises an `InputError` if the address has another form, or Dask is not installed.
    """
    try:
        url = urlsplit(address)
        rest = url.path or url.query or url.fragment or url.username
        valid = url.scheme in ("tcp", "tls") and url.hostname and url.port and not rest
    except ValueError:  # the port is not a number below 65,536
        valid = False
    if not valid:
        raise InputError(
            f"--cluster {address}: expected tcp://HOST:PORT or tls://HOST:PORT, as the scheduler "
            "prints it when it starts"
        )
    try:
        import distributed  # noqa: F401  # only whether it is installed
    except ImportError as error:
        raise InputError(
            f"--cluster needs Dask ({error}); pip install 'charms-bench[cluster]'"
        ) from error
    return partial(_simulate_all, address)


def _simulate_all(
    address: str, tasks: Sequence[ShardTask], limit_s: float, notice: Notice
) -> Generator[tuple[ShardTask, ShardFiles], None, None]:
    """Simulates shards on the cluster; see `SimulateAll`.

    When the generator is closed its client is too, and then the scheduler drops what is left.
    """
    if not tasks:
        return
    networks = {}
    names = {"charms-bench", "distributed"}
    for task in tasks:
        agents = task.software.agents
        names |= task.software.versions.keys()
        names |= {agent["distribution"] for agent in agents.values() if "distribution" in agent}
        for name, path in task.networks.items():
            networks[agents[name]["weights_sha256"]] = path
    with _connected(address) as client:
        # Where there are no workers yet, this waits for one, or has the cluster start one.
        list(_finished(client, {client.submit(getpid, pure=False): "a first task"}, str, limit_s))
        job = client.submit(  # as a task, it is sent to a worker once and is never lost
            Job,
            platform=_common_platform(client, sorted(names)),
            environment=ONE_THREAD,
            networks={sha256: path.read_bytes() for sha256, path in networks.items()},
            pure=False,
        )
        futures = client.map(run_shard, [pickle.dumps(task) for task in tasks], job=job, pure=False)
        sent = dict(zip(futures, tasks, strict=True))
        del futures  # a worker keeps a shard's files as long as there is a future of them
        yield from _finished(client, sent, lambda task: task.title, limit_s)


@contextmanager
def _connected(address: str) -> Iterator["Client"]:
    import dask
    from dask.utils import parse_timedelta
    from distributed import CancelledError, Client, Security
    from distributed.versions import VersionMismatchWarning

    if address.startswith("tls:") and not Security().get_connection_args("client")["ssl_context"]:
        raise ClusterError(
            f"{address} needs a certificate, and Dask's configuration has none; expected "
            "distributed.comm.tls.ca-file, distributed.comm.tls.client.cert and .key"
        )
    for handler in logging.getLogger("distributed").handlers:
        handler.setLevel(logging.CRITICAL)  # our own errors report what is wrong
    limit_s = parse_timedelta(dask.config.get("distributed.comm.timeouts.connect")) + 1.0
    try:
        asyncio.run(asyncio.wait_for(_greet(address), limit_s))
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", VersionMismatchWarning)  # `_common_platform` says more
            client = Client(address, set_as_default=False)
    except Exception as error:  # another kind of server can answer anything
        what = f"silent for {limit_s:g} s" if type(error) is TimeoutError else named(error)
        raise ClusterError(f"no Dask scheduler answers at {address}: {what}") from error
    with client:
        try:
            yield client
        except (CancelledError, OSError) as error:
            raise ClusterError(f"{address}: the scheduler is gone") from error


async def _greet(address: str) -> None:
    """Exchanges greetings with a scheduler, for which Dask's client would wait without end."""
    from distributed import Security
    from distributed.comm import connect

    comm = await connect(address, **Security().get_connection_args("client"))
    await comm.close()


def _common_platform(client: "Client", distributions: Sequence[str]) -> dict[str, str | None]:
    """Returns what this machine and all workers have installed, if it is the same."""
    versions = client.get_versions(packages=distributions)
    here = describe_platform(versions["client"], distributions)
    scheduler = describe_platform(versions["scheduler"], ["charms-bench"])
    found = {"the scheduler": differences(scheduler, {name: here[name] for name in scheduler})}
    for worker, there in versions["workers"].items():
        found[f"worker {worker}"] = differences(describe_platform(there, distributions), here)
    for where, different in found.items():
        if different:
            others = sum(map(bool, found.values())) - 1
            more = f" ({others} more differ)" if others else ""
            raise ClusterError(f"{where}: {different}; install the same software there{more}")
    return here


def _finished(
    client: "Client", sent: dict["Future", T], title: Callable[[T], str], limit_s: float
) -> Iterator[tuple[T, Any]]:
    """Yields what was sent with its result when it is finished, and takes it out of `sent`."""
    from distributed import KilledWorker

    address = client.scheduler.address
    done: SimpleQueue[Future] = SimpleQueue()
    for future in sent:
        future.add_done_callback(done.put)
    finished_s = staffed_s = time.monotonic()
    while sent:
        try:
            future = done.get(timeout=_POLL_S)
        except Empty:
            now = time.monotonic()
            staffed_s = now if _has_workers(client) else staffed_s
            if now - staffed_s > WORKERLESS_S:
                raise ClusterError(
                    f"{address} has had no workers for {WORKERLESS_S:g} s; "
                    f"`dask worker {address} --nthreads 1` starts one"
                ) from None
            if now - finished_s > limit_s:
                raise ClusterError(f"{address} has finished nothing for {limit_s:g} s") from None
            continue
        try:
            result = future.result(timeout=_FETCH_S)
        except TimeoutError:  # the files were lost with their worker; the shard is simulated again
            future.add_done_callback(done.put)
            continue
        except KilledWorker as error:
            lost = f"{error.allowed_failures + 1} workers, the last at {error.last_worker.address}"
            raise ClusterError(f"{title(sent[future])}: ended {lost}") from error
        finished_s = staffed_s = time.monotonic()
        yield sent.pop(future), result


def _has_workers(client: "Client") -> bool:
    try:
        return bool(client.nthreads())
    except OSError:  # the scheduler is gone, which the futures report
        return True
