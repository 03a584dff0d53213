"""Runs that are killed, damaged, locked or out of space: a message, and the command continues."""

import errno
import os
import random
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

import pytest
import yaml
from plugin_folder import installed
from run_folders import files

from charms_bench.errors import RunFolderError
from charms_bench.foundation.files import write_bytes
from charms_bench.runs.lock import locked
from charms_bench.runs.resumable_folder import CHECKSUMS, KINDS, RunFolder
from charms_bench.runs.runner import run
from charms_bench.runs.shard_names import Shard
from charms_bench.runs.suite import Suite, load_suite

SMALL = {
    "suite": "small",
    "episodes": 4,
    "scene": {"duration_s": 1.0, "traffic_vehicles": 5},
    "egos": [{"agent": "idm_mobil"}],
    "traffic_models": [{"traffic": "idm_mobil"}],
}
SUITE = """\
suite: survivor
episodes: EPISODES
scene: {duration_s: 3, traffic_vehicles: 8}
egos: [{agent: idm_mobil}, {agent: stackelberg}]
traffic_models: [{traffic: idm_mobil}]
"""
ON_A_ROAD = """\
suite: survivor
episodes: EPISODES
scene: {duration_s: 3, profile: {name: charms, target_speed_min_mps: 0.0}}
egos: [{agent: idm_mobil}]
roads: [intersection-v2]
traffic_models: [{traffic: {mixture: {human: 0.5, charms: 0.5}}}]
"""
SMALL_SHARDS = """\
import signal
from charms_bench.runs import shard_names
from charms_bench.cli import main
signal.signal(signal.SIGINT, signal.default_int_handler)  # whatever who starts this has ignored
shard_names.SHARD_EPISODES = 5
main()
"""


def start(
    suite: Path, output: Path, *options: object, env: dict[str, str] | None = None
) -> subprocess.Popen[str]:
    """Starts a run of many small shards in its own process group."""
    arguments = ["run", suite, "--output", output, "--workers", 1, *options]
    return subprocess.Popen(
        [sys.executable, "-c", SMALL_SHARDS, *map(str, arguments)],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
        env=env,
    )


def ended(process: subprocess.Popen[str]) -> tuple[int, str]:
    """Returns the exit code and the messages."""
    _, said = process.communicate(timeout=600)
    assert "Traceback" not in said, said
    return process.returncode, said


def finished_shards(folder: Path) -> int:
    return len(list((folder / CHECKSUMS).glob("*.sha256")))


def wait_for_shards(running: subprocess.Popen[str], folder: Path, count: int) -> None:
    while finished_shards(folder) < count and running.poll() is None:
        time.sleep(0.005)


@pytest.fixture
def suite_file(tmp_path: Path) -> Path:
    path = tmp_path / "suite.yaml"
    path.write_text(SUITE.replace("EPISODES", "50"))
    return path


@pytest.mark.parametrize(
    ("suite", "kills", "episodes", "workers"),
    [
        pytest.param(ON_A_ROAD, 2, 20, 2, id="on a road"),
        pytest.param(SUITE, 50, 300, 1, marks=pytest.mark.slow, id="50 times"),
        pytest.param(SUITE, 20, 300, 2, marks=pytest.mark.slow, id="20 times with two workers"),
    ],
)
def test_killed_at_random_moments_a_run_ends_as_if_nothing_had_happened(
    tmp_path: Path, suite: str, kills: int, episodes: int, workers: int
) -> None:
    suite_file = tmp_path / "suite.yaml"
    suite_file.write_text(suite.replace("EPISODES", str(episodes)))
    assert ended(start(suite_file, tmp_path / "undisturbed"))[0] == 0
    shards = finished_shards(tmp_path / "undisturbed")
    rng, killed = random.Random(0), tmp_path / "killed"
    for kill in range(kills):
        print(f"kill {kill}: {finished_shards(killed)} of {shards} shards")
        victim = start(suite_file, killed, "--workers", workers)
        more = rng.randint(0, 2 * shards // kills - 2)
        wait_for_shards(victim, killed, min(finished_shards(killed) + more, shards))
        # A first one may hit the start, or a shard half written; workers are killed or orphaned.
        time.sleep(rng.uniform(0.0, 0.2) if more else rng.uniform(0.0, 3.0))
        kill_how = os.killpg if rng.random() < 0.5 else os.kill
        with suppress(ProcessLookupError):  # it may have finished just before
            kill_how(victim.pid, signal.SIGKILL)
        with victim:
            assert victim.wait() in (-signal.SIGKILL, 0)
    assert ended(start(suite_file, killed))[0] == 0
    assert files(killed) == files(tmp_path / "undisturbed")


@pytest.fixture(scope="module")
def finished(tmp_path_factory: pytest.TempPathFactory) -> RunFolder:
    """The folder of one small shard."""
    return run(Suite.model_validate(SMALL), tmp_path_factory.mktemp("run") / "small").folder


@pytest.fixture
def folder(finished: RunFolder, tmp_path: Path) -> RunFolder:
    return RunFolder(Path(shutil.copytree(finished.path, tmp_path / "copy")))


def shard_files(folder: RunFolder) -> list[Path]:
    return [path for name in (CHECKSUMS, *KINDS) for path in (folder.path / name).iterdir()]


def assert_noticed(folder: RunFolder, shard: Shard, path: Path, position: int, mask: int) -> None:
    """With one byte changed, a run would do the shard again and readers reject the file."""
    whole = path.read_bytes()
    path.write_bytes(whole[:position] + bytes([whole[position] ^ mask]) + whole[position + 1 :])
    assert not folder.is_whole(shard), f"{path.name}: byte {position}"
    if path.parent.name in KINDS:
        with pytest.raises(RunFolderError, match="does not match its checksum in"):
            folder.read(path.parent.name, [shard])
    path.write_bytes(whole)


def test_a_byte_that_flips_in_a_shard_is_noticed(folder: RunFolder) -> None:
    rng = random.Random(0)
    (shard,) = folder.shards(folder.suite())
    for path in shard_files(folder):
        for _ in range(40):
            position = rng.randrange(path.stat().st_size)
            assert_noticed(folder, shard, path, position, rng.randrange(1, 256))


@pytest.mark.slow
def test_every_byte_that_flips_in_a_shard_is_noticed(folder: RunFolder) -> None:
    (shard,) = folder.shards(folder.suite())
    for path in shard_files(folder):
        for position in range(path.stat().st_size):
            for bit in range(8):
                assert_noticed(folder, shard, path, position, 1 << bit)


def test_what_was_torn_altered_or_lost_is_simulated_again(
    finished: RunFolder, folder: RunFolder
) -> None:
    torn, altered, lost = (next((folder.path / kind).iterdir()) for kind in KINDS[:3])
    torn.write_bytes(torn.read_bytes()[:-1])
    altered.write_bytes(altered.read_bytes() + b"\0")
    lost.unlink()
    notices: list[str] = []
    run(Suite.model_validate(SMALL), folder.path, notice=notices.append)
    assert files(folder.path) == files(finished.path)
    assert notices == [
        "idm_mobil in idm_mobil, episodes 0 to 3: changed since they were written; simulated again"
    ]


def test_sha256sum_says_the_same(finished: RunFolder) -> None:
    if shutil.which("sha256sum") is None:
        pytest.skip("needs sha256sum")
    (checksums,) = (finished.path / CHECKSUMS).iterdir()
    said = subprocess.run(
        ["sha256sum", "--check", checksums.relative_to(finished.path)],
        cwd=finished.path,
        capture_output=True,
        text=True,
        check=True,
    ).stdout
    assert said.count(": OK\n") == len(KINDS)


def test_a_folder_in_use_is_left_alone(folder: RunFolder) -> None:
    before = files(folder.path)
    with (
        locked(folder.path),
        pytest.raises(RunFolderError, match="another run is using this folder"),
    ):
        run(Suite.model_validate({**SMALL, "episodes": 8}), folder.path)
    assert files(folder.path) == before


def test_what_a_killed_run_had_half_written_is_cleared_away(
    finished: RunFolder, folder: RunFolder
) -> None:
    (folder.path / "steps" / ".000.parquet.1.partial").write_bytes(b"half")
    run(Suite.model_validate(SMALL), folder.path)
    assert files(folder.path) == files(finished.path)


def test_a_full_disk_is_one_message_and_leaves_nothing_half_written(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def write_half(path: Path, data: bytes) -> int:
        with path.open("wb") as file:
            file.write(data[: len(data) // 2])
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(Path, "write_bytes", write_half)
    with pytest.raises(RunFolderError, match=r"rows: cannot be written: No space left on device"):
        write_bytes(tmp_path / "rows", b"12345678")
    assert list(tmp_path.iterdir()) == []


def test_a_terminated_run_keeps_a_second_one_out_and_says_what_is_left(
    tmp_path: Path, suite_file: Path
) -> None:
    output = tmp_path / "run"
    first = start(suite_file, output, "--episodes", 4_000)
    wait_for_shards(first, output, 1)
    with pytest.raises(RunFolderError, match="another run is using this folder; wait for it"):
        run(load_suite(suite_file), output)
    first.send_signal(signal.SIGTERM)
    code, said = ended(first)
    assert code == 128 + signal.SIGTERM
    assert f"interrupted; finished shards are in {output}, and the same command continues" in said


PLUGIN = """\
import os, signal, time
from pathlib import Path

import numpy as np
from charms_bench.plugins.agent import Policy
from charms_bench.world.actions import IDLE


class Fragile(Policy):
    # Fails unless the file `mended` is there.
    def __init__(self, how, mended):
        self.how, self.mended = how, Path(mended)

    def decide(self, observations):
        if not self.mended.exists():
            if self.how == "once":
                self.mended.touch()
            if self.how == "hangs":
                time.sleep(10**6)
            os.kill(os.getpid(), signal.SIGKILL)
        return np.full(len(observations), IDLE)
"""
PROJECT = """\
[project]
name = "fragile"
[project.entry-points."charms_bench.agents"]
fragile = "fragile:Fragile"
"""


@pytest.fixture
def fragile(tmp_path: Path) -> dict[str, str]:
    """The environment in which the agent `fragile` is installed."""
    folder = tmp_path / "plugin"
    folder.mkdir()
    (folder / "fragile.py").write_text(PLUGIN)
    (folder / "pyproject.toml").write_text(PROJECT)
    return installed(folder)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("how", "code", "message"),
    [
        ("once", 0, "was killed (SIGKILL, as when memory runs out) at Fragile in idm_mobil, epis"),
        ("always", 2, "at Fragile in idm_mobil, episodes 0 to 4, and so did 2 before it; 1 of 2 c"),
        ("hangs", 2, "Fragile in idm_mobil, episodes 0 to 4 took longer than 20 s; 1 of 2 cells"),
    ],
)
def test_a_plugin_that_kills_or_hangs_its_worker_costs_no_finished_shard(
    tmp_path: Path, fragile: dict[str, str], how: str, code: int, message: str
) -> None:
    agent = {"name": "fragile", "options": {"how": how, "mended": str(tmp_path / "mended")}}
    egos = [{"agent": "idm_mobil"}, {"agent": agent, "label": "Fragile"}]
    suite_file = tmp_path / "suite.yaml"
    suite_file.write_text(yaml.safe_dump({**SMALL, "episodes": 10, "egos": egos}))
    output, limit = tmp_path / "run", ("--shard-limit", 20)
    ends, said = ended(start(suite_file, output, *limit, env=fragile))
    assert (ends, message in said) == (code, True), said
    assert finished_shards(output) == (4 if code == 0 else 2)
    (tmp_path / "mended").touch()
    assert ended(start(suite_file, output, env=fragile))[0] == 0
    assert ended(start(suite_file, tmp_path / "undisturbed", env=fragile))[0] == 0
    assert files(output) == files(tmp_path / "undisturbed")


@pytest.fixture
def small_disk(tmp_path: Path) -> Iterator[Path]:
    """A disk of 400 KB."""
    disk = tmp_path / "disk"
    disk.mkdir()
    mount = ["mount", "-t", "tmpfs", "-o", "size=400k", "tmpfs", disk]
    if subprocess.run(mount, capture_output=True, check=False).returncode:
        pytest.skip("needs the right to mount")
    yield disk
    subprocess.run(["umount", disk], check=True)


def remount(disk: Path, options: str) -> None:
    subprocess.run(["mount", "-o", f"remount,{options}", disk], check=True)


@pytest.mark.slow
def test_a_run_goes_on_once_there_is_room_again(
    tmp_path: Path, suite_file: Path, small_disk: Path
) -> None:
    assert ended(start(suite_file, tmp_path / "undisturbed"))[0] == 0
    code, said = ended(start(suite_file, small_disk / "run"))
    assert code == 2
    assert "cannot be written: No space left on device; finished shards are in" in said
    assert 0 < finished_shards(small_disk / "run") < 20
    assert not list(small_disk.rglob("*.partial"))
    remount(small_disk, "size=10m")
    assert ended(start(suite_file, small_disk / "run"))[0] == 0
    assert files(small_disk / "run") == files(tmp_path / "undisturbed")


@pytest.mark.slow
def test_a_disk_that_is_full_of_rows_has_no_room_for_tables(
    suite_file: Path, small_disk: Path
) -> None:
    remount(small_disk, "size=10m")
    assert ended(start(suite_file, small_disk / "run"))[0] == 0
    shutil.rmtree(small_disk / "run" / "tables")
    shutil.rmtree(small_disk / "run" / "figures")
    used = sum(path.stat().st_blocks * 512 for path in small_disk.rglob("*") if path.is_file())
    (small_disk / "full").write_bytes(b"\0" * (10 * 2**20 - used - 200_000))
    with suppress(OSError), (small_disk / "fuller").open("wb", buffering=0) as file:
        while True:
            file.write(b"\0" * 4096)
    code, said = ended(start(suite_file, small_disk / "run"))
    assert (code, "cannot be written: No space left on device" in said) == (2, True), said


@pytest.mark.slow
def test_a_folder_that_became_read_only_is_one_message(suite_file: Path, small_disk: Path) -> None:
    remount(small_disk, "size=10m")
    assert ended(start(suite_file, small_disk / "run"))[0] == 0
    remount(small_disk, "ro")
    code, said = ended(start(suite_file, small_disk / "run"))
    assert (code, "cannot be written: Read-only file system" in said) == (2, True), said
    code, said = ended(start(suite_file, small_disk / "another"))
    assert (code, "cannot be written: Read-only file system" in said) == (2, True), said
