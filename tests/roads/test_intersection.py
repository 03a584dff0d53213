"""highway-env's intersection: other configurations, and what no other road has."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from charms_bench.roads.episodes import Episodes
from charms_bench.roads.scenes import IDM, NOTHING
from charms_bench.testing.parity import Comparison

SLOWER, IDLE = 0, 1


@pytest.mark.slow
def test_agents_may_have_discrete_accelerations_and_steering_angles(
    compared: Callable[..., Comparison],
) -> None:
    action = {"type": "DiscreteAction", "actions_per_axis": 3}
    config = {"action": {"type": "MultiAgentAction", "action_config": action}}
    assert compared("intersection-multi-agent-v2", range(1), **config).differences == []


def started(count: int, **config: Any) -> Episodes:
    episodes = Episodes("intersection-v0", count, config)
    episodes.seed(episodes.everyone, np.arange(count, dtype=np.uint64))
    episodes.start(episodes.everyone)
    return episodes


def present(episodes: Episodes) -> Any:
    """Whether there is a vehicle at each place (B, N)."""
    return episodes.scenes.vehicles["kind"] != NOTHING


def test_vehicles_enter_and_leave_while_the_ego_waits() -> None:
    episodes = started(20, duration=60)
    has_entered = has_left = False
    for _ in range(40):
        before = present(episodes)
        episodes.step(np.full(20, SLOWER))
        after = present(episodes)
        has_entered |= bool((after & ~before).any())
        has_left |= bool((before & ~after).any())
        order = episodes.scenes.order["place"]
        assert (np.sort(order, axis=1) == np.arange(order.shape[1])).all()
        in_order = np.take_along_axis(after, order, axis=1)
        assert (np.diff(in_order.astype(int), axis=1) <= 0).all()  # those with nothing are last
    assert has_entered
    assert has_left


def test_no_vehicle_enters_with_probability_0() -> None:
    episodes = started(20, spawn_probability=-1.0)
    for _ in range(12):
        before = present(episodes)
        episodes.step(np.full(20, IDLE))
        assert not (present(episodes) & ~before).any()


def test_only_idm_vehicles_yield_and_they_want_to_stand() -> None:
    episodes, count = started(50), 0
    for _ in range(10):
        episodes.step(np.full(50, IDLE))
        yielding = episodes.scenes.vehicles[episodes.scenes.vehicles["is_yielding"]]
        yielding = yielding[yielding["kind"] != NOTHING]
        count += yielding.size
        assert (yielding["kind"] == IDM).all()
        assert (yielding["target_speed"] == 0).all()
    assert count > 10


def test_the_scene_has_room_for_the_vehicles_of_a_long_episode() -> None:
    episodes = started(10, duration=300, spawn_probability=1.0)
    for _ in range(300):
        episodes.step(np.full(10, SLOWER))
    assert present(episodes).sum(axis=1).max() < episodes.scenes.vehicles.shape[1]
