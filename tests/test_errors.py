"""The texts of errors: one line, and the first reason."""

import pytest
from pydantic import ValidationError

from charms_bench.errors import TEXT_LIMIT, named, problem_in
from charms_bench.runs.suite import Suite


def test_the_text_of_a_plugins_exception_is_one_line() -> None:
    assert named(RuntimeError("no licence\n  for this")) == "RuntimeError: no licence for this"
    assert len(named(ValueError("x\n" * 5000))) < TEXT_LIMIT + 20
    assert named(StopIteration()) == "StopIteration"


@pytest.mark.parametrize(
    ("egos", "said"),
    [
        ([], "egos: expected at least 1, found []"),
        ([{"agent": "idm_mobil", "label": ""}], "at least 1 character, found ''"),
    ],
)
def test_a_wrong_entry_is_not_also_said_to_be_missing(egos: list[object], said: str) -> None:
    fields = {"suite": "s", "episodes": 1, "egos": egos, "traffic_models": [{"traffic": "pch"}]}
    with pytest.raises(ValidationError) as raised:
        Suite.model_validate(fields)
    found = problem_in(raised.value)
    assert said in found
    assert "after validation" not in found
    assert "also" not in found
