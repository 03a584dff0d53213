"""How many threads the libraries of a process use."""

_VARIABLES = ("NUMBA_NUM_THREADS", "OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "POLARS_MAX_THREADS")
ONE_THREAD = dict.fromkeys(_VARIABLES, "1")
"""Environment variables of a process that computes on one thread."""
