"""highway-env's configuration of an environment: what it says, and what is supported."""

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

from charms_bench.errors import InputError, suggestion
from charms_bench.foundation.arrays import Floats, Ints
from charms_bench.roads.kinematics import FEATURES
from charms_bench.world.actions import ACTIONS

_IDM = "highway_env.vehicle.behavior.IDMVehicle"
_FREE = {"manual_control": False, "other_vehicles_type": _IDM, "controlled_vehicles": 1}
"""Keys of which one value is supported."""
_ACTIONS = {
    (True, True): ACTIONS,
    (True, False): ("SLOWER", "IDLE", "FASTER"),
    (False, True): ("LANE_LEFT", "IDLE", "LANE_RIGHT"),
}
"""The meta-actions by whether they are longitudinal and lateral [`DiscreteMetaAction`]."""
_KINEMATICS: dict[str, Any] = {
    "type": "Kinematics",
    "features": ["presence", "x", "y", "vx", "vy"],
    "vehicles_count": 5,
    "features_range": None,
    "absolute": False,
    "order": "sorted",
    "normalize": True,
    "clip": True,
    "see_behind": False,
    "observe_intentions": False,
    "include_obstacles": True,
}


class MetaActions(NamedTuple):
    """[`DiscreteMetaAction`]"""

    meaning: Ints
    """(A,) the index into `world.actions.ACTIONS` of each action."""
    target_speeds: Floats


class Kinematics(NamedTuple):
    """[`KinematicObservation`]"""

    rows: int
    features: Ints
    """(F,) indices into `kinematics.FEATURES`."""
    ranges: Floats
    """(F, 2) the values that are mapped onto -1 and 1; not a number without them."""
    y_range: int
    """The feature whose range is the width of the ego's road at the start; -1 for none."""
    how: Ints
    """The argument of `kinematics.observe`."""


def checked(default: Mapping[str, Any], config: Mapping[str, Any] | None) -> dict[str, Any]:
    """The default configuration with the values of another.

    Raises:
        InputError: A key is unknown, or its value is not supported.
    """
    found = {**default, **(config or {})}
    for key, value in found.items():
        if key not in default:
            raise InputError(f"config: no key named '{key}'. {suggestion(key, dict(default))}")
        if key in _FREE and value != _FREE[key]:
            raise InputError(f"config.{key}: {value!r} is not supported; expected {_FREE[key]!r}")
    return found


def meta_actions(config: Mapping[str, Any]) -> MetaActions:
    """The actions of a configuration.

    Raises:
        InputError: They are not supported.
    """
    known = {"longitudinal": True, "lateral": True, "target_speeds": None}
    action = _options("action", config["action"], {"type": "DiscreteMetaAction", **known})
    names = _ACTIONS.get((bool(action["longitudinal"]), bool(action["lateral"])))
    if names is None:
        raise InputError("config.action: neither longitudinal nor lateral; expected one of them")
    speeds = action["target_speeds"]
    speeds = np.linspace(20, 30, 3) if speeds is None else np.array(speeds, dtype=np.float64)
    if speeds.ndim != 1 or speeds.size < 2 or not (np.diff(speeds) > 0).all():
        raise InputError("config.action.target_speeds: expected at least two increasing speeds")
    return MetaActions(np.array([ACTIONS.index(name) for name in names]), speeds)


def kinematics(observation: Mapping[str, Any]) -> Kinematics:
    """The observation of a configuration.

    Raises:
        InputError: It is not supported.
    """
    found = _options("observation", observation, _KINEMATICS)
    features = found["features"] or _KINEMATICS["features"]
    for name in features:
        if name not in FEATURES:
            known = suggestion(name, dict.fromkeys(FEATURES))
            raise InputError(f"config.observation.features: '{name}' is not supported. {known}")
    if found["order"] == "shuffled":
        raise InputError("config.observation.order: 'shuffled' is not supported")
    if found["vehicles_count"] < 2:
        raise InputError("config.observation.vehicles_count: expected at least 2")
    ranges: dict[str, Any] = found["features_range"] or {
        "x": (-200.0, 200.0),
        "vx": (-80.0, 80.0),
        "vy": (-80.0, 80.0),
    }
    is_free = not found["features_range"] and found["normalize"] and "y" in features
    own = ranges if found["normalize"] else {}
    how = ("absolute", "order", "clip", "see_behind", "include_obstacles")
    return Kinematics(
        rows=int(found["vehicles_count"]),
        features=np.array([FEATURES.index(name) for name in features]),
        ranges=np.array([own.get(name, (np.nan, np.nan)) for name in features], dtype=np.float64),
        y_range=features.index("y") if is_free else -1,
        how=np.array([found[name] == "sorted" if name == "order" else found[name] for name in how]),
    )


def _options(what: str, given: Mapping[str, Any], known: Mapping[str, Any]) -> dict[str, Any]:
    if given.get("type") != known["type"]:
        raise InputError(
            f"config.{what}.type: '{given.get('type')}' is not supported; expected "
            f"'{known['type']}'"
        )
    for key in given:
        if key not in known:
            raise InputError(f"config.{what}: no key named '{key}'. {suggestion(key, dict(known))}")
    return {**known, **given}
