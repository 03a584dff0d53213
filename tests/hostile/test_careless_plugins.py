"""Careless and hostile plugins: one message and exit code 2, or the rows of an honest plugin."""

import ctypes
import json
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from careless_plugins import AGENTS, HARMLESS, POLICY, REJECTED, SAID, Careless
from command_line import Called, charms_bench
from plugin_folder import installed

from charms_bench.engine.simulation import Simulation

SUITE = """\
suite: small
episodes: 6
scene: {{duration_s: 4.0, traffic_vehicles: 5}}
egos: [{{agent: {ego}}}]
traffic_models: [{{traffic: {traffic}}}]
"""
COMMAND = "import sys; from charms_bench.cli import main; main()"
TO_NEAREST = 0


@pytest.fixture(autouse=True)
def _restored(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """Undoes what the plugins do to this process."""
    monkeypatch.setattr(Simulation, "_note_collisions", Simulation._note_collisions)
    with np.errstate():
        yield
    ctypes.CDLL("libm.so.6").fesetround(TO_NEAREST)
    sys.modules.pop("careless", None)


def written(careless: Careless, folder: Path) -> None:
    """Writes the plugin and a suite with it into a folder."""
    (folder / "careless.py").write_text(careless.code)
    (folder / "pyproject.toml").write_text(
        '[project]\nname = "careless"\n'
        f'[project.entry-points."{careless.group}"]\ncareless = "careless:Careless"\n'
    )
    ego, traffic = (
        ("careless", "idm_mobil") if careless.group == AGENTS else ("level_0", "careless")
    )
    (folder / "suite.yaml").write_text(SUITE.format(ego=ego, traffic=traffic))


def run(careless: Careless, folder: Path, monkeypatch: pytest.MonkeyPatch, *more: str) -> Called:
    """Runs the plugin as its author would."""
    written(careless, folder)
    environment = installed(folder)
    words = ["run", "suite.yaml", "--workers", "1", *map(str, careless.options), *more]
    if careless.needs_worker:
        done = subprocess.run(
            [sys.executable, "-c", COMMAND, *words],
            cwd=folder,
            env=environment,
            capture_output=True,
            text=True,
            check=False,
        )
        return Called(done.returncode, done.stdout, done.stderr)
    monkeypatch.syspath_prepend(folder)
    return charms_bench(*words, cwd=folder)


def cases(plugins: tuple[Careless, ...]) -> list[object]:
    return [
        pytest.param(each, id=each.title, marks=[pytest.mark.slow] * each.needs_worker)
        for each in plugins
    ]


@pytest.mark.parametrize("careless", cases(REJECTED))
def test_a_careless_plugin_gets_no_row(
    careless: Careless, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    answer = run(careless, tmp_path, monkeypatch)
    assert answer.returncode == 2, answer
    assert "Traceback" not in answer.stderr
    assert answer.stdout == ""
    assert not list(tmp_path.glob("runs/small/tables/*"))
    said = next(line for line in answer.stderr.splitlines() if line.startswith("error: "))
    said = said.replace(f"{tmp_path}/", "")
    assert said.partition("; finished shards are in ")[0] == SAID[careless.title]


@pytest.mark.parametrize("careless", cases(HARMLESS))
def test_a_noisy_plugin_gets_the_rows_of_a_quiet_one(
    careless: Careless, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    quiet = f"{POLICY}\n\nclass Careless(Policy):\n    def decide(self, observations):\n"
    quiet += "        return np.full(len(observations), FASTER)\n"
    (tmp_path / "quiet").mkdir()
    (tmp_path / "noisy").mkdir()
    expected = run(Careless("quiet", quiet), tmp_path / "quiet", monkeypatch, "--json")
    sys.modules.pop("careless")
    found = run(careless, tmp_path / "noisy", monkeypatch, "--json")
    assert found.returncode == expected.returncode == 0, found
    assert json.loads(found.stdout) == json.loads(expected.stdout)
