"""highway-env's configuration of an environment: what is supported, and its actions."""

import math
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from numbers import Integral, Real
from typing import Any, NamedTuple

import gymnasium
import numpy as np
from numpy.typing import NDArray

from charms_bench.errors import InputError, suggestion
from charms_bench.foundation.arrays import Floats, Ints
from charms_bench.roads.scenes import Scenes
from charms_bench.world.actions import ACTIONS, NAMES_BY_AXES
from charms_bench.world.named_road import STARTS

TYPES = ("IDMVehicle", "LinearVehicle", "AggressiveVehicle", "DefensiveVehicle")
"""highway-env's classes of the other vehicles."""
_SUPPORTED: dict[str, tuple[Any, ...]] = {
    "manual_control": (False,),
    "start": STARTS,
    "other_vehicles_type": tuple(f"highway_env.vehicle.behavior.{name}" for name in TYPES),
}
"""The values of keys of which not all are supported."""
_RENDERING = (
    *("screen_width", "screen_height", "centering_position", "scaling", "show_trajectories"),
    *("render_agent", "offscreen_rendering", "real_time_rendering"),
)
WHOLE = (
    *("lanes_count", "no_lanes", "roundabout_lanes"),
    *("vehicles_count", "other_vehicles", "initial_vehicle_count", "controlled_vehicles"),
)
"""Keys whose values are whole numbers."""
_LEAST = {
    **dict.fromkeys(("vehicles_count", "other_vehicles", "initial_vehicle_count"), 0),
    **dict.fromkeys(("state_noise", "derivative_noise"), 0),
    **dict.fromkeys(("lanes_count", "roundabout_lanes"), 1),
    "after_merge_length": 90,
}
"""The least values of keys."""


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

    def give(self, scenes: Scenes, rows: Ints, actions: NDArray[Any], ego: int) -> Ints:
        """The meta-actions (R,) for `stepping.decide`, from indices (R,) of actions."""
        return np.asarray(self.meaning[actions])


def checked(default: Mapping[str, Any], config: Mapping[str, Any] | None) -> dict[str, Any]:
    """The default configuration with the values of another, which can raise an `InputError`."""
    if not isinstance(config or {}, Mapping):
        raise InputError(f"config: {config!r}; expected a dictionary")
    found: dict[str, Any] = plain({**default, **(config or {})})
    if found["offscreen_rendering"] is None:
        found["offscreen_rendering"] = True  # as without a window [`AbstractEnv.configure`]
    for key, value in found.items():
        if key not in default:
            known = suggestion(str(key), dict(default))
            raise InputError(f"config: no key named '{key}'. {known}")
        usual = default[key]
        if key not in _RENDERING and isinstance(usual, list):
            if not isinstance(value, list) or len(value) < len(usual):
                what = f"highway-env does not start with it; expected {len(usual)} numbers"
                raise InputError(f"config.{key}: {value!r}; {what}")
            for each in value:
                _check_number(key, each)
        elif key not in _RENDERING and isinstance(usual, Real) and not isinstance(usual, bool):
            _check_number(key, value)
        if value not in _SUPPORTED.get(key, (value,)):
            expected = " or ".join(map(repr, _SUPPORTED[key]))
            raise InputError(f"config.{key}: {value!r} is not supported; expected {expected}")
    if not found.get("controlled_vehicles", 1) >= 1:
        raise InputError("config.controlled_vehicles: expected at least 1")
    simulation, decisions = found["simulation_frequency"], found["policy_frequency"]
    if not simulation > 0:
        raise InputError(f"config.simulation_frequency: {simulation}; expected more than 0")
    if not 0 < decisions <= simulation:
        raise InputError(
            f"config.policy_frequency: {decisions}; expected more than 0, and at most the "
            f"simulation_frequency, {simulation}"
        )
    return found


def _check_number(key: str, value: Any) -> None:
    """Raises an `InputError` unless a value is a number that the key can have."""
    if not isinstance(value, Real) or math.isnan(value):
        raise InputError(f"config.{key}: {value!r}; expected a number")
    if key in WHOLE and not isinstance(value, Integral):
        raise InputError(f"config.{key}: {value!r}; expected a whole number")
    if key in _LEAST and value < _LEAST[key]:
        raise InputError(f"config.{key}: {value!r}; expected at least {_LEAST[key]}")


def whole(point: Mapping[str, float]) -> dict[str, float]:
    """The values of keys, rounded where they are whole numbers."""
    return {key: round(value) if key in WHOLE else value for key, value in point.items()}


def plain(values: Any) -> Any:
    """The same values with lists instead of arrays and tuples, so that they can be compared."""
    if isinstance(values, Mapping):
        return {key: plain(value) for key, value in values.items()}
    if isinstance(values, (list, tuple, np.ndarray)):
        return [plain(value) for value in values]
    return values


@contextmanager
def named(what: str) -> Iterator[None]:
    """Names, in an `InputError`, the part of the configuration of which a value cannot be used."""
    try:
        yield
    except InputError:
        raise
    except Exception as error:  # whatever a value leads to
        raise InputError(f"config{what}: not all values can be used: {error!r}") from error


def meta_actions(config: Mapping[str, Any]) -> MetaActions:
    """The actions of a configuration; raises an `InputError` if they are not supported."""
    known = {"longitudinal": True, "lateral": True, "target_speeds": None}
    action = options("action", config["action"], {"type": "DiscreteMetaAction", **known})
    names = NAMES_BY_AXES.get((bool(action["longitudinal"]), bool(action["lateral"])))
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
    has_agents = isinstance(given, Mapping) and given.get("type") == name
    if has_agents:
        given = options(what, given, {"type": name, f"{what}_config": {}})[f"{what}_config"]
    if not isinstance(given, Mapping):
        raise InputError(f"config.{what}: {given!r}; expected a dictionary with a 'type'")
    return {**config, what: given}, has_agents


def options(what: str, given: Mapping[str, Any], known: Mapping[str, Any]) -> dict[str, Any]:
    """The values of `config[what]`, of the same type as the `known` ones, which are the defaults.

    An `InputError` says which key is unknown.
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
