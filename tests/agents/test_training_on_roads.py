"""Training suites with roads: their conditions, the goal in the reward, and how they continue."""

from pathlib import Path

import numpy as np
import pytest
from charms_agents.human.samples import Samples
from charms_agents.human.simulated import simulated_samples
from charms_agents.training.completed_reward import CompletedReward, RewardScales
from charms_agents.training.reinforcement import Reinforcement
from charms_agents.training.rewards import Weights
from charms_agents.training.settings import TrainingSuite
from charms_agents.training.suite_file import load_training
from handmade_scene import simulation_of

from charms_bench.engine.endings import GOAL
from charms_bench.errors import SuiteError
from charms_bench.plugins.registry import make_agent
from charms_bench.world.actions import IDLE

SUITE = """
pipeline: charms
observation: interaction
hyperparameters:
  {hidden_layers: [16], scenes: 12, steps_per_gradient_step: 6, learning_starts: 12, batch_size: 16,
   replay_buffer: 2400, target_update_steps: 12}
curve_steps: 120
weights: {plain: {safety: 1.0, efficiency: 1.0, comfort: 0.0}}
conditions:
  straight: [{lanes: 2, duration_s: 3.0}]
  roads: [{traffic: environment, roads: [{name: roundabout-v1, duration_s: 4.0}, ROAD]}]
stages:
  level_1:
    steps: 480
    weights: plain
    svo: egoistic
    reward: {goal_reward: 50.0}
    scene: {profile: {name: charms, speed_min_mps: 0.0, target_speed_min_mps: 0.0}}
    traffic: idm_mobil
    conditions: [straight, roads]
"""


def suite_with(road: str, folder: Path) -> Path:
    file = folder / "train.yaml"
    file.write_text(SUITE.replace("ROAD", road))
    return file


def learner_of(suite: TrainingSuite) -> Reinforcement:
    stage = suite.stages["level_1"]
    drivers = {name: make_agent(name) for name in suite.drivers_of(stage)}
    return Reinforcement(suite, stage, drivers, None)


LATE = "{type: interaction, delay_decisions: 2}"


@pytest.mark.parametrize("observation", ["interaction", LATE])
def test_a_training_on_roads_continues_with_the_same_bits(tmp_path: Path, observation: str) -> None:
    file = suite_with("intersection-v1", tmp_path)
    file.write_text(
        file.read_text().replace("observation: interaction", f"observation: {observation}")
    )
    suite = load_training(file)
    places = suite.places_of(suite.stages["level_1"])
    named = [str(scene.network) for scene, _ in places]
    assert named == ["None", "roundabout-v1", "intersection-v1"]
    assert [scene.duration_s for scene, _ in places] == [3.0, 4.0, 20.0]
    whole, first, second = (learner_of(suite) for _ in range(3))
    for _ in range(30):
        first._agent.step()
    second.load_arrays(first.arrays())
    for learner in (whole, second):
        learner.learn(lambda: None)
    for ours, theirs in zip(whole.network.parameters(), second.network.parameters(), strict=True):
        np.testing.assert_array_equal(ours.detach().numpy(), theirs.detach().numpy())
    np.testing.assert_array_equal(whole.observations, second.observations)
    assert (whole.observations[:, 0, 0] > 0).any()


def test_in_a_condition_the_ego_can_be_any_of_the_vehicles_of_a_road(tmp_path: Path) -> None:
    file = suite_with("merge-v1", tmp_path)
    drawn = "[{ego_slots: 2}, {ego_slots: 99}, {ego_slots: 3, roads: [exit-v1]}, {ego_slots: 99, "
    drawn += "roads: [merge-v1]}]"
    text = file.read_text().replace("[{lanes: 2, duration_s: 3.0}]", drawn)
    file.write_text(text.replace("[straight, roads]", "[straight]"))
    suite = load_training(file)
    places = suite.places_of(suite.stages["level_1"])
    # merge-v1 has the ego, three vehicles on the motorway, and one on the ramp; and an obstacle.
    assert [scene.ego_slots for scene, _ in places] == [2, 21, 3, 6]


SCENARIO = """
  placed:
    - roads: [merge-v1, {name: roundabout-v1, duration_s: 4.0}]
      duration_s: 3.0
      traffic:
        scenario:
          parameters: {gap_m: [10, 40]}
          points: random
          ego: {lane: 0, x_m: 20, speed_mps: 10}
          vehicles:
            - {name: leader, lane: 0, ahead_of: ego, gap_m: gap_m, speed_mps: SPEED}
stages:
"""


def suite_with_scenario(speed: str, folder: Path) -> Path:
    file = suite_with("merge-v1", folder)
    text = file.read_text().replace("\nstages:\n", SCENARIO.replace("SPEED", speed))
    file.write_text(text.replace("[straight, roads]", "[placed]"))
    return file


def test_a_network_learns_in_a_scenario_on_roads(tmp_path: Path) -> None:
    suite = load_training(suite_with_scenario("0", tmp_path))
    (merge, _), (roundabout, traffic) = suite.places_of(suite.stages["level_1"])
    assert [str(scene.network) for scene in (merge, roundabout)] == ["merge-v1", "roundabout-v1"]
    assert [scene.duration_s for scene in (merge, roundabout)] == [3.0, 4.0]
    assert traffic.agents == ("prescribed",)
    assert [scene.scenario.vehicles[0].name for scene in (merge, roundabout) if scene.scenario] == [
        "leader"
    ] * 2
    learner = learner_of(suite)
    learner.learn(lambda: None)
    assert (learner.observations[:, 0, 0] > 0).any()


def test_a_scenario_that_cannot_be_placed_on_a_road_is_named_with_its_place(tmp_path: Path) -> None:
    with pytest.raises(SuiteError) as error:
        load_training(suite_with_scenario("-5", tmp_path))
    assert "conditions.placed[0].traffic.scenario.vehicles[0].speed_mps" in str(error.value)


@pytest.mark.parametrize(
    ("road", "what"),
    [
        ("motorway-v9", "conditions.roads[0].roads[1]: no road named 'motorway-v9'"),
        ("{name: merge-v1, configuration: {duration: 9}}", "configuration.duration"),
        (
            "{name: exit-v1, configuration: {controlled_vehicles: 3}}",
            "conditions.roads[0].roads[1]: has 3 egos; expected a road with one",
        ),
    ],
)
def test_a_road_that_cannot_be_had_is_named_with_its_place(
    road: str, what: str, tmp_path: Path
) -> None:
    with pytest.raises(SuiteError) as error:
        load_training(suite_with(road, tmp_path))
    assert what in str(error.value)


def test_the_goal_earns_its_reward_once_and_for_the_ego_itself() -> None:
    simulation = simulation_of((500.0, 1, 30.0))
    angle = np.pi / 3
    reward = CompletedReward(
        Weights(safety=1.0, efficiency=0.0, comfort=0.0), angle, RewardScales(goal_reward=50.0)
    )
    rewards = []
    for ending in (0, GOAL):
        prepared = reward.prepare(simulation, np.array([IDLE]))
        simulation.ending[:] = ending
        rewards.append(float(reward(simulation, prepared)[0]))
    # Alone, the ego is safe: 1, of which cos 60 degrees counts, as of the goal.
    assert rewards == pytest.approx([0.5, 0.5 + 25.0])


HUMAN = """
human:
  recordings: none
  simulated:
    agents: [idm_mobil]
    scene: {profile: {name: charms, speed_min_mps: 0.0, target_speed_min_mps: 0.0}}
    traffic: idm_mobil
    conditions: [CONDITION]
    episodes: 10
  stages: {people: {drivers: simulated}}
"""


def imitated(condition: str, observation: str, folder: Path) -> Samples:
    """What simulated drivers do."""
    file = suite_with("merge-v1", folder)
    text = file.read_text().replace("observation: interaction", f"observation: {observation}")
    file.write_text(text + HUMAN.replace("CONDITION", condition))
    suite = load_training(file)
    assert suite.human is not None
    simulated = suite.human.simulated
    assert simulated is not None
    return simulated_samples(
        [each.make({}) for each in simulated.agents],
        suite.places_of(simulated),
        {name: make_agent(name) for name in suite.drivers_of(simulated)},
        simulated.episodes,
        suite.first_simulated_seed,
        suite.observed,
        suite.actions,
    )


def test_drivers_on_roads_are_imitated(tmp_path: Path) -> None:
    samples = imitated("roads", "interaction", tmp_path)
    # Vehicles come from the ramp of the merge and from the other entries of the roundabout.
    assert samples.observations[:, 8, 0].any()
    assert (np.abs(samples.observations) <= 1).all()
    speeds = samples.observations[:, 0, 0] * 33
    # Drivers are slow at the roundabout and start at 30 m/s before the merge.
    assert speeds.min() < 10 < 20 < speeds.max()


def test_imitated_drivers_see_others_late(tmp_path: Path) -> None:
    at_once, late = (imitated("straight", each, tmp_path) for each in ("interaction", LATE))
    # Each of 10 episodes of 9 decisions has samples of its last three.
    shown, found = (each.observations.reshape(3, 10, 14, 8) for each in (at_once, late))
    np.testing.assert_array_equal(found[:, :, :2], shown[:, :, :2])
    np.testing.assert_array_equal(found[2, :, 2:], shown[0, :, 2:])
    assert (found[2, :, 2:] != shown[2, :, 2:]).any()


@pytest.mark.parametrize("stage", ["{}", "{drivers: simulated, fine_tunes: level_1}"])
def test_a_delay_where_drivers_are_seen_at_once_is_rejected(tmp_path: Path, stage: str) -> None:
    file = suite_with("merge-v1", tmp_path)
    text = file.read_text().replace("observation: interaction", f"observation: {LATE}")
    human = HUMAN.replace("CONDITION", "roads").replace("{drivers: simulated}", stage)
    file.write_text(text + human)
    with pytest.raises(SuiteError, match="delay_decisions has no meaning for stages that learn"):
        load_training(file)
