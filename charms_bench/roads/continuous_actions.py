"""Actions that are accelerations and steering angles [`ContinuousAction`, `DiscreteAction`]."""

import math
from collections.abc import Mapping, Sequence
from itertools import product
from typing import Any

import gymnasium
import numpy as np
from numpy.typing import NDArray

from charms_bench.errors import InputError
from charms_bench.foundation.arrays import Ints
from charms_bench.roads.configuration import MetaActions, meta_actions, options
from charms_bench.roads.scenes import COMMANDED, CONTINUOUS, DYNAMICAL, Scenes

_CONTROLS: dict[str, Any] = {
    "acceleration_range": None,
    "steering_range": None,
    "longitudinal": True,
    "lateral": True,
    "dynamical": False,
    "clip": True,
    "target_speeds": None,
}
_OWN: dict[str, dict[str, Any]] = {
    "ContinuousAction": {"speed_range": None},
    "DiscreteAction": {"actions_per_axis": 3},
}
_RANGES = {"acceleration": (-5, 5.0), "steering": (-math.pi / 4, math.pi / 4)}
"""m/s^2, and rad."""


class Controls:
    """The actions of a configuration, each of them a number from -1 to 1 for each axis."""

    target_speeds = np.linspace(20, 30, 3)
    """Only for rewards; the configuration's have no effect, as in highway-env."""

    def __init__(self, config: Mapping[str, Any]) -> None:
        kind = str(config["action"]["type"])
        found = options("action", config["action"], {"type": kind, **_CONTROLS, **_OWN[kind]})
        self._axes = [
            (axis, tuple(found[f"{axis}_range"] or _RANGES[axis]))
            for axis, is_on in (("acceleration", "longitudinal"), ("steering", "lateral"))
            if found[is_on]
        ]
        self._idle = {*_RANGES} - {axis for axis, _ in self._axes}
        if not self._axes:
            raise InputError("config.action: neither longitudinal nor lateral; expected one")
        self._speeds = tuple(found.get("speed_range") or ())
        for axis, each in (*self._axes, ("speed", self._speeds or (0, 0))):
            if len(each) != 2:
                raise InputError(f"config.action.{axis}_range: {each!r}; expected two numbers")
        self.clips = bool(found["clip"])
        """Whether actions outside [-1, 1] are clipped."""
        box = gymnasium.spaces.Box(-1.0, 1.0, (len(self._axes),), np.float32)
        self._kind = DYNAMICAL if found["dynamical"] else CONTINUOUS
        self.space: gymnasium.Space[Any] = box
        """Of one action."""
        self._table: NDArray[Any] | None = None
        if kind == "DiscreteAction":
            steps = np.linspace(box.low, box.high, found["actions_per_axis"]).T
            self._table = np.array(list(product(*steps)))
            self.space = gymnasium.spaces.Discrete(len(self._table))

    def take(self, scenes: Scenes, rows: Ints, egos: int) -> None:
        """Turns the commanded egos of new episodes into vehicles with controls."""
        vehicles = scenes.vehicles[:, :egos]
        vehicles["kind"][rows] = self._kind
        vehicles["target_speed"][rows] = vehicles["route_end"][rows] = 0

    def give(self, scenes: Scenes, rows: Ints, actions: NDArray[Any], ego: int) -> Ints:
        """Gives the ego at a place in the scenes `rows` its actions (R, axes), or (R,) indices.

        Accelerations and steering angles have the precision of the actions, as in highway-env. The
        meta-actions (R,) for `stepping.decide` that are returned have no effect.
        """
        vehicles, at = scenes.vehicles, (rows, ego)
        actions = actions if self._table is None else self._table[actions]
        if self.clips:
            actions = actions.clip(-1, 1)
        for axis in self._idle:
            vehicles[axis][at] = 0.0
        for k, (axis, (low, high)) in enumerate(self._axes):
            vehicles[axis][at] = low + (actions[:, k] - -1) * (high - low) / 2
        if self._speeds:
            vehicles["speed_min"][at], vehicles["speed_max"][at] = self._speeds
        return np.zeros(len(actions), dtype=np.int64)


def actions_of(config: Mapping[str, Any], supported: Sequence[str]) -> MetaActions | Controls:
    """The actions of a configuration; raises an `InputError` unless their type is supported."""
    name = config["action"].get("type")
    if name not in supported:
        expected = " or ".join(map(repr, supported))
        why = ""
        if name in _OWN:
            why = (
                ", because highway-env's reward fails with it here. On every road, "
                "charms_bench/Ego-v0 takes actions='continuous'"
            )
        raise InputError(f"config.action.type: '{name}' is not supported{why}; expected {expected}")
    return Controls(config) if name in _OWN else meta_actions(config)


def kind_of_ego(config: Mapping[str, Any]) -> int:
    """What the ego is by its actions, an index into `scenes.KINDS` [`vehicle_class`]."""
    if config["action"]["type"] not in _OWN:
        return COMMANDED
    return DYNAMICAL if config["action"].get("dynamical") else CONTINUOUS
