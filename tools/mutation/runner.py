"""Copies of a checkout, and runs of its tests with a mutation and without one."""

import os
import re
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from contextlib import suppress
from hashlib import sha256
from importlib.util import cache_from_source
from pathlib import Path
from typing import NamedTuple

from mutation.draw import Mutation

TOOLS = Path(__file__).parents[1]
THREADS = ("NUMBA_NUM_THREADS", "OMP_NUM_THREADS", "POLARS_MAX_THREADS")
KILLER = re.compile(r"^(?:FAILED|ERROR) (.+?)(?: - .*)?$", re.MULTILINE)
UNCOMPILED = re.compile(r"numba\.core\.errors|Failed in nopython mode")


class Ran(NamedTuple):
    """How a run of pytest ended."""

    verdict: str
    """SURVIVED, killed, timed out, or `not compiled`; passed, without a mutation."""
    by: str
    """The test that failed, or how pytest ended."""
    seconds: float


def files(checkout: Path) -> Iterator[str]:
    """The files of a checkout that git does not ignore, in order."""
    command = ["git", "ls-files", "-z", "--cached", "--others", "--exclude-standard"]
    listed = subprocess.run(command, cwd=checkout, check=True, capture_output=True, text=True)
    names = sorted(set(listed.stdout.split("\0")[:-1]))
    return (name for name in names if (checkout / name).is_file())


def copied(source: Path, folder: Path) -> Path:
    """A copy of a checkout, and the folder of its compiled code."""
    digest, taken = sha256(), list(files(source))
    for name in taken:
        digest.update(name.encode() + sha256((source / name).read_bytes()).digest())
    base = folder / digest.hexdigest()[:12]
    if not base.exists():
        unfinished = Path(tempfile.mkdtemp(dir=folder))
        (unfinished / "cache").mkdir()
        for name in taken:
            path = unfinished / "checkout" / name
            path.parent.mkdir(parents=True, exist_ok=True)
            shutil.copy2(source / name, path)
        unfinished.rename(base)
    return base


def tests_of(path: str, checkout: Path) -> list[str]:
    """The tests of the room that a module is in; those of the whole package if it is in none."""
    top, room = Path(path).with_suffix("").parts[:2]
    room = room if top == "charms_bench" else top
    for name in (f"tests/{room}", f"tests/test_{room}.py"):
        if (checkout / name).exists():
            return [name]
    return sorted(f"tests/{each.name}" for each in (checkout / "tests").glob("test_*.py"))


class Runner:
    """Runs tests in copies, whose processes end with it."""

    def __init__(self, base: Path, pytest: Sequence[str], variables: dict[str, str]) -> None:
        self.base, self._pytest, self._variables = base, pytest, variables
        self._processes: set[subprocess.Popen[bytes]] = set()
        self._is_stopped = False

    def stop(self) -> None:
        """Kills what runs."""
        self._is_stopped = True
        for process in list(self._processes):
            _kill(process)

    def mutated(self, mutation: Mutation, tests: list[str], limit_s: float) -> Ran | None:
        """What tests say about a mutation; None if they were stopped."""
        place = Path(tempfile.mkdtemp(dir=self.base.parent))
        try:
            # Links cost nothing, and both Python and numba write new files in place of old ones.
            shutil.copytree(self.base, place, copy_function=os.link, dirs_exist_ok=True)
            path = place / "checkout" / mutation.path
            code = mutation.applied(path.read_bytes())
            path.unlink()
            path.write_bytes(code)
            # Python takes old bytecode for a file of the same size and the same second.
            Path(cache_from_source(str(path))).unlink(missing_ok=True)
            return self.run(place, tests, mutation.path, limit_s)
        finally:
            shutil.rmtree(place, ignore_errors=True)

    def run(
        self, place: Path, tests: list[str], module: str = "", limit_s: float | None = None
    ) -> Ran | None:
        """What tests say in a copy."""
        checkout, start = place / "checkout", time.monotonic()
        paths = (checkout, checkout / "agents", checkout / "baselines", TOOLS)
        environment = {key: value for key, value in os.environ.items() if key[:6] != "NUMBA_"}
        environment |= dict.fromkeys(THREADS, "1") | self._variables
        environment |= {"NUMBA_CACHE_DIR": str(place / "cache"), "MUTATED": module}
        environment["PYTHONPATH"] = os.pathsep.join(map(str, paths))
        command = [sys.executable, "-m", "pytest", "-x", "-q", "-p", "no:cacheprovider"]
        command += ["-p", "mutation.first", f"--basetemp={place / 'tmp'}", *tests, *self._pytest]
        with (place / "output").open("w") as file:
            process = subprocess.Popen(
                command,
                cwd=checkout,
                env=environment,
                stdout=file,
                stderr=subprocess.STDOUT,
                start_new_session=True,
            )
        self._processes.add(process)
        try:
            passed = "SURVIVED" if module else "passed"
            verdict = "killed" if process.wait(limit_s) else passed
        except subprocess.TimeoutExpired:
            verdict = "timed out"
        finally:
            _kill(process)
            process.wait()
            self._processes.discard(process)
            shutil.rmtree(place / "tmp", ignore_errors=True)
        if self._is_stopped:
            return None
        output = (place / "output").read_text(errors="replace")
        by = next(iter(KILLER.findall(output)), "")
        if verdict == "killed":
            verdict = "not compiled" if UNCOMPILED.search(output) else verdict
            by = by or f"pytest, which ended with {process.returncode}"
        return Ran(verdict, by, round(time.monotonic() - start, 1))


def _kill(process: subprocess.Popen[bytes]) -> None:
    with suppress(ProcessLookupError):
        os.killpg(process.pid, signal.SIGKILL)
