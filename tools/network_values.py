"""Evaluates a network: `python tools/network_values.py LIBRARY NETWORK OBSERVATIONS OUTPUT`.

LIBRARY is `onnxruntime`, or the type in which NumPy calculates: `float32` or `float64`.
OBSERVATIONS (M, rows, columns) and OUTPUT (M, 5) are `.npy` files. This script imports little,
because `tools/network_margins.py` also runs it on emulated processors.
"""

import sys
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

ROWS_AT_ONCE = 512
Values = NDArray[np.floating]


def by_onnxruntime(network: str) -> Callable[[Values], Values]:
    """The network as onnxruntime calculates it on one thread."""
    import onnxruntime

    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = options.inter_op_num_threads = 1
    session = onnxruntime.InferenceSession(network, options, providers=["CPUExecutionProvider"])
    return lambda rows: np.asarray(session.run(None, {"observations": rows})[0])


def by_numpy(network: str, dtype: str) -> Callable[[Values], Values]:
    """The network, linear layers with ReLU between them, as NumPy's BLAS calculates it."""
    import onnx

    tensors = onnx.load(network).graph.initializer
    arrays = [onnx.numpy_helper.to_array(tensor).astype(dtype) for tensor in tensors]
    layers = list(zip(arrays[::2], arrays[1::2], strict=True))

    def values(rows: Values) -> Values:
        rows = rows.reshape(len(rows), -1).astype(dtype)
        for weight, bias in layers[:-1]:
            rows = np.maximum(rows @ weight.T + bias, 0)
        return rows @ layers[-1][0].T + layers[-1][1]

    return values


def main(library: str, network: str, observations: str, output: str) -> None:
    """Writes the values."""
    values = by_onnxruntime(network) if library == "onnxruntime" else by_numpy(network, library)
    rows = np.load(observations, mmap_mode="r")
    starts = range(0, len(rows), ROWS_AT_ONCE)
    np.save(output, np.concatenate([values(rows[k : k + ROWS_AT_ONCE]) for k in starts]))


if __name__ == "__main__":
    if len(sys.argv) != 5:
        sys.exit("usage: python tools/network_values.py LIBRARY NETWORK OBSERVATIONS OUTPUT")
    main(*sys.argv[1:])
