"""Whole episodes have the bits that they had when the hashes were written."""

import json
import os
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import golden
import pytest

EXPECTED = json.loads(Path(__file__).with_name("golden.json").read_text())


@pytest.mark.parametrize("case", golden.CASES)
def test_each_episode_has_its_bits(case: str) -> None:
    assert golden.hashes(case) == EXPECTED[case]


def test_episodes_have_the_same_bits_when_several_threads_simulate_at_once() -> None:
    with ThreadPoolExecutor(4) as pool:
        assert dict(zip(golden.CASES, pool.map(golden.hashes, golden.CASES), strict=True)) == (
            EXPECTED
        )


def test_episodes_have_the_same_bits_without_the_processors_extensions() -> None:
    """The code is compiled for the oldest x86-64 processor, which has neither AVX nor FMA."""
    environment = {**os.environ, "NUMBA_CPU_NAME": "generic", "NUMBA_CPU_FEATURES": ""}
    found = subprocess.run(
        [sys.executable, golden.__file__], env=environment, check=True, stdout=subprocess.PIPE
    )
    assert json.loads(found.stdout) == EXPECTED
