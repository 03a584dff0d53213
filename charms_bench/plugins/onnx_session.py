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
from dataclasses import dataclass, replace
from functools import cache
from hashlib import sha256
from typing import Any

import numpy as np
from numpy.typing import NDArray

from charms_bench.errors import ModelError
from charms_bench.foundation.workers import Died, ask
from charms_bench.world.actions import ACTIONS

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
WIDEST = 10_000
"""Numbers in an observation, far more than any observation has."""
MASK_INPUT = "action_mask"
"""The name of the second input of a network that takes the action mask."""

Ports = tuple[tuple[str, str, tuple[Any, ...]], ...]
"""The name, type and shape of each input or output."""


@dataclass(frozen=True)
class Signature:
    """What a network says of itself."""

    inputs: Ports
    outputs: Ports
    metadata: Mapping[str, str]
    problem: str = ""
    """Why it cannot be computed; empty if it can, or if its inputs are not observations."""


_signatures: dict[str, Signature | str] = {}
"""What was found about the networks that were tried, or why they cannot be used, by their hash."""


def tried(data: bytes) -> Signature:
    """Returns the signature of a network, which a worker tries the first time.

    Raises:
        ModelError: It cannot be loaded, ends its process, or takes too long; without the file.
    """
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
    """Opens a network, and computes it for zeros and for random observations."""
    import onnxruntime  # noqa: F401  # its memory is not the network's

    with _limits():
        session = open_session(data)
        found = signature_of(session)
        if (shapes := _shapes(found)) is None:
            return found
        name, row, width = shapes

        def inputs(seen: NDArray[np.float32]) -> dict[str, NDArray[np.float32]]:
            masks = np.ones((len(seen), len(ACTIONS)), dtype=np.float32)
            return {name: seen} | ({MASK_INPUT: masks} if inputs_of(found)[1] else {})

        try:
            compute(session, inputs(np.zeros((2, *row), dtype=np.float32)), width)
        except ModelError as error:
            return replace(found, problem=str(error))
        rng = np.random.default_rng(0)
        for scale in TRIED_SCALES:
            seen = rng.normal(scale=scale, size=(TRIED_ROWS, *row)).astype(np.float32)
            with suppress(ModelError):  # no vehicle has such an observation
                compute(session, inputs(seen), width)
    return found


def inputs_of(found: Signature) -> tuple[Ports, bool]:
    """The inputs of a network without the action mask (batch, 5), and whether it takes a mask."""
    others = tuple(port for port in found.inputs if port[0] != MASK_INPUT)
    masks = [(kind, row[1:]) for name, kind, row in found.inputs if name == MASK_INPUT]
    if masks == [("tensor(float)", (len(ACTIONS),))] and others:
        return others, True
    return found.inputs, False


def _shapes(found: Signature) -> tuple[str, tuple[int, ...], int] | None:
    """The input's name, the shape of an observation and the number of values, if there are any."""
    seen, _ = inputs_of(found)
    if not len(seen) == len(found.outputs) == 1:
        return None
    (name, kind, row), (_, _, values) = seen[0], found.outputs[0]
    sizes = (*row[1:], *values[1:])
    if kind != "tensor(float)" or len(values) != 2 or not all(isinstance(k, int) for k in sizes):
        return None
    return (name, tuple(row[1:]), values[1]) if 0 < math.prod(row[1:]) <= WIDEST else None


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
    """Opens a network in this process.

    Raises:
        ModelError: onnxruntime cannot load it; without the file.
    """
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
    session: Any, inputs: Mapping[str, NDArray[np.float32]], width: int
) -> NDArray[np.float32]:
    """Returns the output (M, width) of an open network for inputs (M, ...), by their names.

    Raises:
        ModelError: It cannot be computed, has another shape, or contains NaN; without the file.
    """
    values: NDArray[np.float32]
    try:
        (values,) = session.run(None, inputs)
    except Exception as error:  # onnxruntime's errors share no public base
        raise ModelError(f"cannot be computed: {_reason(error)}") from error
    rows = len(next(iter(inputs.values())))
    if values.shape != (expected := (rows, width)):
        raise ModelError(f"returns values of shape {values.shape}; expected {expected}")
    if values.dtype.kind not in "iuf":
        raise ModelError(f"returns values of type {values.dtype}; expected numbers")
    if np.isnan(values).any():
        raise ModelError("returns values that are NaN")
    return values


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
