"""A Dask cluster on this machine; its scheduler and workers are processes."""

import json
import os
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

PATIENCE_S = 900.0


class DaskCluster:
    """A scheduler and its workers, with their files in one folder."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self._processes: list[subprocess.Popen[bytes]] = []
        said = folder / "scheduler.json"
        options = ("--host", "127.0.0.1", "--port", "0", "--dashboard-address", "127.0.0.1:0")
        self.scheduler, _ = self._start("scheduler", "--scheduler-file", str(said), *options)
        wait_until(lambda: said.exists() and said.read_text().rstrip().endswith("}"))
        self.address: str = json.loads(said.read_text())["address"]

    def start_worker(self, *options: str, packages: Path | None = None) -> subprocess.Popen[bytes]:
        """Starts a worker and waits until it has joined.

        Args:
            options: Of `dask worker`.
            packages: A folder that is searched for packages before the installed ones.
        """
        always = ("--nthreads", "1", "--no-dashboard", "--local-directory", str(self.folder))
        worker, log = self._start("worker", self.address, *always, *options, packages=packages)
        wait_until(lambda: "established connection" in log.read_text())
        return worker

    def stop(self) -> None:
        """Ends every process that was started; a worker that simulates does not end by itself."""
        for process in reversed(self._processes):
            process.terminate()
        for process in reversed(self._processes):
            try:
                process.wait(timeout=10)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()

    def _start(
        self, *arguments: str, packages: Path | None = None
    ) -> tuple[subprocess.Popen[bytes], Path]:
        log = self.folder / f"{len(self._processes)}.log"
        path = (packages, os.environ.get("PYTHONPATH"))
        with log.open("wb") as file:
            process = subprocess.Popen(
                [sys.executable, "-m", "dask", *arguments],
                stdout=subprocess.DEVNULL,
                stderr=file,
                cwd=self.folder,
                env=os.environ | {"PYTHONPATH": os.pathsep.join(map(str, filter(None, path)))},
            )
        self._processes.append(process)
        return process, log


def wait_until(happened: Callable[[], bool]) -> None:
    """Waits for something that another process does."""
    started = time.monotonic()
    while not happened():
        assert time.monotonic() - started < PATIENCE_S
        time.sleep(0.02)
