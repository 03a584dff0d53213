"""The engine is compiled once, and says so."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

SUITE = """\
suite: small
episodes: 1
scene: {duration_s: 2}
egos: [{agent: idm_mobil}]
traffic_models: [{traffic: idm_mobil}]
"""
COMPILING = "compiling the engine (once, about half a minute)"


def called(folder: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    """The command line of an installation whose compiled code is in `folder`."""
    environment = os.environ | {"NUMBA_CACHE_DIR": str(folder / "cache")}
    return subprocess.run(
        [sys.executable, "-m", "charms_bench", *arguments],
        cwd=folder,
        env=environment,
        capture_output=True,
        text=True,
        check=True,
    )


def compiled_files(folder: Path) -> set[str]:
    """The files of compiled functions that belong to the engine."""
    return {path.name for path in (folder / "cache").glob("engine_*/*.nbc")}


@pytest.mark.slow
def test_the_engine_is_compiled_once_with_progress_and_a_run_finds_it(tmp_path: Path) -> None:
    (tmp_path / "small.yaml").write_text(SUITE)
    first = called(tmp_path, "warm-up")
    assert first.stdout == "The engine is compiled.\n"
    assert first.stderr.splitlines() == [COMPILING, *(f"{k} of 5 parts" for k in range(1, 6))]
    compiled = compiled_files(tmp_path)
    assert len(compiled) > 50
    assert called(tmp_path, "warm-up").stdout == "The engine was compiled before.\n"
    assert COMPILING not in called(tmp_path, "run", "small.yaml").stderr
    assert compiled_files(tmp_path) == compiled


@pytest.mark.slow
def test_the_first_run_says_that_it_compiles_the_engine(tmp_path: Path) -> None:
    (tmp_path / "small.yaml").write_text(SUITE)
    said = called(tmp_path, "run", "small.yaml").stderr.splitlines()
    assert said == [COMPILING, *(f"{k} of 5 parts" for k in range(1, 6)), "1 of 1 episodes"]
