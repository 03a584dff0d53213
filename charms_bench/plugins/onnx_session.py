"""Opens networks in onnxruntime: first in a worker under limits, and then in this process.

A file of a few KB can take hours to load or to compute, or end its process. Neither an exception
nor Ctrl-C can stop such a computation, because it is not Python code. So every network is first
opened and computed once in a worker, which can be killed. A process that another process has
started, like a worker of a run, opens networks directly.
"""

import math
import os
import resource
import signal
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import replace
from functools import cache
from hashlib import sha256
from typing import Any

import numpy as np
from numpy.typing import NDArray

from charms_bench.errors import InputError, ModelError
from charms_bench.foundation.workers import Died, ask
from charms_bench.plugins.onnx_ports import (
    MASK_INPUT,
    NOISE_INPUT,
    STYLE_INPUT,
    Arrays,
    Roles,
    Signature,
    roles_of,
)
from charms_bench.world.highway_env_observation import HighwayEnv
from charms_bench.world.observations import observation_described
from charms_bench.world.scene import Floats

MEMORY_LIMIT_BYTES = 2 * 2**30
"""Memory of all networks of a process, including their intermediate results."""
PROCESSOR_LIMIT_S = 5
"""Processor time in which a network is loaded and computed; usually, it is a few milliseconds."""
TRIAL_LIMIT_S = 120.0
"""The same in time that passes, including the start of the worker on a busy machine."""
OVERHEAD_BYTES = 2**30
"""Memory that loading takes beside the memory of the network."""
TRIED_ROWS = 64
"""Random observations for which a network is computed."""
TRIED_SCALES = (1.0, 100.0)
"""Standard deviations of these observations."""
ROWS_WITH_MEMORY = 64
"""Vehicles in each call of a network with memory. The rounding of a sum may depend on the size of
the batch, so a memory would otherwise come to depend on the other vehicles of the call."""

_signatures: dict[str, Signature | str] = {}
"""What was found about the networks that were tried, or why they cannot be used, by their hash."""


def tried(data: bytes) -> Signature:
    """The signature of a network, which a worker tries first; raises a `ModelError`."""
    key = sha256(data).hexdigest()
    if key not in _signatures:
        try:
            _signatures[key] = ask(_try, data, TRIAL_LIMIT_S)
        except ModelError as error:
            _signatures[key] = str(error)
        except Died as died:
            _signatures[key] = _fate(died)
    found = _signatures[key]
    if isinstance(found, str):
        raise ModelError(found)
    return found


def _fate(died: Died) -> str:
    if died.took_too_long or died.signal == signal.SIGXCPU:
        return (
            f"takes more than {PROCESSOR_LIMIT_S} s of processor time to load and to compute; "
            "expected a network that decides within milliseconds"
        )
    if died.signal == signal.SIGKILL:
        return "ends its process when it is tried (SIGKILL, as when memory runs out)"
    how = died.signal.name if died.signal else "without a signal"
    why = ": it divides the smallest integer by -1" if died.signal == signal.SIGFPE else ""
    return f"ends its process when it is tried ({how}{why})"


def _try(data: bytes) -> Signature:
    """Opens a network, and computes it for observations like real ones and for random ones."""
    import onnxruntime  # noqa: F401  # its memory is not the network's

    with _limits():
        session = open_session(data)
        found = signature_of(session)
        if (roles := roles_of(found)) is None:
            return found
        rng = np.random.default_rng(0)
        inputs, memory = _question(roles, rng, TRIED_ROWS, 0.0)
        inputs[roles.seen] = like_real(roles.shape, found.metadata, rng, TRIED_ROWS)
        try:
            compute(session, roles, inputs, memory)
        except ModelError as error:
            return replace(found, problem=str(error))
        for scale in TRIED_SCALES:
            with suppress(ModelError):  # no vehicle has such an observation
                compute(session, roles, *_question(roles, rng, TRIED_ROWS, scale))
    return found


def _question(
    roles: Roles, rng: np.random.Generator, rows: int, scale: float
) -> tuple[Arrays, Floats]:
    """Random inputs and memory of this scale; for 0, those of the beginning of an episode."""
    inputs = {roles.seen: rng.normal(scale=scale, size=(rows, *roles.shape)).astype(np.float32)}
    if roles.mask:
        inputs[MASK_INPUT] = np.ones((rows, roles.mask), dtype=np.float32)
    if roles.noise:
        inputs[NOISE_INPUT] = rng.random((rows, roles.noise), np.float32) * min(scale, 1)
    if roles.style:
        inputs[STYLE_INPUT] = rng.random((rows, roles.style), np.float32)
    return inputs, rng.normal(scale=scale, size=(rows, roles.memory))


def like_real(
    shape: tuple[int, ...], metadata: Mapping[str, str], rng: np.random.Generator, rows: int
) -> NDArray[np.float32]:
    """Inputs (rows, *shape) like those that vehicles have; zeros if the metadata do not fit.

    A vehicle sees itself and at least one other vehicle; the row of a vehicle that is absent is
    zeros. With history, half of the vehicles see the first observation of their episode.
    """
    nothing = np.zeros((rows, *shape), np.float32)
    try:
        observation = observation_described(metadata.get("observation", "neighbours"))
    except InputError:
        return nothing  # which the policy says
    if isinstance(observation, HighwayEnv):
        return rng.uniform(-1.0, 1.0, nothing.shape).astype(np.float32)
    count, columns = observation.shape
    history = math.prod(shape) // (count * columns)
    if history * count * columns != math.prod(shape):
        return nothing
    seen = rng.uniform(-1.0, 1.0, (rows, history, count, columns))
    seen[..., 0] = 1.0
    seen[..., 2:, :] *= rng.random((rows, history, count - 2, 1)) < 0.5
    seen[: rows // 2, :-1] = 0.0
    return seen.reshape(nothing.shape).astype(np.float32)


@contextmanager
def _limits() -> Iterator[None]:
    """Limits the processor time and the memory of this process to what a network may take."""
    used = resource.getrusage(resource.RUSAGE_SELF)
    most = {resource.RLIMIT_CPU: math.ceil(used.ru_utime + used.ru_stime) + PROCESSOR_LIMIT_S}
    with suppress(OSError), open("/proc/self/statm") as statm:  # only Linux has it
        pages = int(statm.read().split()[0])
        size = pages * os.sysconf("SC_PAGE_SIZE")
        most[resource.RLIMIT_AS] = size + MEMORY_LIMIT_BYTES + OVERHEAD_BYTES
    before = {kind: resource.getrlimit(kind) for kind in most}
    for kind, limit in most.items():
        others = [each for each in before[kind] if each != resource.RLIM_INFINITY]
        resource.setrlimit(kind, (min([limit, *others]), before[kind][1]))
    try:
        yield
    finally:
        for kind, limits in before.items():
            resource.setrlimit(kind, limits)


def open_session(data: bytes) -> Any:
    """Opens a network in this process; raises a `ModelError` that does not name the file."""
    import onnxruntime

    _bound_memory()
    options = onnxruntime.SessionOptions()
    options.add_session_config_entry("session.use_env_allocators", "1")
    options.intra_op_num_threads = options.inter_op_num_threads = 1
    options.execution_mode = onnxruntime.ExecutionMode.ORT_SEQUENTIAL
    options.log_severity_level = 4  # the exception says what is wrong
    try:
        return onnxruntime.InferenceSession(data, options, providers=["CPUExecutionProvider"])
    except Exception as error:  # onnxruntime's errors share no public base
        raise ModelError(f"cannot be loaded by onnxruntime: {_reason(error)}") from error


def signature_of(session: Any) -> Signature:
    """Returns the signature of an open network."""
    inputs, outputs = (
        tuple((port.name, port.type, tuple(port.shape)) for port in ports)
        for ports in (session.get_inputs(), session.get_outputs())
    )
    return Signature(inputs, outputs, dict(session.get_modelmeta().custom_metadata_map))


def compute(
    session: Any, roles: Roles, inputs: Arrays, memory: Floats
) -> tuple[NDArray[np.float32], Floats]:
    """The values (M, outputs) of an open network, and the memory (M, memory) that it leaves.

    Args:
        inputs: (M, ...) each; M is at most `ROWS_WITH_MEMORY` if it has states.
        memory: (M, memory).

    Raises a `ModelError` if it cannot be computed, has another shape, contains NaN, or the memory
    is not finite; without the file.
    """
    rows = len(memory)
    if roles.states:
        inputs = {name: _padded(array) for name, array in inputs.items()}
        inputs |= roles.states_of(_padded(memory))
    values: NDArray[np.float32]
    try:
        values, *states = session.run(None, inputs)
    except Exception as error:  # onnxruntime's errors share no public base
        raise ModelError(f"cannot be computed: {_reason(error)}") from error
    if values.shape != (expected := (len(inputs[roles.seen]), roles.outputs)):
        raise ModelError(f"returns values of shape {values.shape}; expected {expected}")
    for state, found in zip(roles.states, states, strict=True):
        if found.shape != (shape := inputs[state.name].shape):
            raise ModelError(
                f"returns a next {state.name} of shape {found.shape}; expected {shape}"
            )
    values = values[:rows]
    if np.isnan(values).any():
        raise ModelError("returns values that are NaN")
    if roles.states:
        memory = roles.memory_of(states)[:rows]
        if not np.isfinite(memory).all():
            raise ModelError("returns a state that is not finite")
    return values, memory


def _padded(array: NDArray[Any]) -> NDArray[Any]:
    """The array with zeros for the vehicles that are missing in its batch."""
    missing = ROWS_WITH_MEMORY - len(array)
    return np.concatenate([array, np.zeros((missing, *array.shape[1:]), array.dtype)])


@cache
def _bound_memory() -> None:
    """Makes all networks of this process share one memory arena of limited size."""
    import onnxruntime

    kind = onnxruntime.OrtAllocatorType.ORT_ARENA_ALLOCATOR
    memory = onnxruntime.OrtMemoryInfo("Cpu", kind, 0, onnxruntime.OrtMemType.DEFAULT)
    arena = onnxruntime.OrtArenaCfg({"max_mem": MEMORY_LIMIT_BYTES})
    onnxruntime.create_and_register_allocator(memory, arena)


def _reason(error: Exception) -> str:
    """The message of onnxruntime's error, without its source location."""
    text = (str(error) or type(error).__name__).splitlines()[0]
    if "BFCArena" in text or "bad_alloc" in text or isinstance(error, MemoryError):
        return f"it needs more than {MEMORY_LIMIT_BYTES:,} bytes of memory"
    return text.rpartition("Status Message: ")[2][:300]
