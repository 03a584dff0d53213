"""What a plugin does to its process: it cannot move files, or print among the results."""

import json
import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from command_line import charms_bench
from plugin_folder import installed

PLUGIN = """\
import atexit
import os
import sys
import threading
import time
import numpy as np
from charms_bench import FASTER, SLOWER, Policy

if os.environ.get("MOVES"):
    os.chdir(os.environ["MOVES"])
if os.environ.get("PRINTS_LATE"):
    atexit.register(print, "late")


class Loud(Policy):
    def decide(self, observations):
        print("among the results")
        if os.environ.get("PRINTS_LATE"):
            os.write(1, b"past Python")
            sys.__stdout__.write("past the redirection")
        return np.full(len(observations), FASTER)


class Moving(Policy):
    def decide(self, observations):
        if os.environ.get("MOVES"):
            os.chdir(os.environ["MOVES"])
        return np.full(len(observations), FASTER)


class Torn(Policy):
    # In a tie, a digit that float32 hardly keeps decides, and the size of the batch moves it.
    def decide(self, observations):
        place = np.abs(observations[:, 1:, 1:3].sum((1, 2))).astype(float)
        is_tie = np.floor(place * 3000) % 12 == 0
        digit = np.floor(place * 3e6 + 0.5 * (len(observations) > 20)) % 2 == 0
        return np.where(is_tie & digit, SLOWER, FASTER)


class Ending(Policy):
    def decide(self, observations):
        os._exit(0)


class Crashing(Policy):
    def decide(self, observations):
        os.kill(os.getpid(), 11)


class Raising(Policy):
    class Own(BaseException):
        pass

    def decide(self, observations):
        raise self.Own("out of petrol")


class Lasting(Loud):
    def __init__(self):
        threading.Thread(target=time.sleep, args=(3600,)).start()
"""
SUITE = """\
suite: small
episodes: 30
scene: {{duration_s: 15.0, traffic_vehicles: 10}}
egos: [{{agent: {ego}}}]
traffic_models: [{{traffic: idm_mobil}}]
"""
NAMES = ("Loud", "Moving", "Torn", "Ending", "Crashing", "Raising", "Lasting")
COMMAND = "from charms_bench.cli import main; main()"


@pytest.fixture
def home(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """A folder with the plugin, in which commands run."""
    (tmp_path / "process_plugin.py").write_text(PLUGIN)
    names = "\n".join(f'{name.lower()} = "process_plugin:{name}"' for name in NAMES)
    project = '[project]\nname = "process-plugin"\n[project.entry-points."charms_bench.agents"]\n'
    (tmp_path / "pyproject.toml").write_text(project + names)
    installed(tmp_path)
    monkeypatch.syspath_prepend(tmp_path)
    for name in NAMES:
        (tmp_path / f"{name.lower()}.yaml").write_text(SUITE.format(ego=name.lower()))
    yield tmp_path
    sys.modules.pop("process_plugin", None)


def test_only_json_is_on_standard_output(home: Path) -> None:
    for words in (
        ("run", "loud.yaml", "--output", "run", "--workers", "1"),
        ("check", "loud"),
        ("show", "run"),
        ("replay", "run", "3"),
        ("what-if", "run", "3", "--at", "2", "--agent", "loud"),
        ("edge-cases", "run", "--top", "1"),
        ("dataset", "run", "--format", "highd", "--episodes", "1"),
        ("report", "run", "--top", "1"),
    ):
        answer = charms_bench(*words, "--json", cwd=home)
        assert answer.returncode == 0, answer.stderr
        json.loads(answer.stdout)
        assert words[0] in ("show", "check") or "among the results" in answer.stderr, words


def test_what_a_plugin_prints_past_python_is_not_on_standard_output(home: Path) -> None:
    charms_bench("run", "loud.yaml", "--output", "run", "--workers", "1", cwd=home)
    done = subprocess.run(
        [sys.executable, "-c", COMMAND, "replay", "run", "3", "--json"],
        cwd=home,
        env={**os.environ, "PYTHONPATH": str(home), "PRINTS_LATE": "1"},
        capture_output=True,
        text=True,
        check=True,
    )
    json.loads(done.stdout)
    for printed in ("among the results", "past Python", "past the redirection", "late"):
        assert printed in done.stderr


@pytest.mark.parametrize(
    ("name", "code", "message"),
    [
        ("ending", 2, "ended with exit code 0 at the check of 'ending', after 1 rule\n"),
        ("crashing", 2, "was killed (SIGSEGV) at the check of 'crashing', after 1 rule\n"),
        ("raising", 2, "Own: out of petrol"),
        ("lasting", 0, ""),
    ],
)
def test_a_check_outlives_its_plugin_and_the_plugins_threads(
    home: Path, name: str, code: int, message: str
) -> None:
    answer = charms_bench("check", name, cwd=home)
    assert answer.returncode == code
    assert message in answer.stderr


@pytest.mark.parametrize(
    "words", [("what-if", "run", 3, "--at", 2, "--agent", "ending"), ("watch", "ending")]
)
def test_a_plugin_that_ends_its_process_is_named(home: Path, words: tuple[object, ...]) -> None:
    charms_bench("run", "loud.yaml", "--output", "run", "--workers", 1, cwd=home)
    answer = charms_bench(*words, cwd=home, columns=300)
    assert answer.returncode == 2
    assert "error: agent 'ending', episode" in answer.stderr
    assert "raised SystemExit: 0" in answer.stderr


@pytest.mark.parametrize("ego", ["loud", "moving"], ids=["on import", "in a decision"])
def test_a_plugin_that_changes_the_folder_moves_no_file(
    home: Path, ego: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    elsewhere = home / "elsewhere"
    elsewhere.mkdir()
    monkeypatch.setenv("MOVES", str(elsewhere))
    sys.modules.pop("process_plugin", None)
    for words in (
        ("run", f"{ego}.yaml", "--output", "run", "--workers", "1"),
        ("replay", "run", "3", "--output", "replay.gif"),
        ("report", "run", "--top", "1"),
    ):
        answer = charms_bench(*words, cwd=home)
        assert answer.returncode == 0, answer.stderr
    assert not list(elsewhere.iterdir())
    assert (home / "run" / "tables" / "small.csv").exists()
    assert (home / "replay.gif").exists()
    assert (home / "report.html").exists()


def test_a_tie_that_the_size_of_the_batch_decides_is_replayed_as_in_the_run(home: Path) -> None:
    charms_bench("run", "torn.yaml", "--output", "run", "--workers", "1", cwd=home)
    found = charms_bench("edge-cases", "run", "--top", "30", "--json", cwd=home)
    assert found.returncode == 0, found.stderr
    assert len(json.loads(found.stdout)) == 30
    answers = [charms_bench("replay", "run", episode, cwd=home) for episode in (1, 3, 4)]
    assert [answer.returncode for answer in answers] == [0, 0, 0], answers
