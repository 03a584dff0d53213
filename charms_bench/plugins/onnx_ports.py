"""What the inputs and outputs of a network are for.

An input named `action_mask` receives action masks, an input named `noise` uniform random numbers,
and an input named `style` the numbers of the style in which the network is to drive. Of the other
inputs, the first is the observation, and each further one is a state. Of the outputs, the first is
the values, and the further ones are the next states, in the order of the inputs. A state has one
free dimension, the vehicles: `(batch, width)`, or `(layers, batch, width)` as in the LSTM and GRU
of ONNX and PyTorch.
"""

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from charms_bench.world.scene import Floats

Port = tuple[str, str, tuple[Any, ...]]
"""The name, type and shape of an input or output."""
Arrays = dict[str, NDArray[np.float32]]
"""The inputs of a network, by name."""

MASK_INPUT = "action_mask"
NOISE_INPUT = "noise"
STYLE_INPUT = "style"
WIDEST = 100_000
"""Numbers in an observation, more than any observation has."""
MEMORY_LIMIT = 4_096
"""Most numbers in a vehicle's memory, and most random numbers for a decision: 32 KiB."""
_FLOAT = "tensor(float)"
_NAMED = MASK_INPUT, NOISE_INPUT, STYLE_INPUT
_NOTHING = (0,), 0
"""The shape of a vehicle's part of an input that is not there, and which dimension is vehicles."""


@dataclass(frozen=True)
class Signature:
    """What a network says of itself."""

    inputs: tuple[Port, ...]
    outputs: tuple[Port, ...]
    metadata: Mapping[str, str]
    problem: str = ""
    """Why it cannot be computed; empty if it can, or if its ports have no roles."""


@dataclass(frozen=True)
class State:
    """A state of a network."""

    name: str
    """Of its input."""
    shape: tuple[int, ...]
    """Of one vehicle's state."""
    axis: int
    """The dimension of the input that is the vehicles."""


@dataclass(frozen=True)
class Roles:
    """What the ports of a network are for."""

    seen: str
    """The name of the input that receives the observations."""
    shape: tuple[int, ...]
    """Of one observation in that input."""
    outputs: int
    """The number of values per vehicle."""
    mask: int
    """The number of meta-actions in the mask that it receives; 0 without a mask."""
    noise: int
    """The number of random numbers per vehicle."""
    style: int
    """The number of numbers of a style; 0 if the network is given none."""
    states: tuple[State, ...]

    @property
    def memory(self) -> int:
        """The width of a vehicle's memory: its states, flattened, in the order of the inputs."""
        return sum(math.prod(state.shape) for state in self.states)

    def states_of(self, memory: Floats) -> Arrays:
        """The states, by input, that the memory (M, memory) of M vehicles consists of."""
        ends = np.cumsum([math.prod(state.shape) for state in self.states])
        parts = np.split(memory.astype(np.float32), ends[:-1], axis=1)
        return {
            state.name: np.ascontiguousarray(
                np.moveaxis(part.reshape(-1, *state.shape), 0, state.axis)
            )
            for state, part in zip(self.states, parts, strict=True)
        }

    def memory_of(self, states: Iterable[NDArray[np.float32]]) -> Floats:
        """The memory (M, memory) of M vehicles whose states are these."""
        parts = [
            np.moveaxis(found, state.axis, 0).reshape(found.shape[state.axis], -1)
            for state, found in zip(self.states, states, strict=True)
        ]
        return np.concatenate(parts, axis=1, dtype=np.float64)


def roles_of(found: Signature) -> Roles | None:
    """What the ports of a network are for; None if they have no such roles."""
    named = {port[0]: _of_one(port, axes=(0,)) for port in found.inputs if port[0] in _NAMED}
    others = [port for port in found.inputs if port[0] not in named]
    of_named = [named.get(name, _NOTHING) for name in _NAMED]
    mask, noise, style = (one[0][0] if one and len(one[0]) == 1 else -1 for one in of_named)
    if min(mask, noise, style) < 0:
        return None
    if not len(others) == len(found.outputs) > 0:
        return None
    (seen, *states), (values, *after) = others, found.outputs
    observed, valued = _of_one(seen, axes=(0,)), values[2][1:]
    if observed is None or values[1] != _FLOAT or [type(size) for size in valued] != [int]:
        return None
    remembered = []
    for state, following in zip(states, after, strict=True):
        one = _of_one(state, axes=(0, 1))
        if one is None or not _is_next(state, following):
            return None
        remembered.append(State(state[0], *one))
    numbers = observed[0], valued[0], mask, noise, style
    roles = Roles(seen[0], *numbers, tuple(remembered))
    return roles if max(roles.memory, roles.noise) <= MEMORY_LIMIT else None


def _of_one(port: Port, axes: tuple[int, ...]) -> tuple[tuple[int, ...], int] | None:
    """The shape of one vehicle's part of an input, and which dimension, of `axes`, is vehicles."""
    _, kind, sizes = port
    free = [axis for axis, size in enumerate(sizes) if not isinstance(size, int)]
    if kind != _FLOAT or len(free) != 1 or free[0] not in axes or len(sizes) < 2:
        return None
    shape = (*sizes[: free[0]], *sizes[free[0] + 1 :])
    return (shape, free[0]) if 0 < math.prod(shape) <= WIDEST else None


def _is_next(state: Port, following: Port) -> bool:
    """Whether an output can be the next value of a state. A size that it leaves open is tried."""
    sizes, then = state[2], following[2]
    return (
        following[1] == _FLOAT
        and len(sizes) == len(then)
        and all(not isinstance(b, int) or a == b for a, b in zip(sizes, then, strict=True))
    )
