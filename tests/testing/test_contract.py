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
OURS = [name for name, plugin in plugins(AGENTS).items() if plugin.distribution == "charms-bench"]


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


def scribble(observations: Observations) -> Actions:
    observations[:] = 0
    return np.ones(len(observations), dtype=np.int64)


@pytest.mark.parametrize(
    ("function", "rule", "message"),
    [
        (
            lambda o: np.ones(3, int),
            "policy_returns_one_action_per_vehicle",
            r"int64 of shape \(3,\); expected integers of shape \(336,\)",
        ),
        (lambda o: np.ones(len(o)), "policy_returns_one_action_per_vehicle", "float64 of shape"),
        (lambda o: np.full(len(o), -1), "policy_returns_one_action_per_vehicle", "action -1"),
        (lambda o: np.full(len(o), 5), "policy_returns_one_action_per_vehicle", "action 5"),
        (
            lambda o: np.full(len(o), min(len(o), 3)),
            "policy_decides_for_each_vehicle_independently",
            r"decide returned \S+( \S+)?, and .* when asked in batches of 1 in another order",
        ),
        (
            lambda o: RNG.integers(0, 5, len(o)),
            "agent_is_deterministic",
            "answers differ between two calls",
        ),
        (scribble, "policy_does_not_change_its_observations", "changed its observations"),
    ],
)
def test_a_policy_that_breaks_a_rule_is_found(
    function: Callable[[Observations], Actions], rule: str, message: str
) -> None:
    with pytest.raises(AssertionError, match=message):
        getattr(contract, rule)(Decides(function))


def test_every_rule_is_kept_when_python_optimises() -> None:
    source = Path(contract.__file__)
    names: dict[str, Any] = {"__name__": "optimised"}
    exec(compile(source.read_text(), source, "exec", optimize=1), names)
    policy = Decides(lambda o: RNG.integers(0, 5, len(o)))
    for rule in ("agent_is_deterministic", "policy_decides_for_each_vehicle_independently"):
        with pytest.raises(AssertionError, match=r"differ|decide returned"):
            names[rule](policy)


@pytest.mark.parametrize("folder", ["charms_bench", "agents", "baselines"])
def test_an_assertion_only_tells_types(folder: str) -> None:
    told = re.compile(r"isinstance\(.*\)|\S+ is not None")
    for path in (Path(contract.__file__).parents[2] / folder).rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.Assert):
                assert told.fullmatch(ast.unparse(node.test)), f"{path}:{node.lineno}"


def test_a_policy_with_an_impossible_rate_or_observation_is_found() -> None:
    policy = Decides(lambda observations: np.ones(len(observations), dtype=np.int64))
    policy.decision_hz = 0.0
    with pytest.raises(AssertionError, match=r"decision_hz is 0\.0"):
        contract.policy_names_an_observation_and_a_rate(policy)


@pytest.mark.parametrize(
    ("function", "rule", "message"),
    [
        (lambda o: np.ones((len(o), 2)), None, ""),
        (lambda o: np.ones(len(o)), "policy_returns_one_action_per_vehicle", r"shape \(336, 2\)"),
        (lambda o: np.full((len(o), 2), 1.5), "policy_returns_one_action_per_vehicle", "action"),
        (lambda o: np.full((len(o), 2), np.inf), "policy_returns_one_action_per_vehicle", "inf"),
        (
            lambda o: np.full((len(o), 2), 1 / len(o)),
            "policy_decides_for_each_vehicle_independently",
            r"decide returned \S+( \S+)?, and .* when asked in batches of 1 in another order",
        ),
    ],
)
def test_a_policy_with_continuous_actions_keeps_the_same_rules(
    function: Callable[[Observations], Actions], rule: str | None, message: str
) -> None:
    policy = Decides(function)
    policy.actions = "continuous"
    if rule is None:
        for each in agent_rules(policy):
            if not each.__name__.startswith("agent_answers_the_same"):  # a lambda has no pickle
                each()
        return
    with pytest.raises(AssertionError, match=message):
        getattr(contract, rule)(policy)


class Drives(DriverModel):
    """A driver model made of a function."""

    def __init__(self, function: Callable[[Scene, Vehicles], tuple[Floats, Ints]]) -> None:
        self.function = function

    def drive(self, scene: Scene, vehicles: Vehicles) -> tuple[Floats, Ints]:
        return self.function(scene, vehicles)


def push(scene: Scene, vehicles: Vehicles) -> tuple[Floats, Ints]:
    scene.x[vehicles] += 1.0
    return np.zeros(vehicles[0].size), scene.lane[vehicles]


def push_by_force(scene: Scene, vehicles: Vehicles) -> tuple[Floats, Ints]:
    scene.x.base[vehicles] += 1.0
    return np.zeros(vehicles[0].size), scene.lane[vehicles]


@pytest.mark.parametrize(
    ("function", "rule", "message"),
    [
        (
            lambda s, v: (np.zeros(v[0].size), s.lane[v] + 1),
            "model_returns_one_acceleration_and_lane_per_vehicle",
            "lane 3; expected 0 to 2",
        ),
        (
            lambda s, v: (np.full(v[0].size, float(v[0].size)), s.lane[v]),
            "model_drives_each_scene_independently",
            r"returned 336\.0, and 21\.0 when shown 1 of 16 scenes in another order",
        ),
        (
            lambda s, v: (RNG.random(v[0].size), s.lane[v]),
            "agent_is_deterministic",
            "answers differ between two calls",
        ),
        (push, "model_does_not_change_the_scene", "drive changed the scene: .* read-only"),
        (push_by_force, "model_does_not_change_the_scene", r"drive changed scene\.x"),
    ],
)
def test_a_driver_model_that_breaks_a_rule_is_found(
    function: Callable[[Scene, Vehicles], tuple[Floats, Ints]], rule: str, message: str
) -> None:
    with pytest.raises(AssertionError, match=message):
        getattr(contract, rule)(Drives(function))


def test_a_traffic_that_assigns_strangers_is_found() -> None:
    class Strange(Traffic):
        agents = ("idm_mobil",)

        def assign(self, rng, scenes, vehicles):  # type: ignore[no-untyped-def]  # as authors may
            return np.full((scenes, vehicles), "stranger")

    with pytest.raises(AssertionError, match="assign returned 'stranger'"):
        contract.traffic_assigns_its_agents(Strange())


def test_an_agent_that_cannot_go_to_another_process_is_found() -> None:
    policy = Decides(lambda observations: np.ones(len(observations), dtype=np.int64))
    with pytest.raises(AssertionError, match=r"cannot be pickled: .*lambda"):
        contract.agent_answers_the_same_in_another_process(policy)


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
    with pytest.raises(AssertionError, match="336 answers differ after pickling"):
        contract.agent_answers_the_same_in_another_process(policy)


def test_an_agent_that_takes_its_time_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(contract, "SLOW_MS", 0.0)
    with pytest.raises(AssertionError, match=r"ms per vehicle; expected <= 0\.0 ms"):
        contract.agent_answers_in_time(Forgetful())
