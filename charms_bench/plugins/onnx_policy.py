"""A policy that is a network in an ONNX file."""

from hashlib import sha256
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from charms_bench.errors import InputError, ModelError
from charms_bench.foundation.files import read_limited
from charms_bench.foundation.workers import is_child
from charms_bench.plugins.agent import Policy
from charms_bench.plugins.onnx_file import problem_of
from charms_bench.plugins.onnx_session import (
    MASK_INPUT,
    Ports,
    Signature,
    compute,
    inputs_of,
    open_session,
    signature_of,
    tried,
)
from charms_bench.world.actions import ActionKind, Actions, outputs_of
from charms_bench.world.kinematics_observation import Kinematics
from charms_bench.world.observations import ACTION_MASK, Neighbours, observation_described
from charms_bench.world.scene import Observations

SIZE_LIMIT_BYTES = 64 * 2**20
ROWS_AT_ONCE = 512
"""Observations in one call of onnxruntime. A layer of 256 units then takes 512 KiB, so intermediate
results stay in the cache of one core; a call costs as much as about ten observations."""


class OnnxPolicy(Policy):
    """Chooses the meta-action with the highest value, or the continuous action that is the output.

    The network can only do arithmetic, in bounded memory and on one thread; see
    `onnx_file.OPERATORS`. A worker tries it before this process opens it; see `onnx_session`. The
    file has one input, `(batch, rows, columns)` of the observation or `(batch, rows * columns)`,
    and one output, both float32. The output is `(batch, 5)`, or `(batch, 2)` if the file's metadata
    say `actions: continuous`; it is then clipped to [-1, 1]. The metadata also name the
    observation; the default is `neighbours`. A network with a second input named `action_mask`,
    `(batch, 5)` float32, receives the vehicles' action masks there; see `world.action_mask`.

    Args:
        path: The `.onnx` file.
        decision_hz: Decisions per second; by default the rate in the file's metadata, or 3.

    Raises:
        ModelError: The file is missing, too large or broken, its inputs or outputs have other
            shapes, it has operators that are not arithmetic, or it takes too long.
    """

    def __init__(self, path: str | Path, decision_hz: float | None = None) -> None:
        self.path = Path(path)
        try:
            data = read_limited(self.path, SIZE_LIMIT_BYTES)
        except OSError as error:
            missing = isinstance(error, FileNotFoundError)
            remedy = f"; {_made_by(self.path)}" if missing else ""
            raise ModelError(f"{self.path}: cannot be read: {error.strerror}{remedy}") from error
        if problem := problem_of(data):
            raise ModelError(f"{self.path}: {problem}")
        self._sha256 = sha256(data).hexdigest()
        self._data: bytes | None = data
        self._opened: Any = None
        try:
            found = signature_of(self._session) if is_child() else tried(data)
        except ModelError as error:
            raise ModelError(f"{self.path}: {error}") from error
        try:
            self.observation = observation_described(
                found.metadata.get("observation", "neighbours")
            )
        except InputError as error:
            raise ModelError(f"{self.path}: metadata: {error}") from error
        if found.metadata.get("actions") == "continuous":
            self.actions = "continuous"
        self._outputs = outputs_of(self.actions)
        shape = self.observation.shape
        self._rows = shape[0]
        self._input, self._shape = _input(self.path, found, shape, self._outputs)
        self._takes_mask = inputs_of(found)[1]
        if self._takes_mask:
            self.observation = _with_mask(self.path, self.observation, self.actions)
        if decision_hz is None:
            decision_hz = _decision_hz(self.path, found.metadata.get("decision_hz", "3"))
        self.decision_hz = decision_hz
        if is_child():
            self.values(np.zeros((2, *self.observation.shape), dtype=np.float32))
        elif found.problem:
            raise ModelError(f"{self.path}: {found.problem}")

    @property
    def _session(self) -> Any:
        """The open network; it is opened when it is first needed."""
        if self._data is not None:
            self._opened, self._data = open_session(self._data), None
        return self._opened

    @property
    def weights_sha256(self) -> str:
        return self._sha256

    def decide(self, observations: Observations) -> Actions:
        return self.actions_of(self.values(observations))

    def actions_of(self, values: NDArray[np.float32]) -> Actions:
        """The actions (M,) or (M, 2) that the network's output means."""
        if self.actions == "continuous":
            return np.clip(values, -1.0, 1.0)
        return np.asarray(np.argmax(values, axis=1))

    def values(self, observations: Observations) -> NDArray[np.float32]:
        """The network's output, (M, 5) or (M, 2), for observations (M, rows, columns).

        Raises:
            ModelError: It cannot be computed, has another shape, or contains NaN.
        """
        starts = range(0, max(len(observations), 1), ROWS_AT_ONCE)
        parts = [self._values(observations[start : start + ROWS_AT_ONCE]) for start in starts]
        return parts[0] if len(parts) == 1 else np.concatenate(parts)

    def _values(self, observations: Observations) -> NDArray[np.float32]:
        inputs = {self._input: observations[:, : self._rows].reshape(-1, *self._shape)}
        if self._takes_mask:
            inputs[MASK_INPUT] = observations[:, ACTION_MASK]
        try:
            return compute(self._session, inputs, self._outputs)
        except ModelError as error:
            raise ModelError(f"{self.path}: {error}") from error

    def __reduce__(self) -> tuple[Any, ...]:
        return type(self), (self.path, self.decision_hz)


def _with_mask(path: Path, seen: Neighbours | Kinematics, kind: ActionKind) -> Neighbours:
    """The observation of a network that receives the action mask as an input of its own."""
    if isinstance(seen, Kinematics) or kind != "meta":
        raise ModelError(
            f"{path}: has the input {MASK_INPUT}, which a network has with meta-actions and the "
            "observation neighbours or paper_neighbours only; put the mask into the network instead"
        )
    return seen.model_copy(update={"action_mask": True})


def _made_by(path: Path) -> str:
    """How to make a network from its checkpoint."""
    command = f"charms-bench export {path.stem}.zip --to {path.parent}"
    return f"`{command}` makes it from a checkpoint of Stable-Baselines3"


def _decision_hz(path: Path, said: str) -> float:
    try:
        hz = float(said)
    except ValueError:
        hz = 0.0
    if not 0 < hz <= 1000:
        raise ModelError(f"{path}: metadata: decision_hz is '{said}'; expected a positive rate")
    return hz


def _input(
    path: Path, found: Signature, shape: tuple[int, int], count: int
) -> tuple[str, tuple[int, ...]]:
    """The input's name and its shape after the batch."""
    rows, columns = shape
    outputs = found.outputs
    inputs, _ = inputs_of(found)
    other = ", or (batch, 2) with the metadata 'actions: continuous'"
    wanted = (
        f"one float32 input (batch, {rows * columns}) or (batch, {rows}, {columns}) with a free "
        f"batch, and one float32 output (batch, {count})"
        f"{other if count == outputs_of('meta') else ''}"
        + (
            f"; a second input, {MASK_INPUT}, is float32 (batch, 5)"
            if len(found.inputs) > 1
            else ""
        )
    )
    fits = (
        len(inputs) == len(outputs) == 1
        and inputs[0][1] == outputs[0][1] == "tensor(float)"
        and inputs[0][2][1:] in ((rows * columns,), (rows, columns))
        and not isinstance(inputs[0][2][0], int)
        and outputs[0][2][1:] == (count,)
    )
    if not fits:
        has = f"inputs {_listed(found.inputs)}, outputs {_listed(outputs)}"
        raise ModelError(f"{path}: has {has}; expected {wanted}")
    return inputs[0][0], inputs[0][2][1:]


def _listed(ports: Ports) -> str:
    return str([(name, kind, list(shape)) for name, kind, shape in ports])
