"""Features make what was recorded: environments, planners, states, searches and exports."""

import json
import os
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest
from rows.cells import PROJECT
from rows.features import CASES, lacks

RECORDED = json.loads((Path(__file__).parent / "rows" / "data" / "features.json").read_text())


@pytest.mark.parametrize("name", RECORDED)
def test_a_feature_makes_what_was_recorded(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(PROJECT)
    if module := lacks(name):
        pytest.skip(f"needs {module}")
    assert json.loads(json.dumps(CASES[name](tmp_path))) == RECORDED[name]


WHOLE = {name: values for name, values in RECORDED.items() if name.startswith("whole scenes")}


def test_scenes_are_the_same_when_several_threads_simulate_at_once() -> None:
    with ThreadPoolExecutor(4) as pool:
        found = pool.map(lambda name: CASES[name](Path()), WHOLE)
        assert dict(zip(WHOLE, found, strict=True)) == WHOLE


def test_scenes_are_the_same_without_the_processors_extensions() -> None:
    """The code is compiled for the oldest x86-64 processor, which has neither AVX nor FMA."""
    found = subprocess.run(
        [sys.executable, "-m", "rows.simulations"],
        cwd=Path(__file__).parent,
        env={**os.environ, "NUMBA_CPU_NAME": "generic", "NUMBA_CPU_FEATURES": ""},
        check=True,
        stdout=subprocess.PIPE,
    )
    assert json.loads(found.stdout) == WHOLE
