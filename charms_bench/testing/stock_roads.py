"""What highway-env's own environments leave behind."""

from collections.abc import Iterator
from contextlib import contextmanager
from importlib import import_module
from typing import Any

from charms_bench.roads.configuration import TYPES

_CHANGED = "DISTANCE_WANTED", "COMFORT_ACC_MAX", "COMFORT_ACC_MIN"


@contextmanager
def unchanged_idm() -> Iterator[None]:
    """Restores the constants that highway-env's `intersection` changes for the whole process."""
    module: Any = import_module("highway_env.vehicle.behavior")
    kinds = [getattr(module, name) for name in TYPES]
    before = [{name: vars(kind)[name] for name in _CHANGED if name in vars(kind)} for kind in kinds]
    try:
        yield
    finally:
        for kind, values in zip(kinds, before, strict=True):
            for name in _CHANGED:
                if name in values:
                    setattr(kind, name, values[name])
                elif name in vars(kind):
                    delattr(kind, name)
