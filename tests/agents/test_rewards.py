"""The paper's rewards, eqs. 4 to 8, by hand."""

import math

import numpy as np
import pytest
from charms_agents.training.rewards import (
    FAILURE,
    SVO_ANGLES_RAD,
    StyleReward,
    Svo,
    Weights,
    efficiency,
    others,
    safety,
)
from handmade_scene import place, simulation_of

from charms_bench.engine.endings import OFF_ROAD, REAR_END, SIDE, TIME
from charms_bench.engine.simulation import Simulation
from charms_bench.world.actions import FASTER, IDLE

SAFE = Weights(safety=1.0, efficiency=0.8, comfort=0.2)
IDLING = np.array([IDLE])


@pytest.mark.parametrize(
    ("gap_m", "leader_mps", "expected"),
    [
        (15.0, 20.0, 0.5),  # 15 m at 10 m/s: 1.5 s of 3 s
        (30.0, 20.0, 1.0),  # 3 s
        (45.0, 20.0, 1.0),  # 4.5 s
        (6.0, 30.0, 1.0),  # as fast as the ego: never
        (6.0, 33.0, 1.0),
    ],
)
def test_safety_is_the_time_to_collision_with_the_leader_over_three_seconds(
    gap_m: float, leader_mps: float, expected: float
) -> None:
    simulation = simulation_of((500.0, 1, 30.0), (500.0 + gap_m, 1, leader_mps))
    assert safety(simulation.scene) == pytest.approx(expected)


def test_a_lone_ego_is_safe_in_its_lane_and_between_lanes() -> None:
    assert safety(simulation_of((500.0, 1, 30.0)).scene) == 1.0
    assert safety(simulation_of((500.0, 1, 30.0), target_lane=0).scene) == 1.0


def test_a_follower_is_no_danger_while_the_ego_keeps_its_lane() -> None:
    assert safety(simulation_of((500.0, 1, 22.0), (494.0, 1, 33.0)).scene) == 1.0


def test_a_lane_change_is_as_safe_as_leader_and_follower_in_the_target_lane() -> None:
    leader, follower = (515.0, 0, 20.0), (497.75, 0, 33.0)  # 1.5 s and 0.75 s away
    own_leader = (503.0, 1, 22.0)
    simulation = simulation_of((500.0, 1, 30.0), leader, follower, own_leader, target_lane=0)
    assert safety(simulation.scene) == pytest.approx(0.5 * 0.5 + 0.5 * 0.25)


@pytest.mark.parametrize(
    ("speed_mps", "expected"), [(22.0, 0.0), (23.0, 0.0), (28.0, 0.5), (33.0, 1.0), (34.0, 1.0)]
)
def test_efficiency_is_the_speed_within_23_to_33_mps(speed_mps: float, expected: float) -> None:
    assert efficiency(simulation_of((500.0, 1, speed_mps)).scene) == pytest.approx(expected)


def test_only_the_speed_along_the_road_counts_as_efficient() -> None:
    scene = simulation_of((500.0, 1, 40.0)).scene
    scene.heading[0, 0] = math.acos(28.0 / 40.0)
    assert efficiency(scene) == pytest.approx(0.5)


def reward_of(simulation: Simulation, svo: Svo, weights: Weights = SAFE) -> float:
    """The reward of an ego that goes on as before, in a scene that does not change."""
    reward = StyleReward(weights, SVO_ANGLES_RAD[svo])
    return float(reward(simulation, reward.prepare(simulation, IDLING))[0])


def test_an_egoist_weighs_safety_efficiency_and_comfort() -> None:
    simulation = simulation_of((500.0, 1, 28.0), (509.0, 1, 22.0))  # 1.5 s; half the speed range
    simulation.action[0, 0], simulation.has_action[0, 0] = IDLE, True
    assert reward_of(simulation, "egoistic") == pytest.approx((0.5 + 0.8 * 0.5 + 0.2) / 2)
    simulation.action[0, 0] = FASTER
    assert reward_of(simulation, "egoistic") == pytest.approx((0.5 + 0.8 * 0.5) / 2)


def test_the_first_decision_is_not_comfortable() -> None:
    assert reward_of(simulation_of((500.0, 1, 33.0)), "egoistic") == pytest.approx(1.8 / 2)


@pytest.mark.parametrize("ending", [REAR_END, SIDE, OFF_ROAD])
@pytest.mark.parametrize("svo", SVO_ANGLES_RAD)
def test_a_crash_or_leaving_the_road_costs_ten(ending: int, svo: Svo) -> None:
    simulation = simulation_of((500.0, 1, 33.0))
    simulation.ending[0] = ending
    assert reward_of(simulation, svo) == FAILURE == -10.0


def test_the_end_of_the_time_is_no_failure() -> None:
    simulation = simulation_of((500.0, 1, 33.0))
    simulation.ending[0] = TIME
    assert reward_of(simulation, "egoistic") > 0


def gain(
    before: Simulation, *vehicles: tuple[float, int, float], target_lane: int | None = None
) -> float:
    """r_o of a decision that leads from one scene to another."""
    prepared = StyleReward(SAFE, SVO_ANGLES_RAD["prosocial"]).prepare(before, IDLING)
    place(before.scene, *vehicles, target_lane=target_lane)
    return float(others(before.scene, prepared.affected, 3.0)[0])


# At 33 m/s nobody accelerates freely, and the desired gap to an equally fast leader is
# 10 m + 33 m = 43 m: expected is -3 (43 / gap)^2, which is -0.75 at 86 m and -3 at 43 m.


def test_the_follower_gains_what_it_need_no_longer_brake() -> None:
    before = simulation_of((586.0, 1, 33.0), (500.0, 1, 33.0))
    assert gain(before, (672.0, 1, 33.0), (500.0, 1, 33.0)) == pytest.approx(0.75 - 3 / 16)


def test_a_lane_change_frees_the_one_behind_and_slows_the_one_in_the_target_lane() -> None:
    vehicles = (586.0, 1, 33.0), (500.0, 1, 33.0), (500.0, 0, 33.0)
    change = gain(simulation_of(*vehicles), *vehicles, target_lane=0)
    assert change == pytest.approx(0.75 - 0.75)
    nearer = (543.0, 1, 33.0), (457.0, 1, 33.0), (500.0, 0, 33.0)
    assert gain(simulation_of(*nearer), *nearer, target_lane=0) == pytest.approx(0.75 - 3.0)


def test_whoever_is_freed_follows_the_next_ahead() -> None:
    vehicles = (543.0, 1, 33.0), (500.0, 1, 33.0), (586.0, 1, 33.0)
    expected = 3.0 - 0.75  # 43 m behind the ego, then 86 m behind the next
    assert gain(simulation_of(*vehicles), *vehicles, target_lane=0) == pytest.approx(expected)


def test_a_lane_change_counts_once_when_it_is_decided() -> None:
    vehicles = (543.0, 1, 33.0), (457.0, 1, 33.0), (500.0, 0, 33.0)
    under_way = simulation_of(*vehicles, target_lane=0)
    assert gain(under_way, *vehicles, target_lane=0) == 0.0


def test_one_vehicle_gains_three_at_most() -> None:
    vehicles = (520.0, 1, 33.0), (500.0, 1, 33.0)  # -3 (43 / 20)^2 = -13.9
    assert gain(simulation_of(*vehicles), *vehicles, target_lane=0) == 3.0


def test_closing_in_widens_the_desired_gap() -> None:
    # 33 m/s behind 31 m/s: 10 + 33 + 33 * 2 / (2 sqrt(15)) = 51.52 m.
    before = simulation_of((586.0, 1, 33.0), (500.0, 1, 33.0))
    expected = 0.75 - 3 * (51.5204 / 86) ** 2
    after = gain(before, (586.0, 1, 31.0), (500.0, 1, 33.0))
    assert after == pytest.approx(expected, abs=1e-4)


def test_nobody_behind_nobody_gains() -> None:
    vehicles = ((500.0, 1, 30.0), (540.0, 1, 30.0))
    assert gain(simulation_of(*vehicles), *vehicles, target_lane=2) == 0.0


@pytest.mark.parametrize(
    ("svo", "own", "for_others"),
    [
        ("competitive", math.sqrt(0.5), -math.sqrt(0.5)),
        ("egoistic", 1.0, 0.0),
        ("prosocial", math.sqrt(0.5), math.sqrt(0.5)),
        ("altruistic", 0.0, 1.0),
    ],
)
def test_the_orientation_weighs_own_reward_against_that_of_others(
    svo: Svo, own: float, for_others: float
) -> None:
    simulation = simulation_of((586.0, 1, 33.0), (500.0, 1, 33.0))
    simulation.action[0, 0], simulation.has_action[0, 0] = IDLE, True
    reward = StyleReward(SAFE, SVO_ANGLES_RAD[svo])
    prepared = reward.prepare(simulation, IDLING)
    simulation.scene.target_lane[0, 0] = 0  # frees the one behind: 0.75
    found = float(reward(simulation, prepared)[0])
    assert found == pytest.approx(own * 2.0 / 2 + for_others * (0.75 + 6) / 12)
