"""The environment in which worker processes compute the same bits wherever they run."""

import os
import platform

import numpy as np

from charms_bench.engine import EngineName

_THREADS = ("NUMBA_NUM_THREADS", "OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "POLARS_MAX_THREADS")
ONE_THREAD = dict.fromkeys(_THREADS, "1")
"""Environment variables of a process that computes on one thread."""
_DISABLED = "NPY_DISABLE_CPU_FEATURES"
_OPENBLAS = "OPENBLAS_CORETYPE"
_CORE_TYPE = "Nehalem"
"""The oldest core type that OpenBLAS knows; it has no fused multiply-add."""
_IS_X86 = platform.machine() in ("x86_64", "AMD64")


def worker_environment(engine: EngineName) -> dict[str, str]:
    """Returns the environment variables with which a worker process has to be started.

    NumPy's vectorised tan, arcsin, arctan, exp and power differ from the C library's in the last
    bit, and on processors with AVX-512 its OpenBLAS rounds a dot product once instead of twice.
    highway-env's vehicles use them and would then differ from the compiled engine's, so for that
    engine both are switched off. NumPy reads these variables when it is imported.
    """
    if engine == "batched":
        return ONE_THREAD
    disabled = [os.environ.get(_DISABLED, ""), *_vectorised()]  # the user may have disabled some
    environment = {**ONE_THREAD, _DISABLED: " ".join(disabled).strip()}
    if _IS_X86:
        environment[_OPENBLAS] = _CORE_TYPE
    return environment


def check_exact_maths(engine: EngineName) -> None:
    """Checks that this process was started with `worker_environment(engine)`.

    Raises:
        RuntimeError: NumPy computes highway-env's vehicles with other functions.
    """
    if engine == "highway-env" and (
        _vectorised() or (_IS_X86 and os.environ.get(_OPENBLAS) != _CORE_TYPE)
    ):
        raise RuntimeError("the engine highway-env needs a process with exact maths")


def _vectorised() -> list[str]:
    """Returns the processor features beyond the baseline that NumPy uses in this process."""
    extensions = np.show_config(mode="dicts")["SIMD Extensions"]
    return list(extensions.get("found", ()))
