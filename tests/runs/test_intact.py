"""What a plugin has replaced is told from what a thread is still importing."""

import sys
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor, wait
from importlib import import_module
from pathlib import Path
from threading import Event
from types import SimpleNamespace

import pytest

import charms_bench
from charms_bench.runs.intact import harness_names, problem_of

NAME = "charms_bench.slow"
SLOW = """\
import gates
value = None
gates.half.set()
assert gates.rest.wait(60)
value = 1
class Late:
    pass
"""


@pytest.fixture
def gates(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[SimpleNamespace]:
    """A module of the harness that waits in the middle of its import."""
    (tmp_path / "slow.py").write_text(SLOW)
    made = SimpleNamespace(half=Event(), rest=Event())
    monkeypatch.setattr(charms_bench, "__path__", [*charms_bench.__path__, str(tmp_path)])
    monkeypatch.setitem(sys.modules, "gates", made)
    yield made
    sys.modules.pop(NAME, None)
    vars(charms_bench).pop("slow", None)


def test_a_module_that_a_thread_is_still_importing_is_waited_for(gates: SimpleNamespace) -> None:
    with ThreadPoolExecutor(2) as threads:
        importing = threads.submit(import_module, NAME)
        assert gates.half.wait(60)
        found = threads.submit(harness_names)
        wait([found], timeout=1)  # it is still waiting, or it has seen half of the module
        gates.rest.set()
        module = importing.result()
    assert problem_of(found.result()) == ""
    module.value = 2
    assert problem_of(found.result()) == f"a plugin has replaced {NAME}.value of the harness"


def test_a_module_that_cannot_be_imported_is_nobodys_fault(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setitem(sys.modules, NAME, None)  # type: ignore[arg-type]  # as Python allows
    assert problem_of(harness_names()) == ""
