"""The input of a network: the frames of an observation, their order, and a normalisation."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray
from onnx import NodeProto, TensorProto, ValueInfoProto, helper


@dataclass(frozen=True)
class Graph:
    """An ONNX graph while it is put together."""

    nodes: list[NodeProto] = field(default_factory=list)
    arrays: dict[str, NDArray[Any]] = field(default_factory=dict)
    constants: dict[str, float] = field(default_factory=dict)
    """Further arrays, which follow the others in the file."""
    inputs: list[ValueInfoProto] = field(default_factory=list)
    outputs: list[ValueInfoProto] = field(default_factory=list)

    def add(self, operator: str, inputs: Sequence[str], output: str, **attributes: Any) -> str:
        """Adds a node with one output, and returns the name of the output."""
        self.nodes.append(helper.make_node(operator, inputs, [output], **attributes))
        return output

    def constant(self, value: float) -> str:
        """Adds a number, and returns its name."""
        self.constants[name := f"number_{value:g}"] = value
        return name


def port(name: str, *sizes: str | int) -> ValueInfoProto:
    """An input or an output of a graph."""
    return helper.make_tensor_value_info(name, TensorProto.FLOAT, sizes)


@dataclass(frozen=True)
class Given:
    """What happens between the input of an ONNX file and the network."""

    history: int = 1
    """The number of observations in the input, the newest last."""
    repeats: bool = False
    """Whether the first observation of an episode also stands for the time before it, as with
    Gymnasium's `FrameStackObservation`; otherwise, zeros do."""
    mean: NDArray[np.float64] | None = None
    """Of each number of the input, which is subtracted; None without a normalisation."""
    deviation: NDArray[np.float64] | None = None
    """Of each number of the input, by which the difference is divided."""
    clip: float = np.inf
    """The largest absolute value of the quotient."""

    def of(self, seen: NDArray[np.float32]) -> NDArray[np.float32]:
        """The network's input (M, numbers) for observations (M, history, numbers)."""
        frames = seen.copy()
        if self.repeats:
            for k in reversed(range(self.history - 1)):
                is_before = ~frames[:, k].any(axis=1)
                frames[is_before, k] = frames[is_before, k + 1]
        flat = frames.reshape(len(frames), -1)
        if self.mean is None or self.deviation is None:
            return flat
        values = (flat - self.mean) / self.deviation
        return np.asarray(np.clip(values, -self.clip, self.clip), np.float32)

    def add_to(self, graph: Graph, last: str) -> str:
        """Adds what computes `of` the flat input `last`; returns the result."""
        arrays = graph.arrays
        if self.repeats and self.history > 1:
            frames = [f"frame_{k}" for k in range(self.history)]
            graph.nodes.append(helper.make_node("Split", [last], frames, axis=1))
            arrays["nothing"] = np.zeros(1, np.float32)
            for k in reversed(range(self.history - 1)):
                size = graph.add("ReduceL1", [frames[k]], f"size_{k}", axes=[1])
                found = graph.add("Greater", [size, "nothing"], f"is_frame_{k}")
                frames[k] = graph.add("Where", [found, frames[k], frames[k + 1]], f"filled_{k}")
            last = graph.add("Concat", frames, "frames", axis=1)
        if self.mean is not None and self.deviation is not None:
            arrays["mean"] = self.mean.astype(np.float32)
            arrays["deviation"] = self.deviation.astype(np.float32)
            graph.add("Sub", [last, "mean"], "centred")
            last = graph.add("Div", ["centred", "deviation"], "normalised")
            if np.isfinite(self.clip):
                arrays["least"] = np.array(-self.clip, np.float32)
                arrays["most"] = np.array(self.clip, np.float32)
                last = graph.add("Clip", [last, "least", "most"], "clipped")
        return last
