"""Commands whose standard streams are closed or full."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

needs_full = pytest.mark.skipif(not os.path.exists("/dev/full"), reason="needs /dev/full")
SUITE = """\
suite: small
episodes: 6
scene: {duration_s: 2.0, traffic_vehicles: 5}
egos: [{agent: idm_mobil}]
traffic_models: [{traffic: idm_mobil}]
"""


def called(redirection: str, folder: Path, *words: str) -> subprocess.CompletedProcess[str]:
    """Calls a command with a redirection of the shell."""
    command = [sys.executable, "-m", "charms_bench", *words]
    return subprocess.run(
        ["sh", "-c", f'"$@" {redirection}', "sh", *command],
        cwd=folder,
        capture_output=True,
        text=True,
        check=False,
    )


@pytest.mark.parametrize(
    "redirection", [">&- 2>&- <&-", pytest.param("2>/dev/full", marks=needs_full)]
)
def test_a_run_whose_messages_nobody_can_read_is_finished(redirection: str, tmp_path: Path) -> None:
    (tmp_path / "suite.yaml").write_text(SUITE)
    done = called(redirection, tmp_path, "run", "suite.yaml", "--workers", "1")
    assert (done.returncode, "Traceback" in done.stderr) == (0, False), done
    assert len(list(tmp_path.glob("runs/small/checksums/*"))) == 1
    assert (tmp_path / "runs" / "small" / "tables" / "small.csv").exists()


@needs_full
@pytest.mark.parametrize("words", [("agents",), ("agents", "--json")])
def test_results_that_cannot_be_written_are_an_error(words: list[str], tmp_path: Path) -> None:
    done = called(">/dev/full", tmp_path, *words)
    assert done.returncode == 2
    assert done.stderr == "error: standard output: cannot be written: No space left on device\n"


@needs_full
def test_an_error_that_cannot_be_written_has_its_exit_code(tmp_path: Path) -> None:
    assert called(">/dev/full 2>/dev/full", tmp_path, "agents").returncode == 2
