"""The completed reward, by hand: its parts, and what stands beside the paper's."""

import math
from pathlib import Path

import naive
import numpy as np
import pytest
from charms_agents.training.completed_reward import CompletedReward, RewardScales, safety
from charms_agents.training.rewards import SVO_ANGLES_RAD, StyleReward, Svo, Weights
from handmade_scene import place, simulation_of
from hypothesis import given, settings
from hypothesis import strategies as st
from scenes import scenes

from charms_bench.engine.endings import OFF_ROAD, REAR_END, SIDE, TIME
from charms_bench.engine.simulation import Simulation
from charms_bench.world.actions import IDLE
from charms_bench.world.scene import Scene, SceneSettings

IDLING = np.array([IDLE])
SAFETY, EFFICIENCY, COMFORT = (
    Weights(safety=float(a), efficiency=float(b), comfort=float(c)) for a, b, c in np.eye(3)
)
SAFE = Weights(safety=1.0, efficiency=0.8, comfort=0.2)
HZ = SceneSettings().decision_hz


def reward_of(
    simulation: Simulation,
    weights: Weights,
    angle_rad: float = 0.0,
    scales: RewardScales | None = None,
) -> float:
    """The reward of a decision in which nothing changes."""
    reward = CompletedReward(weights, angle_rad, scales or RewardScales())
    return float(reward(simulation, reward.prepare(simulation, IDLING))[0])


@pytest.mark.parametrize(
    ("ahead_m", "leader_mps", "expected"),
    [
        # 20 m between bumpers, which close at 5 + 5 m/s: 2 s of 4 s.
        (25.0, 25.0, 0.5),
        (15.0, 30.0, 0.5),  # at equal speeds, 10 m at 5 m/s
        (25.0, 30.0, 1.0),  # 20 m at 5 m/s
        (65.0, 30.0, 1.0),
        (7.0, 34.0, 0.5),  # 2 m, and the leader is 4 m/s faster: 2 m at 1 m/s
        (6.0, 35.0, 1.0),  # never, if it loses 5 m/s
        (4.0, 36.0, 0.0),  # overlaps
        (4.0, 25.0, 0.0),
    ],
)
def test_safety_is_the_time_to_collision_with_a_leader_that_loses_speed(
    ahead_m: float, leader_mps: float, expected: float
) -> None:
    simulation = simulation_of((500.0, 1, 30.0), (500.0 + ahead_m, 1, leader_mps))
    assert safety(simulation.scene, RewardScales()) == pytest.approx(expected)
    assert reward_of(simulation, SAFETY) == pytest.approx(expected)


@pytest.mark.parametrize(
    ("left_leader", "expected"),
    [
        ((600.0, 1, 30.0), 0.5 * 0.5 + 0.5 * 0.25),
        ((510.0, 1, 27.5), 2 / 3 / 4),  # 5 m at 7.5 m/s: 2/3 s
    ],
)
def test_a_lane_change_is_at_most_as_safe_as_the_lane_that_the_ego_leaves(
    left_leader: tuple[float, int, float], expected: float
) -> None:
    leader = (525.0, 0, 25.0)  # 20 m at 5 + 5 m/s: 2 s
    follower = (485.0, 0, 35.0)  # 10 m at 5 + 5 m/s: 1 s
    simulation = simulation_of((500.0, 1, 30.0), leader, follower, left_leader, target_lane=0)
    assert safety(simulation.scene, RewardScales()) == pytest.approx(expected)


@settings(derandomize=True, deadline=None)
@given(scene=scenes(), loses=st.sampled_from([0.0, 5.0, 12.0]), horizon=st.floats(0.5, 20.0))
def test_safety_is_that_of_the_plain_version(scene: Scene, loses: float, horizon: float) -> None:
    scales = RewardScales(leader_loses_mps=loses, safety_horizon_s=horizon)
    expected = naive.completed_safety(scene, 0, horizon, loses)
    assert safety(scene, scales)[0] == pytest.approx(expected, abs=1e-9)


@pytest.mark.parametrize(
    ("speed_mps", "expected"), [(20.0, 0.0), (22.0, 0.0), (26.0, 0.5), (30.0, 1.0), (32.0, 0.75)]
)
def test_efficiency_is_1_at_the_desired_speed_and_falls_on_both_sides(
    speed_mps: float, expected: float
) -> None:
    assert reward_of(simulation_of((500.0, 1, speed_mps)), EFFICIENCY) == pytest.approx(expected)


@pytest.mark.parametrize(("speed_mps", "expected"), [(8.0, 0.0), (10.0, 0.0), (20.0, 0.5)])
def test_efficiency_is_0_at_a_slow_speed_that_can_be_given(
    speed_mps: float, expected: float
) -> None:
    scales = RewardScales(slow_speed_mps=10.0)
    simulation = simulation_of((500.0, 1, speed_mps))
    assert reward_of(simulation, EFFICIENCY, scales=scales) == pytest.approx(expected)


@pytest.mark.parametrize(
    ("ahead_m", "expected"),
    [(16.0, -5.0), (11.0, -10.0 * (1 - 6 / 7 / 2)), (5.0 + 14.0, -10.0 * 0.0), (40.0, 0.0)],
)
def test_a_conflict_can_be_a_cost_that_grows_as_the_time_to_collision_falls(
    ahead_m: float, expected: float
) -> None:
    closing = 11.0 if ahead_m == 16.0 else 7.0  # 11 m at 11 m/s: 1 s
    simulation = simulation_of((500.0, 1, 30.0), (500.0 + ahead_m, 1, 30.0 - closing))
    plain, costly = RewardScales(), RewardScales(conflict_cost=10.0)
    found = [reward_of(simulation, SAFE, scales=each) for each in (plain, costly)]
    assert found[1] - found[0] == pytest.approx(expected)


def comfort(gained_mps: float, acceleration: float, target_lane: int | None = None) -> float:
    """r_c of a decision from 28 m/s that gains speed, begun without an acceleration."""
    simulation = simulation_of((500.0, 1, 28.0))
    simulation.scene.acceleration[0, 0] = 0.0
    reward = CompletedReward(COMFORT, 0.0, RewardScales())
    prepared = reward.prepare(simulation, IDLING)
    place(simulation.scene, (509.0, 1, 28.0 + gained_mps), target_lane=target_lane)
    simulation.scene.acceleration[0, 0] = acceleration
    return float(reward(simulation, prepared)[0])


@pytest.mark.parametrize(
    ("mean_mps2", "last_mps2", "expected"),
    [
        (0.0, 0.0, 1.0),
        (0.6, 0.0, 1.0 - 1.0),
        (-0.6, 0.0, 1.0 - 1.0),
        (1.2, 0.0, 1.0 - 4.0),
        (0.0, 1.0, 1.0 - 1.0),  # 1 m/s2 within 1/3 s are 3 m/s3
        (0.6, -1.0, 1.0 - 1.0 - 1.0),
        (6.0, 6.0, 1.0 - 30.0),  # 100 + 36, of which 30 count
    ],
)
def test_comfort_falls_with_the_squares_of_acceleration_and_jerk(
    mean_mps2: float, last_mps2: float, expected: float
) -> None:
    assert comfort(mean_mps2 / HZ, last_mps2) == pytest.approx(expected)


def test_a_lane_change_takes_60_off_comfort_when_it_begins() -> None:
    assert comfort(0.0, 0.0, target_lane=0) == pytest.approx(1.0 - 60.0)
    assert reward_of(simulation_of((500.0, 1, 28.0), target_lane=0), COMFORT) == 1.0


@pytest.mark.parametrize("ending", [REAR_END, SIDE, OFF_ROAD])
@pytest.mark.parametrize("svo", SVO_ANGLES_RAD)
def test_a_failure_is_a_cost_of_the_ego_weighed_by_cos_phi(ending: int, svo: Svo) -> None:
    # The follower gains by the lane change, which does not count when it fails.
    simulation = simulation_of((586.0, 1, 33.0), (500.0, 1, 33.0))
    reward = CompletedReward(SAFE, SVO_ANGLES_RAD[svo], RewardScales())
    prepared = reward.prepare(simulation, IDLING)
    simulation.scene.target_lane[0, 0] = 0
    simulation.ending[0] = ending
    weight = {"competitive": math.sqrt(0.5), "egoistic": 1, "prosocial": math.sqrt(0.5)}.get(svo, 0)
    assert float(reward(simulation, prepared)[0]) == pytest.approx(-60.0 * weight)


def test_the_end_of_the_time_costs_nothing() -> None:
    simulation = simulation_of((500.0, 1, 30.0))
    simulation.ending[0] = TIME
    assert reward_of(simulation, SAFE) == 1.0


@pytest.mark.parametrize(
    ("svo", "own_weight"),
    [
        ("competitive", math.sqrt(0.5)),
        ("egoistic", 1.0),
        ("prosocial", math.sqrt(0.5)),
        ("altruistic", 0.0),
    ],
)
def test_others_add_nothing_where_nobody_is_affected(svo: Svo, own_weight: float) -> None:
    lone = simulation_of((500.0, 1, 26.0))
    own = (1.0 + 0.8 * 0.5 + 0.2) / 2
    assert reward_of(lone, SAFE, SVO_ANGLES_RAD[svo]) == pytest.approx(own_weight * own)
    followed = simulation_of((586.0, 1, 26.0), (500.0, 1, 26.0))  # by one that nothing changes for
    assert reward_of(followed, SAFE, SVO_ANGLES_RAD[svo]) == pytest.approx(own_weight * own)


@pytest.mark.parametrize(
    ("gap_m", "gain_mps2"),
    [(86.0, 0.75), (20.0, 3.0)],  # at 33 m/s, IDM expects -3 (43 / gap)^2, and 3 counts at most
)
@pytest.mark.parametrize("svo", ["competitive", "prosocial"])
def test_what_a_follower_gains_counts_as_a_fraction_of_6_mps2(
    svo: Svo, gap_m: float, gain_mps2: float
) -> None:
    simulation = simulation_of((500.0 + gap_m, 1, 33.0), (500.0, 1, 33.0))
    reward = CompletedReward(SAFETY, SVO_ANGLES_RAD[svo], RewardScales())
    prepared = reward.prepare(simulation, IDLING)
    place(simulation.scene, (500.0 + gap_m, 1, 33.0), (500.0, 1, 33.0), target_lane=0)
    # Now the follower is free.
    others = math.copysign(math.sqrt(0.5), SVO_ANGLES_RAD[svo]) * gain_mps2 / 6
    expected = math.sqrt(0.5) * 1.0 + others
    assert float(reward(simulation, prepared)[0]) == pytest.approx(expected)


@pytest.mark.parametrize(
    ("follower_lane", "change_mps2"),
    [(1, 0.0), (0, -0.75)],  # the one behind is freed, or one on the target lane expects to brake
)
def test_where_gains_do_not_count_only_what_followers_lose_does(
    follower_lane: int, change_mps2: float
) -> None:
    vehicles = (586.0, 1, 33.0), (500.0, follower_lane, 33.0)
    simulation = simulation_of(*vehicles)
    scales = RewardScales(others_gain_mps2=0.0, others_acceleration_mps2=0.5)
    reward = CompletedReward(SAFETY, SVO_ANGLES_RAD["prosocial"], scales)
    prepared = reward.prepare(simulation, IDLING)
    place(simulation.scene, *vehicles, target_lane=0)
    safe = safety(simulation.scene, scales)[0]
    expected = math.sqrt(0.5) * (safe + change_mps2 / 0.5)
    assert float(reward(simulation, prepared)[0]) == pytest.approx(expected)


def examples() -> dict[str, tuple[float, float]]:
    """The values of the examples of `docs/reward.md`, by both rewards."""

    def both(
        simulation: Simulation, weights: Weights, degrees: float = 0.0, gained_mps: float = 0.0
    ) -> tuple[float, float]:
        angle, found = math.radians(degrees), []
        simulation.scene.acceleration[0, 0] = 0.0
        simulation.action[0, 0], simulation.has_action[0, 0] = IDLE, True
        scales = RewardScales()
        for reward in (StyleReward(weights, angle), CompletedReward(weights, angle, scales)):
            before = reward.prepare(simulation, IDLING)
            simulation.scene.speed[0, 0] += gained_mps
            found.append(float(reward(simulation, before)[0]))
            simulation.scene.speed[0, 0] -= gained_mps
        return found[0], found[1]

    def failure(degrees: float) -> tuple[float, float]:
        simulation = simulation_of((500.0, 1, 30.0))
        simulation.ending[0] = REAR_END
        paper, completed = both(simulation, SAFE, degrees)
        weight = math.cos(math.radians(degrees))
        return paper / weight, completed / weight

    leaving = simulation_of((500.0, 1, 30.0), (510.0, 1, 27.5), target_lane=0)
    lone = simulation_of((500.0, 1, 30.0))
    return {
        "$r_s$, 10 m behind an equally fast leader": both(
            simulation_of((500.0, 1, 30.0), (515.0, 1, 30.0)), SAFETY
        ),
        "$r_s$, leaving a lane 5 m behind a leader at 27.5 m/s": both(leaving, SAFETY),
        "$r_e$ at 32 m/s": both(simulation_of((500.0, 1, 32.0)), EFFICIENCY),
        "$r_c$, same action, 1.2 m/s²": both(lone, COMFORT, gained_mps=1.2 / HZ),
        "$r_o$, no vehicle affected": both(lone, SAFETY, 90.0),
        "failure / $\\cos\\varphi$, egoistic": failure(0.0),
        "failure / $\\cos\\varphi$, prosocial": failure(45.0),
        "failure / $\\cos\\varphi$, altruistic at 67.5°": failure(67.5),
    }


def test_the_page_has_the_values_of_its_examples() -> None:
    page = (Path(__file__).parents[2] / "docs" / "reward.md").read_text(encoding="utf-8")
    for name, values in examples().items():
        (line,) = (line for line in page.splitlines() if line.startswith(f"| {name} |"))
        said = [cell.strip() for cell in line.split("|")[2:4]]
        for text, value in zip(said, values, strict=True):
            decimals = len(text.partition(".")[2])
            assert value == pytest.approx(float(text), abs=0.5 * 10**-decimals), name


def test_the_page_has_the_defaults_of_all_scales() -> None:
    page = (Path(__file__).parents[2] / "docs" / "reward.md").read_text(encoding="utf-8")
    for name, value in RewardScales().model_dump(exclude_none=True).items():
        assert f"`{name}` ({value:g}" in page
