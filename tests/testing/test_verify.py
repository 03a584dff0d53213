"""Verification finds what differs, and names the first of it."""

import re
from pathlib import Path

import numpy as np
import pytest

from charms_bench.engine import batched
from charms_bench.errors import InputError
from charms_bench.plugins.specs import AgentSpec, TrafficSpec
from charms_bench.testing.map_parity import MapCase
from charms_bench.testing.parity import Comparison, compare, verify
from charms_bench.testing.road_parity import RoadCase
from charms_bench.testing.straight_parity import StraightCase, random_controls
from charms_bench.testing.verify import case_on, default_cases
from charms_bench.world.placement import place
from charms_bench.world.scene import Bools, Scene, SceneSettings

CASE = StraightCase(
    scene=SceneSettings(duration_s=3.0, traffic_vehicles=6),
    ego=AgentSpec(name="idm_mobil"),
    traffic=TrafficSpec(name="idm_mobil"),
)


def test_equal_engines_have_no_difference() -> None:
    comparison = compare(CASE, range(3, 5), tolerance=1e-6)
    assert comparison.differences == []
    assert (comparison.episodes, comparison.steps) == (2, 2 * 45)
    assert comparison.largest < 1e-9


def test_the_first_step_vehicle_and_quantity_that_differ_are_named(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    advance, calls = batched.advance, []

    def gusty(scene: Scene, modelled: Bools, zero_order_hold: Bools) -> None:
        advance(scene, modelled, zero_order_hold)
        calls.append(1)
        if len(calls) == 7:
            scene.y[0, 4] += 1e-5  # a gust in the seventh step

    monkeypatch.setattr(batched, "advance", gusty)
    (difference,) = compare(CASE, range(3, 5), tolerance=1e-6).differences
    assert difference.startswith("episode 3, simulation step 7: y[4]: ")
    ours, stock = map(float, re.findall(r"float64\((.+?)\)", difference))
    assert ours - stock == pytest.approx(1e-5)


def test_the_engines_agree_to_the_last_bit(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("OPENBLAS_CORETYPE", "")  # what is set for the worker ends with this test
    crowded = default_cases()[0][5]  # a dot product rounded once shows in this one's episode 33
    (comparison,) = verify([crowded], range(33, 34), workers=1)
    assert (comparison.steps, comparison.largest) == (305, 0.0)


def test_comparisons_add_up_over_episodes() -> None:
    both = compare(CASE, range(3, 5), tolerance=1e-6)
    first, second = (compare(CASE, range(seed, seed + 1), tolerance=1e-6) for seed in (3, 4))
    total = first + second
    assert (total.episodes, total.steps, total.crashed) == (2, both.steps, both.crashed)


def test_a_sum_of_comparisons_has_the_largest_difference_of_both() -> None:
    one = Comparison("case", episodes=1, steps=10, largest=0.2, largest_at_start=0.0)
    other = Comparison("case", episodes=2, steps=5, largest=0.1, largest_at_start=0.3)
    both = one + other
    assert (both.episodes, both.steps) == (3, 15)
    assert (both.largest, both.largest_at_start) == (0.2, 0.3)


def test_a_road_is_a_name_or_a_file() -> None:
    town = Path(__file__).parents[2] / "suites" / "places" / "town.json"
    assert case_on("merge-v0") == RoadCase("merge-v0")
    assert case_on(str(town)) == MapCase(town)
    with pytest.raises(InputError, match="no file and no environment named 'merge-v9'"):
        case_on("merge-v9")


def test_random_accelerations_and_steering_angles_drive_the_egos() -> None:
    case = default_cases(continuous=True)[0][4]
    case = case.model_copy(update={"scene": case.scene.model_copy(update={"duration_s": 2.0})})
    assert case.title.startswith("continuous actions, highway-env")
    comparison = compare(case, range(4), tolerance=1e-6)
    assert comparison.differences == []
    assert comparison.largest < 1e-9


def test_random_controls_steer_little_in_some_episodes_and_much_in_others() -> None:
    means = np.array([random_controls(seed, 50).mean(axis=0) for seed in range(300)])
    assert np.abs(means[:, 1]).min() < 0.001
    assert np.abs(means[:, 1]).max() > 0.5
    assert np.percentile(means[:, 0], [5, 95]) == pytest.approx([-0.8, 0.8], abs=0.2)


def test_500_episodes_are_compared_with_continuous_actions() -> None:
    cases, episodes = default_cases(continuous=True)
    assert len(cases) * episodes >= 500


@pytest.mark.slow
@pytest.mark.parametrize("which", range(-5, 0))
def test_the_engines_agree_with_vehicles_and_lanes_of_other_sizes(which: int) -> None:
    case = default_cases()[0][which]
    (comparison,) = verify([case], range(2), workers=1)
    assert (comparison.differences, comparison.largest) == ([], 0.0)


@pytest.mark.parametrize("which", [-2, -1])
def test_vehicles_of_the_default_cases_pass_the_ends_of_the_road(which: int) -> None:
    case = default_cases()[0][which]
    assert case.scene.scenario is not None
    placed = place(case.scene.scenario, case.scene, np.arange(25))
    end, duration_s = case.scene.road.road_length, case.scene.duration_s
    if which == -2:
        assert ((placed.x[:, 0] < 0) & (placed.x[:, 0] > -5)).all()
    else:
        assert (placed.x[:, 0] + placed.speed[:, 0] * duration_s > end + 5).mean() > 0.5


def test_the_default_cases_cover_what_they_promise() -> None:
    cases, episodes = default_cases()
    assert len(cases) * episodes >= 1000
    profiles = {(case.scene.profile.name, case.scene.profile.ego_control_rate) for case in cases}
    assert profiles == {
        ("charms", "decision"),
        ("charms", "simulation"),
        ("highway-env", "simulation"),
        ("naturalistic", "simulation"),
    }
    assert {case.scene.lanes for case in cases} == {2, 3, 4, 5}
    sizes = [case.scene.vehicles for case in cases]
    assert (min(sizes), max(sizes)) == (6, 60)
    assert np.ptp([case.scene.density for case in cases]) > 2
