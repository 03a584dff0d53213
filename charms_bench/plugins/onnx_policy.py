"""A network in an ONNX file as a policy."""

from functools import cache
from hashlib import sha256
from pathlib import Path
from typing import Any

import numpy as np

from charms_bench.errors import InputError, ModelError
from charms_bench.plugins.agent import Policy
from charms_bench.plugins.onnx_file import problem_of
from charms_bench.world.actions import ACTIONS, Actions
from charms_bench.world.files import read_limited
from charms_bench.world.observations import Observation, observation_described
from charms_bench.world.scene import Observations

SIZE_LIMIT_BYTES = 64 * 2**20
MEMORY_LIMIT_BYTES = 2 * 2**30
"""Of all networks of a process, together with what they compute."""


class OnnxPolicy(Policy):
    """Takes the action of the highest value.

    Nothing but arithmetic runs, in bounded memory; see `onnx_file.OPERATORS`.

    The model is one file with one input, `(batch, rows, columns)` of its observation or
    `(batch, rows * columns)`, and one output `(batch, 5)`, both float32, and runs on one thread.
    Its observation is the one that the file's metadata name, or `neighbours`.

    Args:
        path: The `.onnx` file.
        decision_hz: Decisions a second; by default those in the file's metadata, or 3.

    Raises:
        ModelError: The file is missing, too large, broken, of another shape or not just arithmetic.
    """

    def __init__(self, path: str | Path, decision_hz: float | None = None) -> None:
        self.path = Path(path)
        data = _read(self.path)
        self._sha256 = sha256(data).hexdigest()
        self._session = _session(self.path, data)
        self.observation = _observation(self.path, self._session)
        self._input, self._shape = _input(self.path, self._session, self.observation.shape)
        self.decision_hz = decision_hz or _decision_hz(self.path, self._session)
        self.values(np.zeros((2, *self.observation.shape), dtype=np.float32))

    @property
    def weights_sha256(self) -> str:
        return self._sha256

    def decide(self, observations: Observations) -> Actions:
        actions: Actions = np.argmax(self.values(observations), axis=1)
        return actions

    def values(self, observations: Observations) -> np.ndarray[Any, np.dtype[np.float32]]:
        """The network's output (M, 5) for observations (M, rows, columns).

        Raises:
            ModelError: It cannot be computed, has another shape, or some of it is no number.
        """
        inputs = observations.reshape(-1, *self._shape)
        values: np.ndarray[Any, np.dtype[np.float32]]
        try:
            (values,) = self._session.run(None, {self._input: inputs})
        except Exception as error:  # onnxruntime's errors share no public base
            raise ModelError(f"{self.path}: cannot be computed: {_reason(error)}") from error
        expected = (len(observations), len(ACTIONS))
        if values.shape != expected:
            raise ModelError(f"{self.path}: gives values {values.shape}; expected {expected}")
        if np.isnan(values).any():
            raise ModelError(f"{self.path}: gives values that are no numbers")
        return values

    def __reduce__(self) -> tuple[Any, ...]:
        return type(self), (self.path, self.decision_hz)


def _read(path: Path) -> bytes:
    try:
        data = read_limited(path, SIZE_LIMIT_BYTES)
    except OSError as error:
        raise ModelError(f"{path}: cannot be read: {error.strerror}") from error
    if problem := problem_of(data):
        raise ModelError(f"{path}: {problem}")
    return data


def _session(path: Path, data: bytes) -> Any:
    import onnxruntime

    _bound_memory()
    options = onnxruntime.SessionOptions()
    options.add_session_config_entry("session.use_env_allocators", "1")
    options.intra_op_num_threads = options.inter_op_num_threads = 1
    options.execution_mode = onnxruntime.ExecutionMode.ORT_SEQUENTIAL
    options.log_severity_level = 4  # what is wrong with the model is said in the exception
    try:
        return onnxruntime.InferenceSession(data, options, providers=["CPUExecutionProvider"])
    except Exception as error:  # onnxruntime's errors share no public base
        raise ModelError(f"{path}: is no model onnxruntime can load: {_reason(error)}") from error


@cache
def _bound_memory() -> None:
    """Gives this process's networks one place to take their memory from."""
    import onnxruntime

    kind = onnxruntime.OrtAllocatorType.ORT_ARENA_ALLOCATOR
    memory = onnxruntime.OrtMemoryInfo("Cpu", kind, 0, onnxruntime.OrtMemType.DEFAULT)
    arena = onnxruntime.OrtArenaCfg({"max_mem": MEMORY_LIMIT_BYTES})
    onnxruntime.create_and_register_allocator(memory, arena)


def _reason(error: Exception) -> str:
    """What an error of onnxruntime's says, without where in its sources it arose."""
    text = str(error).splitlines()[0]
    if "BFCArena" in text:
        return f"it takes more than {MEMORY_LIMIT_BYTES:,} bytes of memory"
    return text.rpartition("Status Message: ")[2][:300]


def _decision_hz(path: Path, session: Any) -> float:
    """Decisions a second by the file's metadata."""
    said = session.get_modelmeta().custom_metadata_map.get("decision_hz", "3")
    try:
        hz = float(said)
    except ValueError:
        hz = 0.0
    if not 0 < hz <= 1000:
        raise ModelError(f"{path}: its metadata say decision_hz '{said}'; expected a positive rate")
    return hz


def _observation(path: Path, session: Any) -> Observation:
    """What the network sees, by the file's metadata."""
    said = session.get_modelmeta().custom_metadata_map.get("observation", "neighbours")
    try:
        return observation_described(said)
    except InputError as error:
        raise ModelError(f"{path}: its metadata: {error}") from error


def _input(path: Path, session: Any, shape: tuple[int, int]) -> tuple[str, tuple[int, ...]]:
    """The input's name and its shape after the batch."""
    rows, columns = shape
    inputs = [(node.name, node.type, node.shape) for node in session.get_inputs()]
    outputs = [(node.name, node.type, node.shape) for node in session.get_outputs()]
    found = f"inputs {inputs}, outputs {outputs}"
    wanted = (
        f"one float32 input (batch, {rows * columns}) or (batch, {rows}, {columns}) with a free "
        f"batch, and one float32 output (batch, {len(ACTIONS)})"
    )
    fits = (
        len(inputs) == len(outputs) == 1
        and inputs[0][1] == outputs[0][1] == "tensor(float)"
        and inputs[0][2][1:] in ([rows * columns], [rows, columns])
        and not isinstance(inputs[0][2][0], int)
        and outputs[0][2][1:] == [len(ACTIONS)]
    )
    if not fits:
        raise ModelError(f"{path}: has {found}; expected {wanted}")
    return inputs[0][0], tuple(inputs[0][2][1:])
