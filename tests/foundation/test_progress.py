"""Messages beside the results."""

import pytest

from charms_bench.foundation.progress import ENGINE, note_compiling


def test_that_an_engine_compiles_is_said_once(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("charms_bench.foundation.progress.is_kept", lambda function: False)
    for _ in range(2):
        note_compiling(test_that_an_engine_compiles_is_said_once, ENGINE)
    said = capsys.readouterr()
    assert (said.out, said.err) == ("", "compiling the engine (once, about half a minute)\n")


def test_nothing_is_said_of_an_engine_that_is_compiled(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("charms_bench.foundation.progress.is_kept", lambda function: True)
    note_compiling(test_nothing_is_said_of_an_engine_that_is_compiled, ENGINE)
    assert capsys.readouterr().err == ""
