"""Plugins held to their word: which calls are asked again, what rounding explains, no effect."""

from pathlib import Path

import numpy as np
import pytest

from charms_bench.engine.events import Crash, lowest_levels
from charms_bench.engine.simulation import Simulation
from charms_bench.errors import AgentError, BrokenWordError
from charms_bench.plugins.agent import Policy
from charms_bench.plugins.event import Event
from charms_bench.plugins.held import Held, HeldEvent
from charms_bench.plugins.held_agents import check_decisions, hold
from charms_bench.plugins.onnx_policy import OnnxPolicy
from charms_bench.plugins.registry import make_agent, make_traffic
from charms_bench.testing.contract import agent_is_deterministic
from charms_bench.testing.contract import policy_decides_for_each_vehicle_independently as alone
from charms_bench.world.actions import Actions
from charms_bench.world.scene import Floats, Ints, Observations, Scene, SceneSettings

SETTINGS = SceneSettings(duration_s=4.0, traffic_vehicles=8)


def simulated(agents: dict[str, object], ego: str, traffic: str) -> Simulation:
    simulation = Simulation(SETTINGS, 20, ego, make_traffic(traffic), agents)  # type: ignore[arg-type]
    simulation.reset(np.arange(900_000_000, 900_000_020, dtype=np.uint64))
    while simulation.scene.active.any():
        simulation.step()
    return simulation


@pytest.mark.parametrize("ego", ["charms", "outside_policy", "outside_model", "idm_mobil_varied"])
def test_holding_an_agent_changes_nothing(ego: str) -> None:
    names = {ego, "outside_model"}
    plain = simulated({name: make_agent(name) for name in names}, ego, "outside_model")
    rng = np.random.default_rng(0)
    agents = {name: hold(make_agent(name), make_agent(name), SETTINGS, rng) for name in names}
    held = simulated(dict(agents), ego, "outside_model")
    for one, other in zip(plain.scene[:-1], held.scene[:-1], strict=True):
        assert np.array_equal(one, other, equal_nan=True)
    for agent in agents.values():
        agent.finish("an honest agent")


def test_the_seed_chooses_a_call_of_the_shard() -> None:
    def chosen(seed: int) -> list[int]:
        held = Held("plugin", "other", np.random.default_rng(seed), calls=300)
        return [call for call in range(300) if held._is_chosen()]

    calls = [chosen(seed)[-1] for seed in range(200)]
    assert calls[:9] == [chosen(seed)[-1] for seed in range(9)]
    assert min(calls) < 20
    assert max(calls) > 280
    assert 120 < np.mean(calls) < 180


class Tie(Policy):
    """Its values round differently when there is one vehicle only."""

    def decide(self, observations: Observations) -> Actions:
        rounding = 1e-9 if len(observations) > 1 else 0.0
        return (observations[:, 0, 0].astype(np.float64) + rounding > 1.0).astype(np.int64)


def test_one_action_at_a_tie_is_rounding_and_two_are_not() -> None:
    observations = np.full((5, 7, 5), 2.0, dtype=np.float32)
    observations[0] = 1.0
    together, nothing = Tie().decide(observations), np.zeros((5, 0))
    one, places = (observations[:1],), np.arange(7, 12)
    check_decisions(Tie(), one, (together[:1], nothing[:1]), "asked alone", places)
    observations[:2] = 1.0
    expected = np.array([0, 0, 1, 1, 1]), nothing
    with pytest.raises(
        BrokenWordError, match="decide returned 0, and 1 when asked again"
    ) as raised:
        check_decisions(Tie(), (observations,), expected, "asked again", places)
    assert raised.value.vehicle == 7


def test_a_difference_that_no_small_change_explains_is_no_rounding() -> None:
    class Crowded(Policy):
        def decide(self, observations: Observations) -> Actions:
            return np.full(len(observations), min(len(observations), 4))

    one = np.ones((1, 7, 5), dtype=np.float32)
    expected = np.array([2]), np.zeros((1, 0))
    with pytest.raises(BrokenWordError, match="decide returned 2, and 1 when asked"):
        check_decisions(Crowded(), (one,), expected, "asked", np.array([0]))


@pytest.fixture
def standardising(tmp_path: Path) -> Path:
    """A network that subtracts the mean of its batch."""
    onnx = pytest.importorskip("onnx", reason="needs the extra 'train'")
    helper = onnx.helper
    weights = np.random.default_rng(0).normal(size=(35, 5)).astype(np.float32)
    graph = helper.make_graph(
        [
            helper.make_node("ReduceMean", ["observations"], ["mean"], axes=[0], keepdims=1),
            helper.make_node("Sub", ["observations", "mean"], ["centred"]),
            helper.make_node("MatMul", ["centred", "weights"], ["values"]),
        ],
        "policy",
        [helper.make_tensor_value_info("observations", 1, ["batch", 35])],
        [helper.make_tensor_value_info("values", 1, ["batch", 5])],
        [onnx.numpy_helper.from_array(weights, "weights")],
    )
    path = tmp_path / "standardising.onnx"
    onnx.save(
        helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=9), path
    )
    return path


def test_a_network_that_calculates_across_its_batch_is_refused(standardising: Path) -> None:
    network = OnnxPolicy(standardising)
    agents = {"net": hold(network, network, SETTINGS, np.random.default_rng(0))}
    simulated({**agents, "idm_mobil": make_agent("idm_mobil")}, "net", "idm_mobil")
    with pytest.raises(AgentError, match=r"the shard: decide returned .* in another order"):
        agents["net"].finish("the shard")
    with pytest.raises(AssertionError, match="when asked in batches of 1 in another order"):
        alone(network)


class Jumpy(Event):
    """Looks at its number of calls."""

    definition = "it is called often"
    calls = 0

    def level(self, scene: Scene, rows: Ints) -> Floats:
        self.calls += 1
        return np.full(rows.size, float(self.calls))


def test_an_event_is_held_to_its_word() -> None:
    def levels(event: Event) -> Floats:
        agent = {"idm_mobil": make_agent("idm_mobil")}
        traffic = make_traffic("idm_mobil")
        simulation = Simulation(SETTINGS, 20, "idm_mobil", traffic, agent)
        simulation.reset(np.arange(900_000_000, 900_000_020, dtype=np.uint64))
        return lowest_levels(simulation, event)

    held = HeldEvent(Crash(), Crash(), np.random.default_rng(0), 60)
    assert np.array_equal(levels(held), levels(Crash()))
    held.finish("the event")
    jumpy = HeldEvent(Jumpy(), Jumpy(), np.random.default_rng(0), 60)
    levels(jumpy)
    with pytest.raises(AgentError, match=r"the event: level returned \d+\.0, and 1\.0 when"):
        jumpy.finish("the event")


class Tired(Policy):
    """Brakes after ten calls."""

    calls = 0

    def decide(self, observations: Observations) -> Actions:
        self.calls += 1
        return np.full(len(observations), 4 if self.calls > 10 else 1)


def test_check_finds_a_policy_that_changes_after_some_calls() -> None:
    with pytest.raises(AssertionError, match="336 answers differ after 20 other calls"):
        agent_is_deterministic(Tired())


class Odd(Policy):
    """Looks at whether its batch is odd."""

    def decide(self, observations: Observations) -> Actions:
        return np.full(len(observations), 3 if len(observations) == 7 else 1)


def test_check_asks_at_three_sizes_of_the_batch() -> None:
    with pytest.raises(AssertionError, match="decide returned 1, and 3 when asked in batches of 7"):
        alone(Odd())


def test_a_plugin_that_makes_two_kinds_of_agents_is_refused() -> None:
    rng = np.random.default_rng(0)
    model, policy = make_agent("outside_model"), make_agent("outside_policy")
    for one, other in ((model, policy), (policy, model)):
        with pytest.raises(BrokenWordError, match="expected the same kind of agent each time"):
            hold(one, other, SETTINGS, rng)
