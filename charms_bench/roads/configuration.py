"""highway-env's configuration of an environment: what is supported, and its actions."""

from collections.abc import Mapping
from typing import Any, NamedTuple

import gymnasium
import numpy as np
from numpy.typing import NDArray

from charms_bench.errors import InputError, suggestion
from charms_bench.foundation.arrays import Floats, Ints
from charms_bench.roads.scenes import Scenes
from charms_bench.world.actions import ACTIONS

TYPES = ("IDMVehicle", "LinearVehicle", "AggressiveVehicle", "DefensiveVehicle")
"""highway-env's classes of the other vehicles."""
_SUPPORTED: dict[str, tuple[Any, ...]] = {
    "manual_control": (False,),
    "other_vehicles_type": tuple(f"highway_env.vehicle.behavior.{name}" for name in TYPES),
}
"""The values of keys of which not all are supported."""
_ACTIONS = {
    (True, True): ACTIONS,
    (True, False): ("SLOWER", "IDLE", "FASTER"),
    (False, True): ("LANE_LEFT", "IDLE", "LANE_RIGHT"),
}
"""The meta-actions by whether they are longitudinal and lateral [`DiscreteMetaAction`]."""


class MetaActions(NamedTuple):
    """[`DiscreteMetaAction`]"""

    names: tuple[str, ...]
    meaning: Ints
    """(A,) the index into `world.actions.ACTIONS` of each action."""
    target_speeds: Floats

    @property
    def actions(self) -> dict[int, str]:
        """The names by index."""
        return dict(enumerate(self.names))

    @property
    def actions_indexes(self) -> dict[str, int]:
        """The indices by name."""
        return {name: k for k, name in enumerate(self.names)}

    @property
    def space(self) -> gymnasium.Space[Any]:
        """Of one action."""
        return gymnasium.spaces.Discrete(len(self.names))

    def give(self, scenes: Scenes, actions: NDArray[Any], ego: int) -> Ints:
        """The meta-actions (B,) for `stepping.decide`, from indices (B,) of actions."""
        return np.asarray(self.meaning[actions])


def checked(default: Mapping[str, Any], config: Mapping[str, Any] | None) -> dict[str, Any]:
    """The default configuration with the values of another.

    Raises:
        InputError: A key is unknown, or its value is not supported.
    """
    found = {**default, **(config or {})}
    if found["offscreen_rendering"] is None:
        found["offscreen_rendering"] = True  # as without a window [`AbstractEnv.configure`]
    if not found.get("controlled_vehicles", 1) >= 1:
        raise InputError("config.controlled_vehicles: expected at least 1")
    for key, value in found.items():
        if key not in default:
            raise InputError(f"config: no key named '{key}'. {suggestion(key, dict(default))}")
        if value not in _SUPPORTED.get(key, (value,)):
            expected = " or ".join(map(repr, _SUPPORTED[key]))
            raise InputError(f"config.{key}: {value!r} is not supported; expected {expected}")
    return found


def meta_actions(config: Mapping[str, Any]) -> MetaActions:
    """The actions of a configuration.

    Raises:
        InputError: They are not supported.
    """
    known = {"longitudinal": True, "lateral": True, "target_speeds": None}
    action = options("action", config["action"], {"type": "DiscreteMetaAction", **known})
    names = _ACTIONS.get((bool(action["longitudinal"]), bool(action["lateral"])))
    if names is None:
        raise InputError("config.action: neither longitudinal nor lateral; expected one of them")
    speeds = action["target_speeds"]
    speeds = np.linspace(20, 30, 3) if speeds is None else np.array(speeds, dtype=np.float64)
    if speeds.ndim != 1 or speeds.size < 2 or not (np.diff(speeds) > 0).all():
        raise InputError("config.action.target_speeds: expected at least two increasing speeds")
    return MetaActions(names, np.array([ACTIONS.index(name) for name in names]), speeds)


def of_each_agent(config: Mapping[str, Any], what: str) -> tuple[dict[str, Any], bool]:
    """The configuration with the `action` or `observation` of one agent.

    Also returns whether each agent has one [`MultiAgentAction`, `MultiAgentObservation`].
    """
    given, name = config[what], f"MultiAgent{what.capitalize()}"
    if given.get("type") != name:
        return dict(config), False
    found = options(what, given, {"type": name, f"{what}_config": {}})
    return {**config, what: found[f"{what}_config"]}, True


def options(what: str, given: Mapping[str, Any], known: Mapping[str, Any]) -> dict[str, Any]:
    """The values of `config[what]`, which may have the `known` keys; these are the defaults.

    Raises:
        InputError: The type is another, or a key is unknown.
    """
    if given.get("type") != known["type"]:
        raise InputError(
            f"config.{what}.type: '{given.get('type')}' is not supported; expected "
            f"'{known['type']}'"
        )
    for key in given:
        if key not in known:
            raise InputError(f"config.{what}: no key named '{key}'. {suggestion(key, dict(known))}")
    return {**known, **given}
