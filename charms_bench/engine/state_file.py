"""A `SceneState` as a JSON file. Numbers keep all their bits.

The first line has the SHA-256 of all lines after it, so that a file that has been edited or damaged
is rejected instead of continued as another scene.
"""

import hashlib
import json
import math
from pathlib import Path
from typing import Any, NoReturn, TypeVar

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ValidationError

from charms_bench.engine.collision_kinds import COLLISIONS
from charms_bench.engine.endings import ENDINGS
from charms_bench.engine.state import OF_SCENE, OF_SCENES, SceneState
from charms_bench.errors import InputError, first_problem
from charms_bench.foundation.files import json_of, read_limited, write_bytes
from charms_bench.plugins.agent import ACCELERATION_LIMIT_MPS2
from charms_bench.world.actions import ACTIONS_LIMIT, STEPS_LIMIT
from charms_bench.world.named_road import NamedRoad
from charms_bench.world.scene import SceneSettings

M = TypeVar("M", bound=BaseModel)
FORMAT, VERSION = "charms-bench scene state", 6
LIMIT_BYTES = 2**28
LANES = 1_000_000
"""Bound of the number of lanes of a road."""
ENTRIES = 100_000
"""Bound of the number of vehicles that have entered a scene."""
_LARGEST = 1e9
"""Bound of what a driver model may write to its timer: with it, nothing overflows."""
_INTEGERS = ("steps", "ending", "ego", "drivers", "action", "collision", "entry")
_WORDS = ("seeds", "generator")
_BOOLEANS = ("active", "has_action", "present", "crashed", "impact")
_TYPES = (
    ((*_INTEGERS, "target_lane", "repeats"), "i", "integers"),
    (_BOOLEANS, "b", "true or false"),
    (OF_SCENE, "fi", "numbers"),
)
"""Fields, NumPy's kinds of what a file may hold in them, and these kinds in words."""


def save_state(state: SceneState, path: str | Path) -> None:
    """Writes a state, one line per field.

    The state of a vector environment also has the environment's counters. Save its `scenes`.

    Raises:
        InputError: It is not a `SceneState`, or it belongs to a scenario or a recording, which the
            file format cannot store.
        RunFolderError: The folder cannot be written to.
    """
    if not isinstance(state, SceneState):
        raise InputError(
            f"{path}: found {type(state).__name__}, expected a SceneState; save the scenes of a "
            "vector environment with save_state(env.get_state().scenes, path)"
        )
    if state.settings.scenario is not None:
        raise InputError(f"{path}: a state of a scenario stays in memory; expected drawn traffic")
    if state.settings.is_recorded:
        raise InputError(f"{path}: a state of a recorded scene stays in memory")
    road = state.settings.network
    fields: dict[str, Any] = {
        "settings": state.settings.model_dump(mode="json"),
        "agents": state.agents,
        "phase": state.phase,
        **{name: getattr(state, name).tolist() for name in OF_SCENE},
    }
    if road is not None:
        fields["road"] = road.model_dump(mode="json")
        fields["network"] = [each.tobytes().hex() for each in state.network]
    lines = (f"{json.dumps(name)}: {json.dumps(value)}" for name, value in fields.items())
    body = (",\n".join(lines) + "}\n").encode()
    write_bytes(Path(path), _first_line(body) + body)


def _first_line(body: bytes) -> bytes:
    """The line that stands before `body`."""
    fields = {"format": FORMAT, "version": VERSION, "sha256": hashlib.sha256(body).hexdigest()}
    return (json.dumps(fields).removesuffix("}") + ",\n").encode()


def load_state(path: str | Path) -> SceneState:
    """Reads a state.

    Raises:
        InputError: The file cannot be read, is not a state, or was changed after it was saved.
    """
    try:
        data = read_limited(Path(path), LIMIT_BYTES)
        found = json_of(data, parse_constant=_reject)
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror or error}") from error
    except ValueError as error:
        raise InputError(
            f"{path}: is not a complete state file: {error}; save the state again"
        ) from error
    try:
        _check_file(found, data)
        return _state_of(found)
    except InputError as error:
        raise InputError(f"{path}: {error}") from error


def _reject(constant: str) -> NoReturn:
    raise ValueError(f"found the number {constant}, expected finite numbers")


def _check_file(found: Any, data: bytes) -> None:
    if not isinstance(found, dict) or found.get("format") != FORMAT:
        raise InputError(f"is not a state file; expected the format '{FORMAT}'")
    if found.get("version") != VERSION:
        raise InputError(
            f"version: found {found.get('version')!r}, expected {VERSION}; read it with the "
            "charms-bench that wrote it"
        )
    body = data.partition(b"\n")[2]
    if data != _first_line(body) + body:
        raise InputError(
            "sha256: the content is not that with which the file was saved, so it has been edited "
            "or damaged; save the state again"
        )


def _state_of(found: dict[str, Any]) -> SceneState:
    known = {"format", "version", "sha256", "settings", "agents", "phase", *OF_SCENE}
    known |= {"road", "network"} if {"road", "network"} & found.keys() else set()
    for name in sorted(known ^ found.keys()):
        raise InputError(f"{name}: {'is missing' if name in known else 'unknown field'}")
    given, on_road = found["settings"], {}
    if "road" in found and isinstance(given, dict):  # which can have a single lane
        on_road = {
            "network": _validated(NamedRoad, "road", found["road"]),
            "lanes": given.get("lanes"),
        }
        given = {name: value for name, value in given.items() if name != "lanes"}
        if type(on_road["lanes"]) is not int or not 1 <= on_road["lanes"] <= LANES:
            raise InputError(f"settings.lanes: expected 1 to {LANES:,}")
    settings = _validated(SceneSettings, "settings", given).model_copy(update=on_road)
    agents, phase = found["agents"], found["phase"]
    if not isinstance(agents, list) or not all(isinstance(name, str) for name in agents):
        raise InputError("agents: expected a list of names")
    if len(set(agents)) < len(agents):
        raise InputError("agents: a name occurs twice")
    if type(phase) is not int:
        raise InputError(f"phase: found {phase!r}, expected an integer")
    arrays = {name: _array_of(name, found[name]) for name in OF_SCENE}
    network = _network_of(found.get("network", [""] * arrays["seeds"].size))
    state = SceneState(settings, tuple(agents), phase, **arrays, network=network, is_from_file=True)
    check_state(state)
    return state


def _validated(kind: type[M], name: str, value: Any) -> M:
    try:
        return kind.model_validate(value)
    except ValidationError as error:
        location, what = first_problem(error)
        raise InputError(f"{'.'.join(map(str, (name, *location)))}: {what}") from error


def _network_of(value: Any) -> NDArray[np.uint8]:
    """The bytes of scenes, which the engine of their road checks before it continues them."""
    try:
        rows = [np.frombuffer(bytes.fromhex(each), dtype=np.uint8) for each in value]
        return np.stack(rows) if rows else np.zeros((0, 0), dtype=np.uint8)
    except (TypeError, ValueError) as error:
        raise InputError("network: expected one hexadecimal text per scene, all as long") from error


def _array_of(name: str, value: Any) -> NDArray[Any]:
    """An array of the field's type; its shape is not checked yet."""
    if name in _WORDS:
        of_scenes = value if isinstance(value, list) else [None]
        words = [
            word for each in of_scenes for word in (each if isinstance(each, list) else [each])
        ]
        if not all(type(word) is int and 0 <= word < 2**64 for word in words):
            raise InputError(f"{name}: expected integers from 0 to 2^64 - 1")
    try:
        array = np.array(value, dtype=np.uint64 if name in _WORDS else None)
    except ValueError as error:
        raise InputError(f"{name}: rows have different lengths") from error
    if name in _WORDS:
        return array
    kinds, what = next(expected for names, *expected in _TYPES if name in names)
    is_empty = array.size == 0 and (name != "memory" or array.ndim != 3)
    if is_empty or array.dtype.kind not in kinds:
        raise InputError(f"{name}: expected {what}")
    return array.astype({"i": np.int64, "b": np.bool_, "f": np.float64}[kinds[0]])


def check_state(state: SceneState) -> None:
    """Rejects values that cannot occur in a simulation with an `InputError` that names the field.

    On a road of highway-env, the engine checks its lanes and routes when it restores the state.
    """
    settings, scenes = state.settings, state.seeds.size
    for name in OF_SCENE:
        array = getattr(state, name)
        of_vehicles = (settings.vehicles, *(array.shape[2:3] if name == "memory" else ()))
        shape = (scenes,) if name in OF_SCENES else (scenes, *of_vehicles)
        shape = (scenes, 6) if name == "generator" else shape
        if array.shape != shape:
            raise InputError(f"{name}: found the shape {array.shape}, expected {shape}")
    if state.network.shape[:1] != (scenes,):
        raise InputError(f"network: found {len(state.network)} scenes, expected {scenes}")
    bounds: dict[str, tuple[float, float]] = {
        **({} if settings.network else _bounds_of_straight_roads(settings)),
        "phase": (0, settings.steps_per_decision),
        "steps": (0, settings.decisions),
        "ending": (0, len(ENDINGS) - 1),
        "ego": (0, settings.vehicles - 1),
        "drivers": (0, len(state.agents) - 1),
        "action": (0, ACTIONS_LIMIT - 1),  # a policy can have meta-actions of its own
        "collision": (0, len(COLLISIONS) - 1),
        "entry": (0, ENTRIES),
        "repeats": (-STEPS_LIMIT, STEPS_LIMIT),  # a policy can have steps of its own
        "temperament": (0.0, 1.0),
        "memory": (-np.inf, np.inf),
    }
    if any(len(set(numbers)) < len(numbers) for numbers in state.entry.tolist()):
        raise InputError("entry: two vehicles of a scene have the same number")
    for name in ("phase", *OF_SCENE):
        values = np.asarray(getattr(state, name))
        low, high = bounds.get(name, (-_LARGEST, _LARGEST))
        is_bounded = name not in (*_BOOLEANS, *_WORDS)
        if is_bounded and (wrong := ~((low <= values) & (values <= high))).any():
            found = values[np.nonzero(wrong)][0] if values.ndim else values
            raise InputError(f"{name}: found {found}, expected {low:g} to {high:g}")


def _bounds_of_straight_roads(settings: SceneSettings) -> dict[str, tuple[float, float]]:
    lengths, widths = zip(*settings.sizes_m, strict=True)
    return {
        **{name: (-bound, bound) for name, bound in _magnitudes(settings).items()},
        "target_lane": (0, settings.lanes - 1),
        "length": (min(lengths), max(lengths)),
        "width": (min(widths), max(widths)),
    }


def _magnitudes(settings: SceneSettings) -> dict[str, float]:
    """What no quantity of the scenes exceeds in either direction."""
    profile = settings.profile
    speeds = (profile.speed_limit_mps, profile.ego_speed_mps, profile.target_speed_max_mps)
    # Twice the fastest speed, because a vehicle beyond a limit returns to it only gradually.
    speed = 2 * max(*speeds, profile.speed_max_mps, -profile.speed_min_mps)
    acceleration = max(2 * speed / profile.tau_acceleration_s, speed, ACCELERATION_LIMIT_MPS2)
    distance = settings.road_length_m + speed * settings.duration_s
    # A collision moves two overlapping vehicles apart, and what they cover in one step [`SAT`].
    lengths, widths = zip(*settings.sizes_m, strict=True)
    impact = 2 * (max(lengths) + max(widths))
    impact += speed / settings.simulation_hz
    # The bicycle model turns by at most speed / (length / 2), and no further than steering to the
    # side takes it; full circles are not taken off.
    heading = 2 * math.pi + 2 * speed / min(lengths) * settings.duration_s
    return {
        "x": distance,
        "y": distance,
        "heading": heading,
        "speed": speed,
        "acceleration": acceleration,
        "steering": math.pi / 2,
        "target_speed": speed,
        "impact_x": impact,
        "impact_y": impact,
    }
