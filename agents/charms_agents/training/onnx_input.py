"""What a network is given of the observations: frames, their order, and a normalisation."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from onnx import NodeProto, helper

Arrays = dict[str, NDArray[Any]]


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
        """What the network is given (M, numbers) of observations (M, history, numbers)."""
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

    def add_to(self, nodes: list[NodeProto], arrays: Arrays, last: str) -> str:
        """Adds the nodes and arrays that compute `of` the flat input `last`; returns the result."""
        if self.repeats and self.history > 1:
            frames = [f"frame_{k}" for k in range(self.history)]
            nodes.append(helper.make_node("Split", [last], frames, axis=1))
            arrays["nothing"] = np.zeros(1, np.float32)
            for k in reversed(range(self.history - 1)):
                size, found, filled = f"size_{k}", f"is_frame_{k}", f"filled_{k}"
                nodes.append(helper.make_node("ReduceL1", [frames[k]], [size], axes=[1]))
                nodes.append(helper.make_node("Greater", [size, "nothing"], [found]))
                nodes.append(helper.make_node("Where", [found, frames[k], frames[k + 1]], [filled]))
                frames[k] = filled
            last = "frames"
            nodes.append(helper.make_node("Concat", frames, [last], axis=1))
        if self.mean is not None and self.deviation is not None:
            arrays["mean"] = self.mean.astype(np.float32)
            arrays["deviation"] = self.deviation.astype(np.float32)
            nodes.append(helper.make_node("Sub", [last, "mean"], ["centred"]))
            last = "normalised"
            nodes.append(helper.make_node("Div", ["centred", "deviation"], [last]))
            if np.isfinite(self.clip):
                arrays["least"], arrays["most"] = (
                    np.array(sign * self.clip, np.float32) for sign in (-1, 1)
                )
                nodes.append(helper.make_node("Clip", [last, "least", "most"], ["clipped"]))
                last = "clipped"
        return last
