"""Scenarios: formulas, points in the space of parameters, placements."""

from typing import Any

import numpy as np
import pytest
from scipy.stats import truncnorm

from charms_bench.errors import ScenarioError
from charms_bench.foundation.formula import evaluate
from charms_bench.world.parameter_points import count_of, values_at
from charms_bench.world.placement import place
from charms_bench.world.scenario import Scenario
from charms_bench.world.scene import SceneSettings

SETTINGS = SceneSettings.model_validate({"profile": {"name": "charms", "speed_min_mps": 0.0}})


def scenario(**fields: Any) -> Scenario:
    """Two parameters, an ego in the middle lane and a leader at a gap."""
    leader = {"name": "leader", "lane": 1, "ahead_of": "ego", "gap_m": "gap", "speed_mps": "v - 2"}
    known: dict[str, Any] = {
        "parameters": {"gap": [10, 30], "v": [20, 30]},
        "ego": {"lane": 1, "speed_mps": "v"},
        "vehicles": [leader],
    }
    return Scenario.model_validate({**known, **fields})


def placed(changes: dict[str, Any], **fields: Any) -> Any:
    """The placement of a leader with these changes."""
    leader = {"name": "leader", "lane": 1, "ahead_of": "ego", "gap_m": 20, "speed_mps": 25}
    made = scenario(vehicles=[{**leader, **changes}], **fields)
    return place(made, SETTINGS, np.arange(4))


def test_a_formula_follows_the_rules_of_arithmetic() -> None:
    values = {"a": np.array([3.0]), "b": np.array([2.0])}
    assert evaluate("-(a + 4) * b / 7", values) == -2.0
    assert evaluate("a - b - 1", values) == 0.0
    assert evaluate(5, values) == 5.0


@pytest.mark.parametrize("text", ["a ** 2", "f(a)", "a.real", "a[0]", "'a'", "a if a else b", "a,",
                                  "__import__('os')", "True", "a +", "lambda: 1"])  # fmt: skip
def test_anything_else_is_not_a_formula(text: str) -> None:
    with pytest.raises(ValueError, match="is not a formula"):
        evaluate(text, {"a": np.zeros(1), "b": np.zeros(1)})


def test_a_grid_has_all_combinations_and_the_last_parameter_varies_fastest() -> None:
    parameters = {"gap": {"range": [10, 30], "steps": 3}, "v": {"range": [20, 30], "steps": 2}}
    grid = scenario(parameters=parameters, points="grid")
    assert count_of(grid) == 6
    found = values_at(grid, np.arange(6))
    assert found["gap"].tolist() == [10, 10, 20, 20, 30, 30]
    assert found["v"].tolist() == [20, 30, 20, 30, 20, 30]


def test_a_grid_may_have_more_points_than_an_integer_of_64_bits_counts() -> None:
    steps = {"range": [0, 9999], "steps": 10_000}
    grid = scenario(parameters={"gap": steps, "v": steps, **dict.fromkeys("abc", steps)})
    found = values_at(grid.model_copy(update={"points": "grid"}), np.array([123_456_789]))
    assert [found[name].tolist() for name in "abc"] == [[1], [2345], [6789]]


def test_a_seed_beyond_the_sobol_sequence_is_named() -> None:
    with pytest.raises(ScenarioError, match=r"has 1,073,741,824 points; episode 1073741824 needs"):
        place(scenario(), SETTINGS, np.array([2**30]))


def test_a_latin_hypercube_has_one_point_in_every_stratum() -> None:
    found = values_at(scenario(points={"latin_hypercube": 50}), np.arange(50))
    for name, (low, high) in {"gap": (10, 30), "v": (20, 30)}.items():
        strata = np.floor((found[name] - low) / (high - low) * 50).clip(0, 49)
        assert sorted(strata) == list(range(50))


def test_sobol_points_are_in_every_quarter_of_the_space() -> None:
    found = values_at(scenario(), np.arange(64))
    quarter = 2 * (found["gap"] > 20) + (found["v"] > 25)
    assert np.bincount(quarter.astype(int)).tolist() == [16] * 4


@pytest.mark.parametrize("points", ["sobol", "random", {"latin_hypercube": 40}])
def test_a_point_depends_on_its_number_alone(points: Any) -> None:
    whole = values_at(scenario(points=points), np.arange(40))
    part = values_at(scenario(points=points), np.array([17, 31]))
    for name in whole:
        np.testing.assert_array_equal(part[name], whole[name][[17, 31]])


def test_draws_of_a_normal_parameter_have_the_truncated_normal_distribution() -> None:
    gap = {"range": [10, 30], "normal": [15, 6]}
    drawn = values_at(scenario(parameters={"gap": gap, "v": [20, 30]}), np.arange(4096))["gap"]
    theory = truncnorm((10 - 15) / 6, (30 - 15) / 6, loc=15, scale=6)
    levels = [0.01, 0.1, 0.5, 0.9, 0.99]
    np.testing.assert_allclose(np.quantile(drawn, levels), theory.ppf(levels), atol=0.02)


def test_a_gap_is_measured_from_bumper_to_bumper() -> None:
    assert placed({})[0][0].tolist() == [100.0, 125.0]
    behind = {"ahead_of": None, "behind": "ego"}
    assert placed(behind)[0][0].tolist() == [100.0, 75.0]


@pytest.mark.parametrize(
    ("changes", "location", "what"),
    [
        ({"gap_m": -3}, "vehicles 0 gap_m", "overlaps 'ego': 2 m between their centres"),
        ({"lane": 3}, "vehicles 0 lane", "lane 3 is not on the road"),
        ({"lane": 0.5}, "vehicles 0 lane", "lane 0.5 is not on the road"),
        ({"ahead_of": "legder"}, "vehicles 0 ahead_of", "no vehicle named 'legder'"),
        ({"ahead_of": "leader"}, "vehicles 0 ahead_of", "no vehicle named 'leader' before"),
        ({"gap_m": 1e6}, "vehicles 0 gap_m", "off the road"),
        ({"speed_mps": -1}, "vehicles 0 speed_mps", "-1 is out of range; expected 0 to 33"),
        ({"speed_mps": "1 / (gap - gap)"}, "vehicles 0 speed_mps", "inf; expected a finite"),
        ({"speed_mps": "vv"}, "vehicles 0 speed_mps", "no parameter named 'vv'"),
        ({"actions": [{"at_s": -1, "acceleration_mps2": 1}]}, "vehicles 0 actions 0 at_s", "-1 is"),
        ({"actions": [{"at_s": 1, "lane": 7, "duration_s": 3}]}, "vehicles 0 actions 0 lane", "7"),
        (
            {"actions": [{"at_s": 1, "lane": 0, "duration_s": 3},
                         {"at_s": 2, "lane": 1, "duration_s": 3}]},
            "vehicles 0 actions 1 at_s",
            "2 s is before the movement before it has ended",
        ),
    ],
)  # fmt: skip
def test_an_impossible_placement_is_located(
    changes: dict[str, Any], location: str, what: str
) -> None:
    with pytest.raises(ScenarioError) as caught:
        placed(changes)
    assert " ".join(map(str, caught.value.location)) == location
    assert what in str(caught.value)


def test_the_message_names_the_point_that_cannot_be_placed() -> None:
    with pytest.raises(ScenarioError, match=r"at the point gap -\d.*, v 2\d"):
        place(scenario(parameters={"gap": [-20, 30], "v": [20, 30]}), SETTINGS,
              np.arange(50))  # fmt: skip


@pytest.mark.parametrize(
    ("points", "what"),
    [
        ([{"gap": 20, "v": 25}, {"gap": 200, "v": 25}], "200 is out of range; expected 10 to 30"),
        ([{"gap": 20}], "has gap; expected values of gap, v"),
        ([{"gap": 20, "v": 25}], "has 1 points; episode 3 needs 4"),
    ],
)
def test_a_wrong_point_is_rejected(points: Any, what: str) -> None:
    with pytest.raises(ScenarioError, match=what):
        place(scenario(points=points), SETTINGS, np.arange(4))


@pytest.mark.parametrize(
    "changes",
    [
        {"x_m": 150},
        {"gap_m": None},
        {"behind": "ego"},
        {"agent": "idm_mobil", "actions": [{"at_s": 1, "acceleration_mps2": -6}]},
        {"agent": "prescribed"},
        {"actions": [{"at_s": 1}]},
        {"actions": [{"at_s": 1, "lane": 0}]},
        {"actions": [{"at_s": 1, "lane": 0, "duration_s": 2, "acceleration_mps2": -6}]},
    ],
)
def test_a_vehicle_is_placed_once_and_driven_once(changes: dict[str, Any]) -> None:
    with pytest.raises(ValueError, match=r"expected|vehicles? without an agent"):
        placed(changes)
