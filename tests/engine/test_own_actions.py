"""A policy can have meta-actions of its own, in both engines and on every road."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from charms_bench import DEFAULT_ACTIONS, MetaAction, Policy, with_speed_steps
from charms_bench.engine import MakeEngine
from charms_bench.engine.batched import BatchedEngine
from charms_bench.engine.simulation import Simulation
from charms_bench.errors import InputError
from charms_bench.plugins.registry import make_agent
from charms_bench.plugins.traffic import OneAgent
from charms_bench.roads.engine import RoadEngine
from charms_bench.roads.settings import on_road
from charms_bench.testing import agent_rules
from charms_bench.testing.reference_engine import ENGINES
from charms_bench.world.actions import FASTER, IDLE, LANE_LEFT, SLOWER, ActionsLike
from charms_bench.world.named_road import NamedRoad
from charms_bench.world.scene import Floats, Observations, SceneSettings

BRAKE = 5
SIX = (*DEFAULT_ACTIONS, MetaAction("BRAKE", speed_from_present_mps=-6.0))
ALONE = {"traffic_vehicles": 0, "ego_slots": 1}
PAIR = {"traffic_vehicles": 1, "ego_slots": 1, "density": 0.2}
SLOW = {"name": "charms", "speed_min_mps": 0.0, "target_speed_min_mps": 0.0}


class Scripted(Policy):
    """Carries out commands one after the other, which it counts in its memory."""

    memory_width = 1

    def __init__(self, script: list[int], actions: ActionsLike = SIX) -> None:
        self.script, self.actions = np.array(script), actions

    def decide(self, observations: Observations, memory: Floats, noise: Floats) -> Any:
        return self.script[memory[:, 0].astype(int) % self.script.size], memory + 1


def simulation(
    engine: MakeEngine, ego: Policy, other: Policy | None = None, **fields: Any
) -> Simulation:
    settings = SceneSettings.model_validate((PAIR if other else ALONE) | fields)
    agents = {"ego": ego, "other": other or Scripted([IDLE])}
    made = Simulation(settings, 1, "ego", OneAgent("other"), agents, engine)
    made.reset(np.zeros(1, dtype=np.uint64))
    return made


@pytest.mark.parametrize("engine", ENGINES)
def test_braking_by_a_set_value_is_limited_by_the_speed_controller(engine: MakeEngine) -> None:
    made = simulation(engine, Scripted([BRAKE]), profile=SLOW)
    # The ego keeps (target - speed) / 0.8 s = -6 / 0.8 = -7.5 m/s2 for each third of a second.
    for speed in (27.5, 25.0, 22.5, 20.0):
        made.step()
        assert made.scene.acceleration[0, 0] == -7.5
        assert made.scene.speed[0, 0] == pytest.approx(speed, abs=1e-9)


@pytest.mark.parametrize("engine", ENGINES)
def test_a_controller_that_acts_in_every_step_brakes_less_and_less(engine: MakeEngine) -> None:
    made = simulation(engine, Scripted([BRAKE]), profile="naturalistic")
    # Five steps of 1/15 s each take 1 / (15 * 0.8) off the 6 m/s that are left.
    left, braking = 6.0, []
    for _ in range(5):
        made.advance()
        braking.append(-left / 0.8)
        left *= 1 - 1 / 12
        assert made.scene.acceleration[0, 0] == pytest.approx(braking[-1], abs=1e-9)
    assert min(braking) == -7.5
    assert made.scene.speed[0, 0] == pytest.approx(28.0 - 6.0 + left, abs=1e-9)


@pytest.mark.parametrize("engine", ENGINES)
def test_braking_ends_a_row_of_repeated_steps(engine: MakeEngine) -> None:
    actions = with_speed_steps(0.25, 0.5, actions=SIX)
    made, found = simulation(engine, Scripted([SLOWER, SLOWER, BRAKE, SLOWER], actions)), []
    for _ in range(4):
        found.append((float(made.scene.speed[0, 0]), float(made.scene.target_speed[0, 0])))
        made.step()
    found.append((0.0, float(made.scene.target_speed[0, 0])))
    targets = [target for _, target in found]
    assert targets[1:3] == [29.75, 29.25]
    assert targets[3] == pytest.approx(found[2][0] - 6.0, abs=1e-9)
    assert targets[4] == pytest.approx(targets[3] - 0.25, abs=1e-9)  # the first step again


@pytest.mark.parametrize("engine", ENGINES)
def test_policies_of_one_scene_have_different_actions(engine: MakeEngine) -> None:
    reordered = (
        MetaAction("HOLD"),
        MetaAction("UP", speed_steps_mps=(0.5, 1.5)),
        MetaAction("DOWN AND LEFT", lanes=-1, speed_steps_mps=(-2.0,)),
    )
    made = simulation(engine, Scripted([BRAKE], SIX), Scripted([1, 1, 2], reordered), lanes=3)
    start, lane = made.scene.target_speed[0].copy(), int(made.scene.lane[0, 1])
    for target in (0.5, 2.0, 0.0):
        made.step()
        assert made.scene.target_speed[0, 1] - start[1] == pytest.approx(target, abs=1e-12)
    assert made.scene.target_lane[0, 1] == max(lane - 1, 0)
    assert made.scene.target_speed[0, 0] == 22.0  # the profile's lowest, from 30 m/s
    assert made.action_names[-4:] == ("BRAKE", "HOLD", "UP", "DOWN AND LEFT")
    assert [made.action_names[k] for k in made.named_actions[0]] == ["BRAKE", "DOWN AND LEFT"]


@pytest.mark.parametrize("engine", ENGINES)
def test_the_target_speeds_of_a_profile_are_those_of_its_own_commands(engine: MakeEngine) -> None:
    gentle = MetaAction("GENTLE", speed_steps_mps=(0.5,))
    profile = {"name": "highway-env", "ego_speed_mps": 26.0}
    own = Scripted([FASTER, 5, SLOWER], (*DEFAULT_ACTIONS, gentle))
    made = simulation(engine, own, profile=profile)
    targets = [float(made.scene.target_speed[0, 0])]
    for _ in range(3):
        made.step()
        targets.append(float(made.scene.target_speed[0, 0]))
    # From 26 to the nearest, 25; the next, 30, is also the highest; at 28 m/s, 25 is below 30.
    assert targets == [25.0, 30.0, 30.0, 25.0]


def test_the_same_actions_on_a_network_brake_there_too() -> None:
    slow = SLOW | {"ego_control_rate": "simulation"}
    road = NamedRoad(name="merge-v0")
    settings = on_road(SceneSettings.model_validate({"profile": slow}), road)
    agents = {"ego": Scripted([BRAKE]), "idm_mobil": make_agent("idm_mobil")}
    made = Simulation(settings, 1, "ego", OneAgent("idm_mobil"), agents, RoadEngine)
    made.reset(np.zeros(1, dtype=np.uint64))
    before = float(made.scene.speed[0, 0])
    made.step()
    assert made.scene.target_speed[0, 0] == before - 6.0
    assert made.scene.speed[0, 0] < before - 1.5


def test_an_answer_that_is_no_action_is_named_by_the_policys_own_count() -> None:
    five, six = Scripted([BRAKE], DEFAULT_ACTIONS), Scripted([6], SIX)
    for policy, expected in ((five, "action 5; expected 0 to 4"), (six, "6; expected 0 to 5")):
        rules = {rule.__name__: rule for rule in agent_rules(policy)}
        with pytest.raises(AssertionError, match=expected):
            rules["policy_returns_one_action_per_vehicle"]()


@pytest.mark.parametrize("rule", agent_rules(Scripted([BRAKE])), ids=lambda rule: rule.__name__)
def test_a_policy_with_six_actions_fulfils_the_contract(rule: Callable[[], None]) -> None:
    rule()


@pytest.mark.parametrize(
    ("actions", "what"),
    [
        ((), r"is '\(\)'; expected meta or continuous, or meta-actions"),
        ("BRAKE", "is 'BRAKE'; expected meta or continuous"),
        (("IDLE",), "has 'IDLE'; expected a MetaAction"),
        ((*DEFAULT_ACTIONS, DEFAULT_ACTIONS[LANE_LEFT]), "has two meta-actions named 'LANE_LEFT'"),
    ],
)
def test_actions_that_are_not_possible_name_the_attribute(actions: Any, what: str) -> None:
    with pytest.raises(InputError, match=f"agent 'ego': its attribute `actions` {what}"):
        simulation(BatchedEngine, Scripted([IDLE], actions))


@pytest.mark.parametrize(
    ("fields", "what"),
    [
        ({"lanes": 2}, "lanes is '2'; expected -1, 0 or 1"),
        ({"speed_steps_mps": (1.0, -1.0)}, "speed_steps_mps is .* expected 1 to 100 finite"),
        ({"speed_from_present_mps": float("inf")}, "speed_from_present_mps is 'inf'; expected a f"),
        ({"profile_step": 1, "speed_from_present_mps": 1.0}, "expected one of profile_step, speed"),
    ],
)
def test_a_meta_action_that_is_not_possible_is_named(fields: Any, what: str) -> None:
    with pytest.raises(InputError, match=f"meta-action 'ODD': {what}"):
        MetaAction("ODD", **fields)
