"""highway-env's other roads, seed for seed and bit for bit, beside highway-env itself.

All but one comparison are slow; `tests/golden` compares with what highway-env did when it was
recorded.
"""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from drawn_configurations import CHOSEN, LINEAR, random_configuration

from charms_bench.roads import TASKS
from charms_bench.testing.parity import Comparison, compare, differences, verify
from charms_bench.testing.road_parity import RoadCase

LINEAR_ROADS = (
    *("highway-fast-v0", "merge-v0", "merge-generic-v1", "two-way-v0", "exit-v0", "u-turn-v1"),
    *("roundabout-v0", "roundabout-generic-v1", "intersection-v0", "intersection-multi-agent-v2"),
)
"""One of each kind of road where `other_vehicles_type` counts."""
CONTROLS, STEPS = {"type": "ContinuousAction"}, {"type": "DiscreteAction"}
META, KINEMATICS = {"type": "DiscreteMetaAction"}, {"type": "Kinematics"}
Compared = Callable[..., Comparison]


def verified(name: str, episodes: int, **configuration: Any) -> Comparison:
    """The comparison of so many episodes with highway-env."""
    return verify([RoadCase(name, configuration)], range(episodes))[0]


def test_episodes_are_those_of_highway_env_to_the_last_bit(compared: Compared) -> None:
    found = compared("merge-v0", range(2))
    assert found.episodes == 2
    assert found.steps > 2
    assert found.differences == []
    assert found.largest == 0.0


@pytest.mark.slow
@pytest.mark.parametrize("name", CHOSEN)
def test_they_are_with_other_configurations_too(name: str, compared: Compared) -> None:
    for config in CHOSEN[name]:
        assert compared(name, range(100, 102), **config).differences == []


def of_agents(action: Any, observation: Any = KINEMATICS) -> dict[str, Any]:
    """The configuration in which egos have such actions and observations."""
    return {
        "action": {"type": "MultiAgentAction", "action_config": action},
        "observation": {"type": "MultiAgentObservation", "observation_config": observation},
    }


@pytest.mark.parametrize(
    ("name", "config"),
    [
        ("highway-fast-v0", {"controlled_vehicles": 3, "vehicles_count": 7, **of_agents(CONTROLS)}),
        ("u-turn-v1", {"action": CONTROLS, "observation": {**KINEMATICS, "order": "shuffled"}}),
    ],
)
def test_they_are_with_controls_several_egos_and_shuffled_rows(
    name: str, config: dict[str, Any], compared: Compared
) -> None:
    found = compared(name, range(1), **config)
    assert (found.differences, found.largest) == ([], 0.0)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "config"),
    [
        ("highway-v0", {"action": {**CONTROLS, "dynamical": True}, "vehicles_count": 15}),
        ("highway-fast-v0", {"controlled_vehicles": 3, "vehicles_count": 10}),
        ("exit-v0", {"controlled_vehicles": 2, **of_agents(META, {"type": "ExitObservation"})}),
        ("exit-v1", {"action": CONTROLS}),
        *((name, {"action": STEPS}) for name in ("merge-v1", "merge-generic-v1", "exit-v0")),
        *((name, {"action": STEPS}) for name in ("roundabout-v1", "roundabout-generic-v1")),
        ("intersection-v0", {"observation": {**KINEMATICS, "order": "shuffled"}}),
        ("exit-v1", {"observation": {"type": "ExitObservation", "order": "shuffled"}}),
    ],
)
def test_30_episodes_are_with_other_actions_egos_and_orders(
    name: str, config: dict[str, Any]
) -> None:
    assert verified(name, 30, **config).differences == []


@pytest.mark.slow
@pytest.mark.parametrize("kind", LINEAR)
def test_a_racetrack_has_idm_vehicles_whatever_their_type(
    kind: dict[str, Any], compared: Compared
) -> None:
    assert compared("racetrack-v0", range(1), **kind).differences == []


@pytest.mark.slow
@pytest.mark.parametrize("name", LINEAR_ROADS)
@pytest.mark.parametrize("kind", LINEAR)
def test_200_episodes_of_linear_vehicles_do(name: str, kind: dict[str, Any]) -> None:
    assert verified(name, 200, **kind).differences == []


@pytest.mark.slow
@pytest.mark.parametrize("name", TASKS)
def test_200_episodes_are_those_of_highway_env_to_the_last_bit(name: str) -> None:
    assert verified(name, 200).differences == []


@pytest.mark.slow
@pytest.mark.parametrize("name", [each for each in TASKS if each.endswith("v0")])
def test_100_random_configurations_give_the_same_episodes(name: str) -> None:
    for seed in range(100):
        config = random_configuration(name, seed)
        (found,) = verify([RoadCase(name, config)], range(seed, seed + 1), workers=1)
        assert found.differences == [], config


@pytest.mark.parametrize(
    ("ours", "theirs", "apart"),
    [
        (np.inf, np.inf, 0.0),
        (np.nan, np.nan, 0.0),
        (np.inf, np.nan, np.inf),
        (-np.inf, np.inf, np.inf),
    ],
)
def test_only_equal_numbers_without_a_value_do_not_differ(
    ours: float, theirs: float, apart: float
) -> None:
    assert differences([1.0, ours], [1.0, theirs]).tolist() == [0.0, apart]


@pytest.mark.slow
@pytest.mark.parametrize("name", TASKS)
def test_scenes_start_as_in_highway_env_with_its_own_mathematics(name: str) -> None:
    found = compare(RoadCase(name), range(20), steps=0, tolerance=1e-9)
    assert found.differences == []
    assert found.largest_at_start <= 1e-9
