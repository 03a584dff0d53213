"""highway-env's other roads, seed for seed and bit for bit."""

from typing import Any

import pytest

from charms_bench.roads import TASKS
from charms_bench.testing.road_parity import compare, verify_road

CONFIGURATIONS: dict[str, dict[str, Any]] = {
    "merge-generic-v0": {"lanes_count": 3, "vehicles_count": 8, "converge_merge_length": 60},
    "exit-v0": {"lanes_count": 4, "vehicles_count": 12, "vehicles_density": 1.2},
    "u-turn-v1": {"normalize_reward": False, "policy_frequency": 3, "duration": 5},
    "roundabout-generic-v1": {"roundabout_radius": 30, "roundabout_lanes": 3, "vehicles_count": 9},
    "two-way-v0": {"observation": {"type": "Kinematics", "see_behind": True, "clip": False}},
    "roundabout-v0": {"action": {"type": "DiscreteMetaAction", "lateral": False}},
}


@pytest.mark.parametrize("name", TASKS)
def test_episodes_are_those_of_highway_env_to_the_last_bit(name: str) -> None:
    found = verify_road(name, 4, workers=1)
    assert found.episodes == 4
    assert found.decisions > 4
    assert found.differing == []
    assert found.largest == 0.0


@pytest.mark.parametrize("name", CONFIGURATIONS)
def test_they_are_with_other_configurations_too(name: str) -> None:
    found = verify_road(name, 4, seed=100, workers=1, config=CONFIGURATIONS[name])
    assert found.differing == []


@pytest.mark.slow
@pytest.mark.parametrize("name", TASKS)
def test_200_episodes_are_those_of_highway_env_to_the_last_bit(name: str) -> None:
    assert verify_road(name, 200).differing == []


@pytest.mark.parametrize("name", TASKS)
def test_scenes_start_as_in_highway_env_with_its_own_mathematics(name: str) -> None:
    found = compare(name, range(20), decisions=0, tolerance=1e-9)
    assert found.differing == []
    assert found.largest_at_start <= 1e-9
