"""The texts of errors: one line, and the first reason."""

import pytest
from pydantic import ValidationError

from charms_bench.errors import TEXT_LIMIT, named, problem_in
from charms_bench.runs.suite import Suite
from charms_bench.world.vehicle_types import VehicleType


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


@pytest.mark.parametrize(
    ("field", "value", "said"),
    [
        ("length_m", 0.99, "length_m: Input should be greater than or equal to 1, found 0.99"),
        ("length_m", "a", "length_m: Input should be a valid number or a valid mapping, found 'a'"),
        ("length_m", {"rage": 1}, "length_m.rage: unknown key. Did you mean 'range'? Known: "),
        ("desired_speed_mps", [3, 1], "desired_speed_mps: 3 exceeds 1, found [3, 1]"),
        ("driver_parameters", {"": [1, 2]}, "driver_parameters.: String should have at least 1"),
        ("driver_parameters", {"T": [2, 1]}, "driver_parameters.T: 2 exceeds 1, found [2, 1]"),
    ],
)
def test_of_several_possible_types_the_message_names_what_fits(
    field: str, value: object, said: str
) -> None:
    with pytest.raises(ValidationError) as raised:
        VehicleType.model_validate({"name": "car", "share": 1.0, field: value})
    found = problem_in(raised.value)
    assert found.startswith(said)
    assert "also" not in found
