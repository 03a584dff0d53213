"""Runs on a cluster, started as in docs/running.md: they write the bytes of a local run."""

import os
import re
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from importlib.resources import files as packaged
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("dask", reason="needs the extra 'cluster'")

from command_line import charms_bench
from dask_cluster import PATIENCE_S, DaskCluster, wait_until
from run_folders import files

from charms_bench.errors import ClusterError, InputError
from charms_bench.runs.cluster import on_cluster
from charms_bench.runs.code_hashes import differences
from charms_bench.runs.runner import plan
from charms_bench.runs.suite import Suite

SHARDS = 8
SUITE = """\
suite: away
episodes: 600
scene: {duration_s: 8}
egos: [{agent: {onnx: ../network.onnx}}, {agent: stackelberg}]
traffic_models: [{traffic: {mixture: {../network.onnx: 0.1, idm_mobil: 0.9}}}]
"""
PAGE = Path(__file__).parents[2] / "docs" / "running.md"
JOBQUEUE = """\
from distributed import LocalCluster

class SLURMCluster(LocalCluster):
    def __init__(self, cores, processes, memory, walltime):
        assert cores == processes
        super().__init__(n_workers=1, threads_per_worker=1, dashboard_address=None)

    def scale(self, n=0, jobs=None):
        if jobs is None:  # when it closes
            return super().scale(n)
"""
"""A `dask_jobqueue` that starts its worker here."""
GUARDED = "import runpy; __name__ == '__main__' and runpy.run_path('on_slurm.py')"
HURRIED = "import charms_bench.runs.cluster as client; client.WORKERLESS_S = 1.0"


@pytest.fixture(scope="module")
def suite_file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A suite of `SHARDS` shards, and a network that does not lie below it."""
    folder = tmp_path_factory.mktemp("client")
    network = packaged("charms_agents") / "policies" / "imitation.onnx"
    (folder / "network.onnx").write_bytes(network.read_bytes())
    path = folder / "suites" / "away.yaml"
    path.parent.mkdir()
    path.write_text(SUITE)
    return path


@pytest.fixture(scope="module")
def at_home(suite_file: Path) -> dict[str, str]:
    """The files of a run on this machine."""
    output = suite_file.parent / "home"
    assert charms_bench("run", suite_file, "--workers", 1, "--output", output).returncode == 0
    return files(output)


@pytest.fixture
def cluster(tmp_path: Path) -> Iterator[DaskCluster]:
    (tmp_path / "cluster").mkdir()
    started = DaskCluster(tmp_path / "cluster")
    yield started
    started.stop()


def start(
    suite: Path, output: Path, *options: str, before: str = "", connect_s: int = 30
) -> subprocess.Popen[str]:
    """Starts a run; `before` is Python code to run first."""
    main = f"import signal; signal.signal(signal.SIGINT, signal.default_int_handler); {before}"
    arguments = ["run", str(suite), "--output", str(output), "--json", *options]
    return subprocess.Popen(
        # -P: the installed package, like the calls in this process, and not that of the checkout.
        [
            sys.executable,
            "-P",
            "-c",
            f"{main}\nfrom charms_bench.cli import main; main()",
            *arguments,
        ],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
        env=os.environ | {"DASK_DISTRIBUTED__COMM__TIMEOUTS__CONNECT": f"{connect_s}s"},
    )


def finished(run: subprocess.Popen[str]) -> tuple[int, str]:
    """Returns its exit code and its messages without progress."""
    _, said = run.communicate(timeout=PATIENCE_S)
    return run.returncode, re.sub(r"[\d,]+ of [\d,]+ episodes\n", "", said)


def landed(output: Path) -> int:
    """Returns the number of shards in a run folder."""
    return len(list(output.glob("checksums/*.sha256")))


def test_a_worker_that_is_killed_changes_no_byte(
    suite_file: Path, at_home: dict[str, str], cluster: DaskCluster, tmp_path: Path
) -> None:
    cluster.start_worker()
    victim = cluster.start_worker("--no-nanny")
    run = start(suite_file, tmp_path / "run", "--cluster", cluster.address)
    wait_until(lambda: landed(tmp_path / "run") >= 1)
    assert landed(tmp_path / "run") < SHARDS
    victim.kill()
    assert finished(run) == (0, "")
    assert files(tmp_path / "run") == at_home


@pytest.mark.parametrize(
    "address",
    ["localhost:8786", "tcp://localhost", "http://h:8786", "tcp://h:86000", "tcp://h:1/x", "tcp:"],
)
def test_an_invalid_address_is_rejected_with_the_expected_form(address: str) -> None:
    with pytest.raises(InputError, match=re.escape(f"{address}: expected tcp://HOST:PORT or tls:")):
        on_cluster(address)


def test_tls_without_a_certificate_says_where_dask_looks_for_one() -> None:
    agent = {"egos": [{"agent": "idm_mobil"}], "traffic_models": [{"traffic": "idm_mobil"}]}
    suite = Suite.model_validate({"suite": "x", "episodes": 1, **agent})
    simulate_all = on_cluster("tls://127.0.0.1:8786")
    shards = simulate_all(list(plan(suite).values()), 1.0, print)
    with pytest.raises(ClusterError, match=r"needs a certificate.*distributed\.comm\.tls\.ca-file"):
        next(shards)


def test_a_scheduler_that_does_not_answer_is_named(suite_file: Path, tmp_path: Path) -> None:
    run = start(suite_file, tmp_path / "run", "--cluster", "tcp://127.0.0.1:9", connect_s=1)
    code, said = finished(run)
    assert code == 2
    assert said.startswith(
        "error: no Dask scheduler answers at tcp://127.0.0.1:9: OSError: Timed out"
    )
    assert "Traceback" not in said


@pytest.mark.parametrize(
    ("answer", "reason"), [(b"", ": silent for 2 s"), (b"HTTP/1.1 400 Bad\r\n", "")]
)
def test_a_server_of_another_kind_is_named(
    answer: bytes, reason: str, suite_file: Path, tmp_path: Path
) -> None:
    with socket.create_server(("127.0.0.1", 0)) as server:
        address = f"tcp://127.0.0.1:{server.getsockname()[1]}"
        run = start(suite_file, tmp_path / "run", "--cluster", address, connect_s=1)
        connection, _ = server.accept()
        with connection:
            connection.sendall(answer * 100)
            code, said = finished(run)
    assert code == 2
    assert f"error: no Dask scheduler answers at {address}" in said
    assert reason in said
    assert "Traceback" not in said


def test_a_difference_names_what_was_found_and_what_was_expected() -> None:
    found = {"numba": "0.60.0", "polars": None, "python": "3.11.7"}
    expected = {"numba": "0.68.1", "polars": "2.1.0", "python": "3.11.7"}
    assert differences(found, expected) == (
        "numba is 0.60.0, expected 0.68.1; polars is missing, expected 2.1.0"
    )
    assert differences(expected, expected) == ""


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(10))
def test_a_worker_may_be_killed_at_any_moment(
    suite_file: Path, at_home: dict[str, str], cluster: DaskCluster, tmp_path: Path, seed: int
) -> None:
    rng = np.random.default_rng(seed)
    cluster.start_worker()
    nannied = seed % 2 == 0
    victim = cluster.start_worker(*([] if nannied else ["--no-nanny"]))
    run = start(suite_file, tmp_path / "run", "--cluster", cluster.address)
    shards = int(rng.integers(SHARDS - 1))
    wait_until(lambda: landed(tmp_path / "run") >= shards)
    time.sleep(rng.uniform(0.0, 0.5))
    if nannied:
        (worker,) = children(victim.pid)
        os.kill(worker, signal.SIGKILL)  # which the nanny replaces
    else:
        victim.kill()
    assert finished(run) == (0, "")
    assert files(tmp_path / "run") == at_home


@pytest.mark.slow
@pytest.mark.parametrize(("distribution", "version"), [("numba", "0.0.1"), ("outside-plugin", "9")])
def test_a_worker_with_other_versions_is_named(
    cluster: DaskCluster, tmp_path: Path, distribution: str, version: str
) -> None:
    other = tmp_path / f"{distribution.replace('-', '_')}-{version}.dist-info"
    other.mkdir()
    (other / "METADATA").write_text(f"Name: {distribution}\nVersion: {version}\n")
    cluster.start_worker()
    cluster.start_worker(packages=tmp_path)
    suite = tmp_path / "suite.yaml"
    agents = re.sub(r"\{onnx: \S+?\}|\.\./network\.onnx", "outside_policy", SUITE)
    suite.write_text(agents)
    code, said = finished(start(suite, tmp_path / "run", "--cluster", cluster.address))
    assert code == 2
    assert re.match(rf"error: worker tcp://\S+: {distribution} is {version}, expected \d", said)


@pytest.mark.slow
@pytest.mark.parametrize("gone", ["workers", "scheduler"])
def test_a_cluster_that_is_gone_is_said_to_be_and_the_run_goes_on_later(
    suite_file: Path, at_home: dict[str, str], cluster: DaskCluster, tmp_path: Path, gone: str
) -> None:
    worker = cluster.start_worker("--no-nanny")
    output = tmp_path / "run"
    run = start(suite_file, output, "--cluster", cluster.address, before=HURRIED, connect_s=3)
    wait_until(lambda: landed(output) >= 2)
    (worker if gone == "workers" else cluster.scheduler).kill()
    code, said = finished(run)
    expected = {"workers": "has had no workers for 1 s", "scheduler": "the scheduler is gone"}
    assert (code, expected[gone] in said, "Traceback" in said) == (2, True, False)
    assert f"finished shards are in {output}; the same command continues" in said
    assert finished(start(suite_file, output)) == (0, "")
    assert files(output) == at_home


@pytest.mark.slow
def test_ctrl_c_leaves_nothing_to_do_on_the_cluster(
    suite_file: Path, cluster: DaskCluster, tmp_path: Path
) -> None:
    cluster.start_worker()
    run = start(suite_file, tmp_path / "run", "--cluster", cluster.address, "--episodes", "60000")
    wait_until(lambda: landed(tmp_path / "run") >= 1)
    run.send_signal(signal.SIGINT)
    code, said = finished(run)
    assert code == 130
    assert "interrupted; finished shards are in" in said
    left = (
        "import sys; from distributed import Client; client = Client(sys.argv[1])\n"
        "print(client.run_on_scheduler(lambda dask_scheduler: list(dask_scheduler.clients)))\n"
        "print(client.run_on_scheduler(lambda dask_scheduler: len(dask_scheduler.unrunnable) +"
        " sum(task.state in ('queued', 'waiting') for task in dask_scheduler.tasks.values())))"
    )
    asked = [sys.executable, "-c", left, cluster.address]
    clients, tasks = subprocess.run(asked, capture_output=True, text=True).stdout.splitlines()[:2]
    assert (clients.count("Client-"), tasks) == (1, "0")


def children(pid: int) -> list[int]:
    """The worker processes of a nanny."""
    import psutil

    return [
        child.pid
        for child in psutil.Process(pid).children()
        if any("spawn_main" in word for word in child.cmdline())
    ]


def test_the_script_for_slurm_runs_a_suite_on_the_workers_that_it_asked_for(
    suite_file: Path, at_home: dict[str, str], tmp_path: Path
) -> None:
    (script,) = re.findall(r"```python\n(.*?)```", PAGE.read_text(encoding="utf-8"), re.DOTALL)
    (tmp_path / "on_slurm.py").write_text(script)
    (tmp_path / "dask_jobqueue.py").write_text(JOBQUEUE)
    done = subprocess.run(
        [sys.executable, "-c", GUARDED, str(suite_file)],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        check=False,
        env={
            **os.environ,
            "PATH": f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}",
        },
    )
    assert done.returncode == 0, done.stderr
    assert files(tmp_path / "runs" / "away") == at_home
