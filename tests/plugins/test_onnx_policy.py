"""Networks from files: checked before they are loaded, and the action of the highest value."""

import hashlib
import json
import pickle
import re
import warnings
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from charms_bench.errors import ModelError
from charms_bench.plugins.onnx_policy import ROWS_AT_ONCE, OnnxPolicy
from charms_bench.testing import agent_rules
from charms_bench.world.actions import DEFAULT_ACTIONS, with_speed_steps
from charms_bench.world.kinematics_observation import Kinematics
from charms_bench.world.observations import Neighbours, described, neighbours

NetworkFile = Callable[..., Path]


def test_it_takes_the_action_of_the_highest_value(network_file: NetworkFile) -> None:
    weights = np.random.default_rng(1).normal(size=(35, 5)).astype(np.float32)
    observations = np.random.default_rng(2).uniform(-1, 1, (64, 7, 5)).astype(np.float32)
    expected = (observations.reshape(64, 35) @ weights).argmax(axis=1)
    policy = OnnxPolicy(network_file(weights))
    assert (policy.decide(observations) == expected).all()


@pytest.mark.parametrize("count", [0, 1, ROWS_AT_ONCE, ROWS_AT_ONCE + 1, 3 * ROWS_AT_ONCE])
def test_values_keep_the_order_of_observations(network_file: NetworkFile, count: int) -> None:
    weights = np.random.default_rng(1).integers(-8, 8, (35, 5)).astype(np.float32)
    observations = np.random.default_rng(2).integers(-8, 8, (count, 7, 5)).astype(np.float32)
    expected = observations.reshape(count, 35) @ weights  # exact, as all sums are small integers
    assert np.array_equal(
        OnnxPolicy(network_file(weights)).values_and_memory(observations)[0], expected
    )


def test_the_hash_is_that_of_the_file(network_file: NetworkFile) -> None:
    path = network_file()
    assert OnnxPolicy(path).weights_sha256 == hashlib.sha256(path.read_bytes()).hexdigest()


def test_it_keeps_the_contract_of_agents(network_file: NetworkFile) -> None:
    for rule in agent_rules(OnnxPolicy(network_file())):
        rule()


def test_it_survives_pickling_by_its_path(network_file: NetworkFile) -> None:
    policy = OnnxPolicy(network_file(), decision_hz=5.0)
    again = pickle.loads(pickle.dumps(policy))
    assert (again.weights_sha256, again.decision_hz) == (policy.weights_sha256, 5.0)


def test_it_decides_as_often_as_the_file_says(network_file: NetworkFile) -> None:
    assert OnnxPolicy(network_file()).decision_hz == 3.0
    path = network_file(metadata={"decision_hz": "5"})
    assert OnnxPolicy(path).decision_hz == 5.0
    assert OnnxPolicy(path, decision_hz=1.0).decision_hz == 1.0


STEPS = "expected a JSON list of 1 to 100 positive finite numbers"
MISSTATED: tuple[tuple[str, str, str], ...] = (
    ("decison_hz", "5", "no key 'decison_hz'. Did you mean 'decision_hz'"),
    ("Decision_hz", "5", "no key 'Decision_hz'. Did you mean 'decision_hz'"),
    ("observation_space", "5", "no key 'observation_space'. Did you mean 'observation'"),
    ("action", "5", "no key 'action'. Did you mean 'actions'"),
    ("target_speeds_mps", "5", "Did you mean 'target_speed_steps_mps'"),
    ("actions", "continous", "actions is 'continous'; expected continuous"),
    ("actions", "", "actions is ''; expected continuous"),
    ("decision_hz", "often", "decision_hz is 'often'"),
    ("decision_hz", "0", "decision_hz is '0'"),
    ("decision_hz", "nan", "decision_hz is 'nan'"),
    ("target_speed_steps_mps", "[]", STEPS),
    ("target_speed_steps_mps", "1.0", STEPS),
    ("target_speed_steps_mps", "[-1]", STEPS),
    ("target_speed_steps_mps", "[1, NaN]", STEPS),
    ("target_speed_steps_mps", '["1"]', STEPS),
    ("target_speed_steps_mps", "[" * 100_000, STEPS),
    ("target_speed_steps_mps", json.dumps([1.0] * 101), STEPS),
    ("observation", "tomorrow", "no observation named 'tomorrow'"),
    ("observation", '{"type": "Kinematics", "see": 1}', "Kinematics: see: unknown key"),
    ("observation", '{"type": "Kin', "observation: is not JSON"),
    ("observation", '{"type": "Kinematics", "order": 1, "order": 2}', "'order' is given twice"),
    ("history", "0", "history is '0'; expected a number of"),
    ("history", "1.5", "history is '1.5'; expected a number of"),
    ("history", "101", "history is '101'; expected a number of"),
)


@pytest.mark.parametrize(("key", "said", "message"), MISSTATED)
def test_metadata_that_cannot_be_meant_are_named(
    network_file: NetworkFile, key: str, said: str, message: str
) -> None:
    with pytest.raises(ModelError, match=f"metadata: .*{re.escape(message)}"):
        OnnxPolicy(network_file(metadata={key: said}))


def test_metadata_may_say_more(network_file: NetworkFile) -> None:
    metadata = {"author": "me", "description": "fast", "version": "2", "decision_hz": "5"}
    assert OnnxPolicy(network_file(metadata=metadata)).decision_hz == 5


def test_a_key_of_the_metadata_that_is_there_twice_is_named(network_file: NetworkFile) -> None:
    onnx = pytest.importorskip("onnx")
    path = network_file(metadata={"decision_hz": "5"})
    loaded = onnx.load(path)
    loaded.metadata_props.add(key="decision_hz", value="1")
    onnx.save(loaded, path)
    with pytest.raises(ModelError, match="metadata: has the key 'decision_hz' 2 times"):
        OnnxPolicy(path)


def mean_over_the_others(path: Path, history: int = 1) -> Path:
    """The mean row of the other vehicles that are present, which has no value without any."""
    onnx = pytest.importorskip("onnx")
    helper, kind = onnx.helper, onnx.TensorProto.FLOAT
    frames = (history,) * (history > 1)
    nodes = [
        helper.make_node("Slice", ["seen", "from", "to", "row"], ["others"]),
        helper.make_node("Slice", ["others", "zero", "from", "column"], ["present"]),
        helper.make_node("ReduceSum", ["others", "row"], ["sum"], keepdims=0),
        helper.make_node("ReduceSum", ["present", "row"], ["count"], keepdims=0),
        helper.make_node("Div", ["sum", "count"], ["mean" if frames else "values"]),
    ]
    if frames:
        nodes.append(helper.make_node("ReduceSum", ["mean", "from"], ["values"], keepdims=0))
    numbers = {"zero": 0, "from": 1, "to": 7, "row": 1 + len(frames), "column": 2 + len(frames)}
    arrays = [onnx.numpy_helper.from_array(np.array([n]), name) for name, n in numbers.items()]
    inputs = [helper.make_tensor_value_info("seen", kind, ["batch", *frames, 7, 5])]
    outputs = [helper.make_tensor_value_info("values", kind, ["batch", 5])]
    graph = helper.make_graph(nodes, "policy", inputs, outputs, arrays)
    made = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=9)
    helper.set_model_props(made, {"history": str(history)} if frames else {})
    onnx.save(made, path)
    return path


def test_a_network_that_masks_absent_vehicles_is_asked_about_real_observations(
    tmp_path: Path,
) -> None:
    policy = OnnxPolicy(mean_over_the_others(tmp_path / "mean.onnx"))
    for rule in agent_rules(policy):
        rule()


def test_a_network_that_fails_at_the_first_decision_is_rejected(tmp_path: Path) -> None:
    with pytest.raises(ModelError, match="returns values that are NaN"):
        OnnxPolicy(mean_over_the_others(tmp_path / "mean.onnx", history=3))


def test_the_attention_of_pytorch_is_taken(tmp_path: Path) -> None:
    torch = pytest.importorskip("torch")

    class Attends(torch.nn.Module):  # type: ignore[misc,name-defined]
        def __init__(self) -> None:
            super().__init__()
            self.embed, self.head = torch.nn.Linear(5, 8), torch.nn.Linear(8, 5)
            self.attention = torch.nn.MultiheadAttention(8, 2, batch_first=True)

        def forward(self, seen):  # type: ignore[no-untyped-def]
            rows = self.embed(seen)
            absent = seen[..., 0] == 0
            attended, _ = self.attention(rows, rows, rows, key_padding_mask=absent)
            return self.head(attended[:, 0])

    torch.manual_seed(0)
    network, path = Attends().eval(), tmp_path / "attends.onnx"
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        torch.onnx.export(
            network,
            torch.zeros(2, 7, 5),
            path,
            dynamo=False,
            input_names=["observations"],
            dynamic_axes={"observations": [0]},
        )
    seen = np.random.default_rng(0).uniform(-1, 1, (90, 7, 5)).astype(np.float32)
    seen[:, 0, 0], seen[:45, 3:] = 1.0, 0.0
    with torch.no_grad():
        expected = network(torch.from_numpy(seen)).numpy()
    np.testing.assert_allclose(
        OnnxPolicy(path).values_and_memory(seen)[0], expected, rtol=0, atol=1e-5
    )


def test_it_has_the_speed_steps_that_the_file_says(network_file: NetworkFile) -> None:
    assert OnnxPolicy(network_file()).actions == DEFAULT_ACTIONS
    path = network_file(metadata={"target_speed_steps_mps": "[0.25, 0.5, 1, 2]"})
    policy = OnnxPolicy(path)
    assert policy.actions == with_speed_steps(0.25, 0.5, 1.0, 2.0)
    assert pickle.loads(pickle.dumps(policy)).actions == policy.actions
    path = network_file(metadata={"target_speed_steps_mps": json.dumps([1.0] * 100)})
    assert OnnxPolicy(path).actions == with_speed_steps(*[1.0] * 100)


def test_continuous_actions_are_the_output_within_their_range(network_file: NetworkFile) -> None:
    weights = np.random.default_rng(1).normal(size=(35, 2)).astype(np.float32)
    policy = OnnxPolicy(network_file(weights, metadata={"actions": "continuous"}))
    observations = np.random.default_rng(2).uniform(-1, 1, (64, 7, 5)).astype(np.float32)
    expected = np.clip(observations.reshape(64, 35) @ weights, -1, 1)
    assert policy.actions == "continuous"
    np.testing.assert_allclose(policy.decide(observations), expected, rtol=0, atol=1e-5)
    assert (np.abs(expected) == 1).any()
    for rule in agent_rules(policy):
        rule()


def test_the_number_of_outputs_fits_the_kind_of_actions(network_file: NetworkFile) -> None:
    with pytest.raises(ModelError, match=r"\(batch, 5\), or \(batch, 2\) with the metadata 'acti"):
        OnnxPolicy(network_file(np.zeros((35, 2))))
    path = network_file(np.zeros((35, 5)), metadata={"actions": "continuous"})
    with pytest.raises(ModelError, match=r"one float32 output \(batch, 2\)$"):
        OnnxPolicy(path)


def test_it_sees_what_the_file_says(network_file: NetworkFile) -> None:
    assert OnnxPolicy(network_file()).observation == neighbours
    path = network_file(metadata={"observation": "neighbours: (7, 5) float32, rows self"})
    assert OnnxPolicy(path).observation == neighbours
    wide = Kinematics(vehicles_count=10, absolute=True, features_range={"x": (0, 99)})
    path = network_file(inputs=50, metadata={"observation": described(wide)})
    policy = OnnxPolicy(path)
    assert policy.observation == wide
    for rule in agent_rules(policy):
        rule()


def test_a_network_of_another_width_than_its_observation_is_named(
    network_file: NetworkFile,
) -> None:
    for said, wanted in (
        ({"observation": '{"type": "Kinematics"}'}, r"\(batch, 25\) or \(batch, 5, 5\)"),
        ({"history": "2"}, r"\(batch, 70\) or \(batch, 2, 7, 5\)"),
    ):
        with pytest.raises(ModelError, match=f"expected one float32 input {wanted}"):
            OnnxPolicy(network_file(metadata=said))


def test_a_missing_file_is_named(tmp_path: Path) -> None:
    with pytest.raises(ModelError, match=r"none\.onnx: cannot be read: No such.*CHECKPOINT\.zip"):
        OnnxPolicy(tmp_path / "none.onnx")
    checkpoint = tmp_path / "none.zip"
    checkpoint.touch()
    with pytest.raises(ModelError, match=f"charms-bench export {checkpoint} --to {tmp_path}"):
        OnnxPolicy(tmp_path / "none.onnx")


def with_mask(path: Path, width: int = 5) -> Path:
    """The network with a second input, which is added to its values a hundredfold."""
    onnx = pytest.importorskip("onnx")
    model = onnx.load(path)
    model.graph.node[-1].output[0] = "unmasked"
    mask = onnx.helper.make_tensor_value_info("action_mask", 1, ["batch", width])
    model.graph.input.append(mask)
    factor = onnx.numpy_helper.from_array(np.array(100, dtype=np.float32), "factor")
    model.graph.initializer.append(factor)
    for kind, names, out in (
        ("Mul", ["action_mask", "factor"], "bonus"),
        ("Add", ["unmasked", "bonus"], "values"),
    ):
        model.graph.node.append(onnx.helper.make_node(kind, names, [out]))
    onnx.save(model, path)
    return path


def test_a_network_that_takes_the_action_mask_gets_it(network_file: NetworkFile) -> None:
    weights = np.random.default_rng(1).normal(size=(35, 5)).astype(np.float32)
    policy = OnnxPolicy(with_mask(network_file(weights)))
    assert policy.observation == Neighbours(action_mask=True)
    seen = np.random.default_rng(2).uniform(-1, 1, (700, 8, 5)).astype(np.float32)
    seen[:, 7] = np.random.default_rng(3).integers(0, 2, (700, 5))
    expected = (seen[:, :7].reshape(700, 35) @ weights + 100 * seen[:, 7]).argmax(axis=1)
    assert (policy.decide(seen) == expected).all()
    for rule in agent_rules(policy):
        rule()


def test_a_mask_that_no_observation_has_is_named(network_file: NetworkFile) -> None:
    with pytest.raises(ModelError, match=r"beside them, an input action_mask \(batch, 5\)"):
        OnnxPolicy(with_mask(network_file(), width=1))
    path = with_mask(network_file(inputs=25, metadata={"observation": '{"type": "Kinematics"}'}))
    with pytest.raises(ModelError, match="put the mask into the network instead"):
        OnnxPolicy(path)
