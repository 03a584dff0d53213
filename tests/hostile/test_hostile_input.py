"""Bad input: exit code 2, one message, no traceback, and no effect."""

import json
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

import pytest

pytest.importorskip("torch", reason="needs the extra 'train'")
pytest.importorskip("onnx", reason="needs the extra 'train'")

import bad_arguments
import bad_checkpoints
import bad_networks
import bad_recordings
import bad_run_folders
import bad_suites
from bad_input import CANARY, BadInput
from bad_suites import BASE
from command_line import charms_bench
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

ALL: tuple[BadInput, ...] = (
    *bad_arguments.CASES,
    *bad_suites.CASES,
    *bad_networks.CASES,
    *bad_checkpoints.CASES,
    *bad_recordings.CASES,
    *bad_run_folders.CASES,
)
NASTIEST: dict[str, str] = json.loads((Path(__file__).parent / "messages.json").read_bytes())[
    "inputs"
]
"""The whole message with which the nastiest inputs are rejected, by title."""
LONGEST = 1100
SLOW = {"network: a product of hours when it is computed"}


def rejects(case: BadInput, folder: Path) -> str:
    """Runs a case, checks that it was rejected, and returns the message."""
    arguments = case.make(folder)
    answer = charms_bench(*arguments, cwd=folder)
    assert answer.returncode == 2, answer
    words = answer.stderr.strip()
    assert words.startswith(("error: ", "Error: ", "Usage: ", "╭─ Error")) or "\nerror: " in words
    assert "Traceback" not in words
    assert all(letter.isprintable() or letter in "\n\t" for letter in words)
    assert len(words) < LONGEST
    assert answer.stdout == ""
    assert not (folder / CANARY).exists()
    assert not (folder / "out.onnx").exists()
    return words


@pytest.mark.parametrize(
    "case",
    [pytest.param(each, marks=[pytest.mark.slow] * (each.title in SLOW)) for each in ALL],
    ids=lambda each: each.title.encode("ascii", "backslashreplace").decode(),
)
def test_bad_input_is_rejected_in_words(case: BadInput, tmp_path: Path) -> None:
    words = rejects(case, tmp_path).replace(f"{tmp_path}/", "")
    assert words == NASTIEST.get(case.title, words)
    assert case.said in " ".join(words.split())


def test_every_reader_gets_bad_input() -> None:
    entered = {case.title.partition(":")[0] for case in ALL}
    assert entered >= {"suite", "network", "checkpoint", "recordings", "rescore", "replay"}
    assert {case.title for case in ALL} >= {*NASTIEST, *BOMBS, *SLOW}


@settings(
    derandomize=True,
    deadline=None,
    max_examples=60,
    suppress_health_check=[HealthCheck.function_scoped_fixture],
)
@given(
    line=st.integers(0, len(BASE.splitlines()) - 1),
    junk=st.recursive(
        st.text("ab:-[]{}&*!%@#'\"\n\t 019.,|>?~\x00é\x1b", min_size=1, max_size=8),
        lambda inner: st.lists(inner, max_size=3).map(lambda parts: f"[{', '.join(parts)}]"),
    ),
)
def test_a_suite_with_junk_for_a_key_is_rejected(tmp_path: Path, line: int, junk: str) -> None:
    lines = BASE.splitlines()
    lines.insert(line, f"{junk}: {junk}")
    (tmp_path / "suite.yaml").write_text("\n".join(lines), newline="")
    if "#" not in junk:  # what follows it may be a comment
        rejects(BadInput("junk", lambda folder: ("run", "suite.yaml")), tmp_path)


LIMITED = """\
import resource, sys
resource.setrlimit(resource.RLIMIT_AS, (6 * 2**30, 6 * 2**30))
from charms_bench.cli import main
main()
"""
BOMBS = (
    "suite: a billion laughs", "suite: deep lists", "suite: base 60 without end",
    "a link to /dev/zero as a suite", "a file of a terabyte as a network",
    "network: zeros of 64 GiB", "network: a product of 80 GB", "network: a sparse tensor of 32 GiB",
    "checkpoint: a bomb in a bomb", "checkpoint: a bytearray of 32 GB",
    "recordings: 3,000,000 markings", "recordings: a terabyte",
)  # fmt: skip
NAMED = {case.title: case for case in ALL}


@pytest.mark.slow
@pytest.mark.parametrize("title", BOMBS)
def test_no_bomb_takes_memory(title: str, tmp_path: Path) -> None:
    arguments: Sequence[object] = NAMED[title].make(tmp_path)
    done = subprocess.run(
        [sys.executable, "-c", LIMITED, *map(str, arguments)],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 2, done.stderr
    assert "Traceback" not in done.stderr
    assert "MemoryError" not in done.stderr
