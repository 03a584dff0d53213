"""The contract tests: they pass good plugins and find each kind of bad one."""

import ast
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from charms_bench.plugins.agent import DriverModel, Policy
from charms_bench.plugins.registry import AGENTS, make_agent, make_traffic, plugins
from charms_bench.plugins.traffic import Traffic
from charms_bench.testing import agent_rules, contract, example_scene, traffic_rules
from charms_bench.world.actions import Actions
from charms_bench.world.scene import Floats, Ints, Observations, Scene, Vehicles

RNG = np.random.default_rng(0)
STYLE = re.compile(r"charms-(safe|efficient)-|charms-best|prior_")
"""Agents that differ from others by the weights of their networks only."""
OURS = [
    name
    for name, plugin in plugins(AGENTS).items()
    if plugin.distribution == "charms-bench" and not STYLE.match(name)
]


@pytest.mark.parametrize("name", OURS)
def test_every_agent_of_the_project_keeps_the_contract(name: str) -> None:
    for rule in agent_rules(make_agent(name)):
        rule()


def test_one_agent_everywhere_keeps_the_contract_of_traffics() -> None:
    for rule in traffic_rules(make_traffic("idm_mobil")):
        rule()


def test_the_example_scene_has_lane_changes_and_crashes() -> None:
    scene = example_scene()
    assert (scene.lane != scene.target_lane).any()
    assert scene.crashed.any()


class Decides(Policy):
    """A policy made of a function."""

    def __init__(self, function: Callable[[Observations], Actions]) -> None:
        self.function = function

    def decide(self, observations: Observations) -> Actions:
        return self.function(observations)


class Continuous(Decides):
    """The same, with continuous actions."""

    actions = "continuous"


class Drives(DriverModel):
    """A driver model made of a function."""

    def __init__(self, function: Callable[[Scene, Vehicles], tuple[Floats, Ints]]) -> None:
        self.function = function

    def drive(self, scene: Scene, vehicles: Vehicles) -> tuple[Floats, Ints]:
        return self.function(scene, vehicles)


class Tired:
    """A function that answers otherwise after some calls."""

    calls = 0

    def __call__(self, observations: Observations) -> Actions:
        self.calls += 1
        return np.full(len(observations), 4 if self.calls > 10 else 1)


def scribble(observations: Observations) -> Actions:
    observations[:] = 0
    return np.ones(len(observations), dtype=np.int64)


def push(scene: Scene, vehicles: Vehicles) -> tuple[Floats, Ints]:
    scene.x[vehicles] += 1.0
    return np.zeros(vehicles[0].size), scene.lane[vehicles]


def push_by_force(scene: Scene, vehicles: Vehicles) -> tuple[Floats, Ints]:
    scene.x.base[vehicles] += 1.0
    return np.zeros(vehicles[0].size), scene.lane[vehicles]


RETURNS = "policy_returns_one_action_per_vehicle"
ALONE = "policy_decides_for_each_vehicle_independently"
SAME = "agent_is_deterministic"
DRIVES = "model_returns_one_acceleration_and_lane_per_vehicle"
IN_ONES = "when asked in batches of 1 in another order"
BROKEN: tuple[tuple[str, Any, str], ...] = (
    (RETURNS, Decides(lambda o: np.ones(3, int)), r"\(3,\); expected integers of shape \(336,\)"),
    (RETURNS, Decides(lambda o: np.ones(len(o))), "float64 of shape"),
    (RETURNS, Decides(lambda o: np.full(len(o), -1)), "action -1"),
    (RETURNS, Decides(lambda o: np.full(len(o), 5)), "action 5"),
    (RETURNS, Continuous(lambda o: np.ones(len(o))), r"shape \(336, 2\)"),
    (RETURNS, Continuous(lambda o: np.full((len(o), 2), 1.5)), "action"),
    (RETURNS, Continuous(lambda o: np.full((len(o), 2), np.inf)), "inf"),
    (ALONE, Decides(lambda o: np.full(len(o), min(len(o), 3))), f"decide returned .*{IN_ONES}"),
    (ALONE, Decides(lambda o: np.full(len(o), 3 if len(o) == 7 else 1)), "1, and 3 .*batches of 7"),
    (ALONE, Continuous(lambda o: np.full((len(o), 2), 1 / len(o))), f"returned .*{IN_ONES}"),
    (SAME, Decides(lambda o: RNG.integers(0, 5, len(o))), "decide returned .* when asked again$"),
    (SAME, Decides(Tired()), "decide returned 1, and 4 when asked again$"),
    (SAME, Drives(lambda s, v: (RNG.random(v[0].size), s.lane[v])), "drive .* when asked again$"),
    ("policy_does_not_change_its_observations", Decides(scribble), "changed its observations"),
    (DRIVES, Drives(lambda s, v: (np.zeros(v[0].size), s.lane[v] + 1)), "lane 3; expected 0 to 2"),
    (
        "model_drives_each_scene_independently",
        Drives(lambda s, v: (np.full(v[0].size, float(v[0].size)), s.lane[v])),
        r"returned 336\.0, and 21\.0 when shown 1 of 16 scenes in another order",
    ),
    ("model_does_not_change_the_scene", Drives(push), "drive changed the scene: .* read-only"),
    ("model_does_not_change_the_scene", Drives(push_by_force), r"drive changed scene\.x"),
    (
        "agent_answers_the_same_in_another_process",
        Decides(lambda o: np.ones(len(o), int)),
        "cannot be pickled: .*lambda",
    ),
)


@pytest.mark.parametrize(("rule", "agent", "message"), BROKEN)
def test_an_agent_that_breaks_a_rule_is_found(rule: str, agent: Any, message: str) -> None:
    with pytest.raises(AssertionError, match=message):
        getattr(contract, rule)(agent)


def test_a_policy_with_continuous_actions_keeps_the_rules() -> None:
    for rule in agent_rules(Continuous(lambda o: np.ones((len(o), 2)))):
        if not rule.__name__.startswith("agent_answers_the_same"):  # a lambda has no pickle
            rule()


@pytest.mark.parametrize("folder", ["charms_bench", "agents", "baselines"])
def test_an_assertion_only_tells_types(folder: str) -> None:
    told = re.compile(r"isinstance\(.*\)|\S+ is not None")
    for path in (Path(contract.__file__).parents[2] / folder).rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.Assert):
                assert told.fullmatch(ast.unparse(node.test)), f"{path}:{node.lineno}"


def test_a_policy_with_an_impossible_rate_is_found() -> None:
    policy = Decides(lambda observations: np.ones(len(observations), dtype=np.int64))
    policy.decision_hz = 0.0
    with pytest.raises(AssertionError, match=r"decision_hz is 0\.0"):
        contract.policy_names_an_observation_and_a_rate(policy)


def test_a_traffic_that_assigns_strangers_is_found() -> None:
    class Strange(Traffic):
        agents = ("idm_mobil",)

        def assign(self, rng, scenes, vehicles):  # type: ignore[no-untyped-def]  # as authors may
            return np.full((scenes, vehicles), "stranger")

    with pytest.raises(AssertionError, match="assign returned 'stranger'"):
        contract.traffic_assigns_its_agents(Strange())


class Forgetful(Policy):
    """Loses what it was made with on the way to another process."""

    action = 1

    def decide(self, observations: Observations) -> Actions:
        return np.full(len(observations), self.action)

    def __getstate__(self) -> dict[str, object]:
        return {"lost": True}


def test_an_agent_that_is_another_in_another_process_is_found() -> None:
    policy = Forgetful()
    contract.agent_answers_the_same_in_another_process(policy)
    policy.action = 2
    with pytest.raises(AssertionError, match="decide returned 2, and 1 when asked after pickling"):
        contract.agent_answers_the_same_in_another_process(policy)


def test_an_agent_that_takes_its_time_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(contract, "SLOW_MS", 0.0)
    with pytest.raises(AssertionError, match=r"ms per vehicle; expected <= 0\.0 ms"):
        contract.agent_answers_in_time(Forgetful())
