"""A run finds plugins whose answers depend on more than their questions, and changes no answer."""

from pathlib import Path

import numpy as np
import pytest

from charms_bench.engine.events import Crash, lowest_levels
from charms_bench.engine.simulation import Simulation
from charms_bench.errors import AgentError, BrokenWordError
from charms_bench.plugins.agent import Policy
from charms_bench.plugins.consistency import Checked, CheckedEvent, PolicyCall, checked
from charms_bench.plugins.event import Event
from charms_bench.plugins.onnx_policy import OnnxPolicy
from charms_bench.plugins.registry import make_agent, make_traffic
from charms_bench.testing.contract import policy_decides_for_each_vehicle_independently as alone
from charms_bench.world.actions import Actions
from charms_bench.world.scene import Floats, Ints, Observations, Scene, SceneSettings

SETTINGS = SceneSettings(duration_s=4.0, traffic_vehicles=8)
SEEDS = np.arange(900_000_000, 900_000_020, dtype=np.uint64)


def simulated(agents: dict[str, object], ego: str, traffic: str) -> Simulation:
    simulation = Simulation(SETTINGS, 20, ego, make_traffic(traffic), agents)  # type: ignore[arg-type]
    simulation.reset(SEEDS)
    while simulation.scene.active.any():
        simulation.step()
    return simulation


@pytest.mark.parametrize("ego", ["charms", "outside_policy", "outside_model", "idm_mobil_varied"])
def test_checking_an_agent_changes_nothing(ego: str) -> None:
    names = {ego, "outside_model"}
    plain = simulated({name: make_agent(name) for name in names}, ego, "outside_model")
    rng = np.random.default_rng(0)
    agents = {n: checked(make_agent(n), make_agent(n), SETTINGS, rng) for n in names}
    found = simulated(dict(agents), ego, "outside_model")
    for one, other in zip(plain.scene[:-1], found.scene[:-1], strict=True):
        assert np.array_equal(one, other, equal_nan=True)
    for agent in agents.values():
        agent.finish("an honest agent")


def test_the_seed_chooses_a_call_of_the_shard() -> None:
    def chosen(seed: int) -> int:
        plugin = Checked("plugin", "other", np.random.default_rng(seed), calls=300)
        return [call for call in range(300) if plugin._is_chosen()][-1]

    calls = [chosen(seed) for seed in range(200)]
    assert calls[:9] == [chosen(seed) for seed in range(9)]
    assert (min(calls) < 20, max(calls) > 280, 120 < np.mean(calls) < 180) == (True, True, True)


class Tie(Policy):
    """Its values round differently when there is one vehicle only."""

    def decide(self, observations: Observations) -> Actions:
        rounding = 1e-9 if len(observations) > 1 else 0.0
        return (observations[:, 0, 0].astype(np.float64) + rounding > 1.0).astype(np.int64)


def call_of(observations: Observations, actions: Actions) -> PolicyCall:
    return PolicyCall((observations,), np.asarray(actions), np.zeros((len(observations), 0)))


def test_one_action_at_a_tie_is_rounding_and_two_are_not() -> None:
    observations = np.full((9, 7, 5), 2.0, dtype=np.float32)
    observations[7] = 1.0
    call_of(observations, Tie().decide(observations)).check(Tie(), np.array([7]), "asked alone")
    observations[8] = 1.0
    call = call_of(observations, [1] * 7 + [0, 0])
    with pytest.raises(BrokenWordError, match="decide returned 0, and 1 when asked again") as found:
        call.check(Tie(), np.array([4, 7, 8]), "asked again")
    assert found.value.vehicle == 7


def test_a_difference_that_no_small_change_explains_is_no_rounding() -> None:
    class Crowded(Policy):
        def decide(self, observations: Observations) -> Actions:
            return np.full(len(observations), min(len(observations), 4))

    call = call_of(np.ones((1, 7, 5), dtype=np.float32), [2])
    with pytest.raises(BrokenWordError, match="decide returned 2, and 1 when asked"):
        call.check(Crowded(), np.array([0]), "asked")


@pytest.mark.parametrize(("off", "exactly"), [(2e-4, False), (1e-5, True)])
def test_continuous_actions_and_memory_differ_by_rounding_only(off: float, exactly: bool) -> None:
    class Moved(Policy):
        actions, memory_width = "continuous", 1

        def decide(self, observations: Observations, memory: Floats, noise: Floats) -> object:
            by = off * np.array([[self.moves == "actions", self.moves == "memory"]])
            return np.full((len(memory), 2), by[0, 0]), memory + by[0, 1]

    policy, nothing = Moved(), np.zeros((3, 1))
    asked = np.ones((3, 7, 5), dtype=np.float32), nothing, nothing
    call = PolicyCall(asked, np.zeros((3, 2)), nothing)
    for policy.moves in ("nothing", "actions", "memory"):  # type: ignore[attr-defined]
        if policy.moves == "nothing":
            call.check(policy, np.arange(3), "asked", exactly)
            continue
        with pytest.raises(BrokenWordError, match="decide returned"):
            call.check(policy, np.arange(3), "asked", exactly)
        if exactly:
            call.check(policy, np.arange(3), "asked")


@pytest.fixture
def standardising(tmp_path: Path) -> OnnxPolicy:
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
    path, opset = tmp_path / "standardising.onnx", helper.make_opsetid("", 17)
    onnx.save(helper.make_model(graph, opset_imports=[opset], ir_version=9), path)
    return OnnxPolicy(path)


def test_a_network_that_calculates_across_its_batch_is_rejected(standardising: OnnxPolicy) -> None:
    agents = {"net": checked(standardising, standardising, SETTINGS, np.random.default_rng(0))}
    simulated({**agents, "idm_mobil": make_agent("idm_mobil")}, "net", "idm_mobil")
    with pytest.raises(AgentError, match=r"the shard: decide returned .* in another order"):
        agents["net"].finish("the shard")
    with pytest.raises(AssertionError, match="when asked in batches of 1 in another order"):
        alone(standardising)


class Jumpy(Event):
    """Looks at its number of calls."""

    definition = "it is called often"
    calls = 0

    def level(self, scene: Scene, rows: Ints) -> Floats:
        self.calls += 1
        return np.full(rows.size, float(self.calls))


def test_an_event_that_keeps_state_is_rejected() -> None:
    def levels(event: Event) -> Floats:
        agent = {"idm_mobil": make_agent("idm_mobil")}
        simulation = Simulation(SETTINGS, 20, "idm_mobil", make_traffic("idm_mobil"), agent)
        simulation.reset(SEEDS)
        return lowest_levels(simulation, event)

    honest, jumpy = (
        CheckedEvent(kind(), kind(), np.random.default_rng(0), 60) for kind in (Crash, Jumpy)
    )
    assert np.array_equal(levels(honest), levels(Crash()))
    honest.finish("the event")
    levels(jumpy)
    with pytest.raises(AgentError, match=r"the event: level returned \d+\.0, and 1\.0 when"):
        jumpy.finish("the event")


def test_a_plugin_that_makes_two_kinds_of_agents_is_rejected() -> None:
    model, policy = make_agent("outside_model"), make_agent("outside_policy")
    for one, other in ((model, policy), (policy, model)):
        with pytest.raises(BrokenWordError, match="expected the same kind of agent each time"):
            checked(one, other, SETTINGS, np.random.default_rng(0))
