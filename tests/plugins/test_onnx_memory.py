"""Networks with states, random numbers and several observations."""

# ruff: noqa: E402  (nothing below can be imported without the extra 'train')

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest

onnx = pytest.importorskip("onnx", reason="needs the extra 'train'")
torch = pytest.importorskip("torch", reason="needs the extra 'train'")

from onnx import TensorProto, helper, numpy_helper

from charms_bench.engine.simulation import Simulation
from charms_bench.errors import ModelError
from charms_bench.plugins.onnx_policy import OnnxPolicy
from charms_bench.plugins.traffic import OneAgent
from charms_bench.testing import agent_rules
from charms_bench.world.scene import SceneSettings

Shape = Sequence[str | int]
KINDS = {
    "LSTM": lambda layers: torch.nn.LSTM(35, 24, layers),
    "GRU": lambda layers: torch.nn.GRU(35, 24, layers),
    "RNN": lambda layers: torch.nn.RNN(35, 24, layers),
}


class Recurrent(torch.nn.Module):
    """A recurrent network as one writes it in torch: the state comes in and goes out."""

    def __init__(self, kind: str, layers: int) -> None:
        super().__init__()
        torch.manual_seed(0)
        self.cells, self.head = KINDS[kind](layers), torch.nn.Linear(24, 5)
        self.kind, self.shape = kind, (layers, 2, 24)

    def forward(self, observations: Any, *state: Any) -> Any:
        before = state if self.kind == "LSTM" else state[0]
        out, after = self.cells(observations.flatten(1).unsqueeze(0), before)
        return self.head(out[0]), *(after if self.kind == "LSTM" else (after,))


@pytest.fixture(params=[("LSTM", 1), ("LSTM", 2), ("GRU", 1), ("RNN", 2)], ids=str)
def recurrent(request: pytest.FixtureRequest, tmp_path: Path) -> tuple[Recurrent, OnnxPolicy]:
    """A recurrent network, and what torch exports of it."""
    network = Recurrent(*request.param)
    names = ["h", "c"][: 2 if network.kind == "LSTM" else 1]
    example = torch.zeros(2, 7, 5), *(torch.zeros(network.shape) for _ in names)
    axes = {"observations": [0], **{name: [1] for name in names}}
    with pytest.warns() as warned:
        torch.onnx.export(
            network,
            example,
            tmp_path / "recurrent.onnx",
            dynamo=False,
            input_names=list(axes),
            dynamic_axes=axes,
        )
    assert warned
    return network, OnnxPolicy(tmp_path / "recurrent.onnx")


def observed(vehicles: int, seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).uniform(-1, 1, (vehicles, 7, 5)).astype(np.float32)


def test_a_recurrent_network_acts_as_in_torch_from_decision_to_decision(
    recurrent: tuple[Recurrent, OnnxPolicy],
) -> None:
    network, policy = recurrent
    layers, states = network.shape[0], 2 if network.kind == "LSTM" else 1
    assert policy.memory_width == states * layers * 24
    memory = np.zeros((100, policy.memory_width))
    state = [torch.zeros(layers, 100, 24) for _ in range(states)]
    for step in range(5):
        seen = observed(100, seed=step)
        with torch.no_grad():
            expected, *state = network(torch.tensor(seen), *state)
        values, memory = policy.values_and_memory(seen, memory)
        np.testing.assert_allclose(values, expected, rtol=0, atol=1e-5)
    parts = [each.movedim(1, 0).reshape(100, -1) for each in state]
    np.testing.assert_allclose(memory, torch.cat(parts, dim=1), rtol=0, atol=1e-5)
    assert np.abs(memory).max() > 0.1
    actions, after = policy.decide(seen, memory, np.zeros((100, 0)))
    assert (actions.shape, after.shape, after.dtype) == ((100,), memory.shape, np.float64)


def test_no_bit_depends_on_the_other_vehicles_of_a_call(
    recurrent: tuple[Recurrent, OnnxPolicy],
) -> None:
    _, policy = recurrent
    seen = observed(300)
    memory = np.random.default_rng(1).normal(size=(300, policy.memory_width)).astype(np.float32)
    values, after = policy.values_and_memory(seen, memory.astype(float))
    order = np.random.default_rng(2).permutation(300)
    for size in (1, 7, 64, 300):
        for start in range(0, 300, size):
            part = order[start : start + size]
            again = policy.values_and_memory(seen[part], memory[part].astype(float))
            assert again[0].tobytes() == values[part].tobytes()
            assert again[1].tobytes() == after[part].tobytes()


def test_no_vehicles_have_no_memory(recurrent: tuple[Recurrent, OnnxPolicy]) -> None:
    _, policy = recurrent
    actions, memory = policy.decide(
        observed(0), np.zeros((0, policy.memory_width)), np.zeros((0, 0))
    )
    assert (actions.shape, memory.shape) == ((0,), (0, policy.memory_width))


def test_episodes_of_recurrent_networks_do_not_depend_on_those_beside_them(
    recurrent: tuple[Recurrent, OnnxPolicy],
) -> None:
    settings = SceneSettings(duration_s=4.0, traffic_vehicles=8)
    seeds = np.arange(900_000_000, 900_000_012, dtype=np.uint64)
    agents = {"network": recurrent[1]}

    def driven(some: np.ndarray) -> Simulation:
        made = Simulation(settings, len(some), "network", OneAgent("network"), agents)
        made.reset(some)
        for _ in range(8):
            made.step()
        return made

    together, apart = driven(seeds), driven(seeds[[7, 2, 3]])
    for name in ("x", "y", "memory"):
        expected = getattr(together.scene, name)[[7, 2, 3]]
        assert getattr(apart.scene, name).tobytes() == expected.tobytes()


Write = Callable[..., Path]


@pytest.fixture
def written(tmp_path: Path) -> Write:
    """Writes a network of these ports and nodes."""

    def write(
        inputs: dict[str, Shape], outputs: dict[str, Shape], nodes: list[Any], **said: Any
    ) -> Path:
        kind = said.pop("kind", TensorProto.FLOAT)
        constants = said.pop("constants", {})
        ports = [
            [
                helper.make_tensor_value_info(name, TensorProto.FLOAT, shape)
                for name, shape in each.items()
            ]
            for each in (inputs, outputs)
        ]
        ports[0][-1].type.tensor_type.elem_type = kind
        arrays = [numpy_helper.from_array(array, name) for name, array in constants.items()]
        graph = helper.make_graph(nodes, "policy", *ports, arrays)
        model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=9)
        helper.set_model_props(model, said)
        path = tmp_path / "written.onnx"
        onnx.save(model, path)
        return path

    return write


SUM = [
    helper.make_node("Add", ["total", "observations"], ["next_total"]),
    helper.make_node("MatMul", ["next_total", "weights"], ["values"]),
]
WEIGHTS = np.random.default_rng(3).integers(-3, 4, (35, 5)).astype(np.float32)


def test_a_state_may_have_the_vehicles_first(written: Write) -> None:
    inputs = {"observations": ("batch", 35), "total": ("batch", 35)}
    outputs = {"values": ("batch", 5), "next_total": ("batch", 35)}
    policy = OnnxPolicy(written(inputs, outputs, SUM, constants={"weights": WEIGHTS}))
    seen = np.random.default_rng(4).integers(-3, 4, (3, 70, 7, 5)).astype(np.float32)
    memory = np.zeros((70, 35))
    for step in range(3):
        values, memory = policy.values_and_memory(seen[step], memory)
    total = seen.sum(axis=0).reshape(70, 35)
    np.testing.assert_array_equal(memory, total)
    np.testing.assert_array_equal(values, total @ WEIGHTS)


@pytest.mark.parametrize(
    ("state", "following", "other"),
    [
        (("batch", 35), None, {}),
        (("batch", 35), ("batch", 1, 35), {}),
        ((1, 35), (1, 35), {}),
        (("batch", "width"), ("batch", "width"), {}),
        (("batch", 35), ("batch", 35), {"kind": TensorProto.DOUBLE}),
        (("batch", 4_097), ("batch", 4_097), {}),
        (None, ("batch", 35), {}),
    ],
)
def test_states_that_do_not_pair_are_named(
    written: Write, state: Shape | None, following: Shape | None, other: dict[str, Any]
) -> None:
    inputs: dict[str, Shape] = {"observations": ("batch", 35)} | ({"total": state} if state else {})
    outputs: dict[str, Shape] = {"values": ("batch", 5)}
    nodes = [helper.make_node("MatMul", ["observations", "weights"], ["values"])]
    if following:
        outputs["next_total"] = following
        nodes.append(helper.make_node("Identity", ["observations"], ["next_total"]))
    path = written(inputs, outputs, nodes, constants={"weights": WEIGHTS}, **other)
    with pytest.raises(ModelError, match=r"for each state an input such as \(batch, width\) or"):
        OnnxPolicy(path)


@pytest.mark.parametrize(
    ("reshaped", "message"),
    [
        ([-1, 70], r"'next_total', 'tensor\(float\)', \['.*', 70\].*for each state an input"),
        ([-1, 35], r"returns a next total of shape \(128, 35\); expected \(64, 35\)"),
    ],
)
def test_a_next_state_of_another_shape_is_named(
    written: Write, reshaped: list[int], message: str
) -> None:
    inputs = {"observations": ("batch", 35), "total": ("batch", 35)}
    outputs = {"values": ("batch", 5), "next_total": ("rows", "width")}
    nodes = [
        helper.make_node("MatMul", ["observations", "weights"], ["values"]),
        helper.make_node("Concat", ["total", "total"], ["twice"], axis=1),
        helper.make_node("Reshape", ["twice", "shape"], ["next_total"]),
    ]
    constants = {"weights": WEIGHTS, "shape": np.array(reshaped)}
    with pytest.raises(ModelError, match=message):
        OnnxPolicy(written(inputs, outputs, nodes, constants=constants))


def test_a_state_that_is_not_finite_is_named(written: Write) -> None:
    inputs = {"observations": ("batch", 35), "total": ("batch", 35)}
    outputs = {"values": ("batch", 5), "next_total": ("batch", 35)}
    nodes = [
        helper.make_node("MatMul", ["observations", "weights"], ["values"]),
        helper.make_node("Log", ["total"], ["next_total"]),
    ]
    path = written(inputs, outputs, nodes, constants={"weights": WEIGHTS})
    with pytest.raises(ModelError, match=r"written\.onnx: returns a state that is not finite"):
        OnnxPolicy(path)


NOISY = [
    helper.make_node("MatMul", ["observations", "weights"], ["certain"]),
    helper.make_node("Add", ["certain", "noise"], ["values"]),
]


def test_a_network_with_a_noise_input_receives_the_draws(written: Write) -> None:
    inputs = {"observations": ("batch", 35), "noise": ("batch", 5)}
    path = written(inputs, {"values": ("batch", 5)}, NOISY, constants={"weights": WEIGHTS})
    policy = OnnxPolicy(path)
    assert (policy.memory_width, policy.noise_draws, policy.history_length) == (0, 5, 1)
    draws = np.random.default_rng(5).random((700, 5))
    draws[0, 0] = np.nextafter(1.0, 0.0)
    seen = np.zeros((700, 7, 5), np.float32)
    np.testing.assert_array_equal(
        policy.decide(seen, np.zeros((700, 0)), draws), draws.argmax(axis=1)
    )
    values, _ = policy.values_and_memory(seen, noise=draws)
    assert 1 - 1e-7 < values.max() < 1
    for rule in agent_rules(policy):
        rule()


@pytest.mark.parametrize("shape", [("batch", "any"), (1, 5), ("batch", 1, 5), ("batch",)])
def test_a_noise_input_of_another_shape_is_named(written: Write, shape: Shape) -> None:
    inputs = {"observations": ("batch", 35), "noise": shape}
    path = written(inputs, {"values": None}, NOISY, constants={"weights": WEIGHTS})
    with pytest.raises(ModelError, match=r"an input noise \(batch, draws\)"):
        OnnxPolicy(path)


@pytest.mark.parametrize("shape", [("batch", 3, 7, 5), ("batch", 105)])
def test_a_network_may_take_several_observations(written: Write, shape: Shape) -> None:
    nodes = [
        helper.make_node("Flatten", ["observations"], ["flat"], axis=1),
        helper.make_node("MatMul", ["flat", "weights"], ["values"]),
    ]
    weights = np.random.default_rng(6).integers(-3, 4, (105, 5)).astype(np.float32)
    ports = {"observations": shape}, {"values": ("batch", 5)}
    policy = OnnxPolicy(written(*ports, nodes, constants={"weights": weights}, history="3"))
    assert policy.history_length == 3
    seen = np.random.default_rng(7).integers(-3, 4, (40, 3, 7, 5)).astype(np.float32)
    expected = (seen.reshape(40, 105) @ weights).argmax(axis=1)
    np.testing.assert_array_equal(policy.decide(seen), expected)
    for rule in agent_rules(policy):
        rule()


def test_the_mask_of_a_history_is_that_of_the_newest_observation(written: Write) -> None:
    nodes = [
        helper.make_node("MatMul", ["observations", "weights"], ["unmasked"]),
        helper.make_node("Mul", ["unmasked", "action_mask"], ["values"]),
    ]
    inputs = {"observations": ("batch", 70), "action_mask": ("batch", 5)}
    constants = {"weights": np.ones((70, 5), np.float32)}
    path = written(inputs, {"values": ("batch", 5)}, nodes, constants=constants, history="2")
    seen = np.ones((6, 2, 8, 5), np.float32)
    seen[:, 1, 7] = np.eye(5, dtype=np.float32)[[4, 3, 2, 1, 0, 2]]
    np.testing.assert_array_equal(OnnxPolicy(path).decide(seen), [4, 3, 2, 1, 0, 2])
