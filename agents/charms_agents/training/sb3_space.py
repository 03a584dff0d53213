"""What a Stable-Baselines3 checkpoint was trained on: its observations, their frames and rate.

The JSON of `data` has the shape and the bounds of the observation space as text. Those of
`neighbours` are finite and those of highway-env's `Kinematics` are not. The spaces of the
environments of charms-bench also have `TRAINED_IN`.
"""

import base64
import json
import pickletools
from collections.abc import Mapping
from math import prod
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from charms_agents.training.onnx_input import Given
from charms_agents.training.sb3_checkpoint import Rejection, within
from charms_bench.errors import InputError
from charms_bench.foundation.files import json_of, read_limited
from charms_bench.roads import OF_SUITES
from charms_bench.roads.episodes import Episodes
from charms_bench.world.action_texts import actions_described
from charms_bench.world.actions import MetaAction
from charms_bench.world.highway_env_observation import HighwayEnv
from charms_bench.world.interaction_observation import Interaction
from charms_bench.world.kinematics_observation import Kinematics
from charms_bench.world.observations import (
    OBSERVATIONS,
    TRAINED_IN,
    Neighbours,
    PaperNeighbours,
    neighbours,
    observation_described,
)

DECISION_HZ = {"neighbours": 3.0, "paper_neighbours": 3.0, "Kinematics": 1.0}
"""The usual decision rate of networks trained on an observation: here, and in highway-env."""
_NAME_IT = (
    "name the observation that it was trained on with --observation; suites have "
    f"{', '.join(OBSERVATIONS)} and no other"
)
STATISTICS_LIMIT_BYTES = 2**22
FRAMES_LIMIT = 100
_OWN = "charms_bench/"
_STRAIGHT = ("Ego-v0", "highway-v0", "highway-fast-v0")
"""The environments whose road, observation and target speeds suites have."""
_TARGET_SPEEDS_MPS = [20, 25, 30]
"""highway-env's default."""
_SAVE = "numpy.savez('norm.npz', mean=env.obs_rms.mean, var=env.obs_rms.var, clip=env.clip_obs)"


class Trained(NamedTuple):
    """What `data` says of the observations; parts that cannot be read are empty."""

    shape: tuple[int, ...] = ()
    bounds: NDArray[np.float64] | None = None
    """(2, ...) the lowest and the highest values."""
    where: Mapping[str, Any] = {}
    has_original: bool = False
    """Whether there are observations from before a `VecNormalize`."""
    on_policy: bool = False
    """Whether only a `VecNormalize` explains that there are."""
    seen: NDArray[np.float32] | None = None
    """(M, numbers) the last observations."""


Observed = Neighbours | Kinematics | Interaction | HighwayEnv


class Input(NamedTuple):
    """What the exported network receives."""

    observation: Observed
    decision_hz: float
    given: Given
    """What the network is given of it, without a normalisation."""
    order: NDArray[np.int64]
    """Where each number of (history, rows, columns) is in the input of the checkpoint's network."""


def trained_on(said: Any, environment: Mapping[str, Any] | None = None) -> Trained:
    """What the JSON of `data` says of the observations.

    Where it does not say in which environment, `environment` says it.

    Raises:
        Rejection: It says another one.
    """
    space = within(said, "observation_space")
    try:
        shape = tuple(map(int, space["_shape"]))
    except (ValueError, LookupError, TypeError):
        return Trained(where=environment or {})
    where = space.get(TRAINED_IN) or environment
    if environment and where != environment:
        name = within(where, "environment")
        raise Rejection(f"was trained in {_OWN}{name} as it says; leave out --environment")
    return Trained(
        shape,
        _bounds(space, shape),
        where if isinstance(where, Mapping) else {},
        # Off-policy algorithms have it without a VecNormalize, too.
        said.get("_last_original_obs") is not None,
        "replay_buffer_class" not in said,
        _numbers_in(said.get("_last_obs"), prod(shape)),
    )


def _numbers_in(value: Any, size: int) -> NDArray[np.float32] | None:
    """The float32 array (M, size) whose pickle `data` has; the pickle is not loaded."""
    try:
        pickled = base64.b64decode(value[":serialized:"])
        for _, argument, _ in pickletools.genops(pickled):
            if isinstance(argument, bytes | bytearray) and len(argument) % (4 * size) == 0:
                return np.frombuffer(bytes(argument), "<f4").reshape(-1, size)
    except (ValueError, LookupError, TypeError, ZeroDivisionError):
        pass
    return None


def _bounds(space: Mapping[str, Any], shape: tuple[int, ...]) -> NDArray[np.float64] | None:
    found = []
    for name in ("low", "high"):
        text = str(space.get(name)).replace("[", " ").replace("]", " ")
        try:
            values = [float(each) for each in text.split()]  # long arrays are shortened by ...
        except ValueError:
            try:
                values = [float(str(space.get(f"{name}_repr")))]
            except ValueError:
                return None
        if len(values) == 1:
            values *= prod(shape)
        if len(values) != prod(shape):
            return None
        found.append(np.array(values).reshape(shape))
    return np.array(found)


def input_of(trained: Trained, asked: Observed | None, width: int, has_statistics: bool) -> Input:
    """What the exported network receives, whose first layer takes `width` numbers.

    Args:
        asked: The observation that the user names; None finds out which one it is.
        has_statistics: Whether the user gives the statistics of the normalisation.

    Raises:
        Rejection: It cannot be found out, or the checkpoint contradicts what the user says.
    """
    observation, hz = _stated(trained.where)
    if observation is not None and asked not in (None, observation):
        raise Rejection(
            f"was trained on {_words(observation)} ({_OWN}{trained.where['environment']}), not on "
            f"{_words(asked)}; leave out --observation"
        )
    observation = observation or asked or neighbours
    rows, columns = prod(observation.shape[:-1]), observation.shape[-1]
    size, shape = rows * columns, trained.shape
    frames, repeats, across = 1, False, False
    if shape in (observation.shape, (size,), ()):
        pass
    elif shape[1:] in (observation.shape, (size,)):
        frames, repeats = shape[0], True
    elif shape[:-1] == observation.shape[:-1] and shape[-1] % columns == 0:
        frames, across = shape[-1] // columns, True
    elif len(shape) == 1 and shape[0] % size == 0:
        raise Rejection(
            f"takes {shape[0]} numbers, like {shape[0] // size} flattened observations in an order "
            "that it does not state; stack them without flattening"
        )
    if frames > FRAMES_LIMIT:
        raise Rejection(f"takes {frames} observations at once; expected at most {FRAMES_LIMIT}")
    if width != frames * size:
        raise Rejection(
            f"layer 0 takes {width} numbers; expected {size}, the observation "
            f"'{observation.name}' of {rows} rows of {columns}; {_NAME_IT}"
        )
    order = np.arange(width)
    if across:
        order = order.reshape(rows, frames, columns).transpose(1, 0, 2).ravel()
    has_bounds = not isinstance(observation, Interaction | HighwayEnv)
    if trained.bounds is not None and has_bounds and not has_statistics:
        newest = trained.bounds.reshape(2, -1)[:, order[-size:]].reshape(2, rows, columns)
        _check_bounds(newest, observation)
    if not has_statistics and _is_normalised(trained, observation, order[-size]):
        raise Rejection(
            "was trained with VecNormalize, whose statistics a checkpoint does not hold; save them "
            f"in Python with {_SAVE}, and give --normalise norm.npz; --normalise none if it "
            "normalised rewards only"
        )
    hz = hz or DECISION_HZ[observation.name]
    return Input(observation, hz, Given(frames, repeats), order)


def _is_normalised(trained: Trained, observation: Observed, place: int) -> bool:
    """Whether a `VecNormalize` changed the observations.

    A vehicle's own presence, at this place, is 1 unless it was changed.
    """
    has_presence = isinstance(observation, Neighbours)
    if isinstance(observation, Kinematics):
        has_presence = observation.features[0] == "presence"
    if not trained.has_original:
        return False
    if trained.seen is None or not trained.seen.size or not has_presence:
        return trained.on_policy
    return bool((trained.seen[:, place] != 1).any())


def _stated(where: Mapping[str, Any]) -> tuple[Observed | None, float | None]:
    """The observation and the rate of an environment with a name; None if none is stated."""
    if "environment" not in where:
        return None, None
    name = str(where["environment"])[:80]
    if name not in (*_STRAIGHT, *OF_SUITES):
        raise Rejection(f"was trained in {_OWN}{name}, on whose road suites have no episodes")
    try:
        if name not in _STRAIGHT:
            return _on_road(name, where), float(where["decision_hz"])
        speeds = json_of(str(where.get("action", "{}")).encode()).get("target_speeds")
        if speeds not in (None, _TARGET_SPEEDS_MPS):
            raise Rejection(f"was trained with the target speeds {speeds} m/s, which suites lack")
        observation, hz = observation_described(str(where["observation"])), where["decision_hz"]
        return observation, float(hz)
    except (InputError, LookupError, ValueError, TypeError, AttributeError) as error:
        raise Rejection(f"was trained on an observation that no agent receives: {error}") from error


def _on_road(name: str, where: Mapping[str, Any]) -> HighwayEnv:
    """The observation and the actions of an environment with highway-env's name."""
    own = {key: json_of(str(where[key]).encode()) for key in ("observation", "action")}
    space = Episodes(name, 1, own).observers[0].space
    if space.dtype != np.float32:
        raise Rejection("was trained on pictures; expected an observation with `as_image: false`")
    return HighwayEnv(**own, shape=space.shape or ())


def actions_of(trained: Trained) -> tuple[MetaAction, ...]:
    """The meta-actions of the environment in which a network was trained.

    Raises:
        Rejection: What the checkpoint says of them cannot be read.
    """
    try:
        return actions_described(str(trained.where.get("actions", "meta")))
    except InputError as error:
        raise Rejection(f"was trained with meta-actions that cannot be read: {error}") from error


def _check_bounds(bounds: NDArray[np.float64], observation: Observed) -> None:
    """Rejects an observation (rows, columns) that does not have these bounds."""
    low, high = bounds
    if (np.abs(bounds) == 1).all() and (low < high).all():
        return  # also those of an environment of somebody's own
    is_unbounded = np.isneginf(low).all() and np.isposinf(high).all()
    if isinstance(observation, Kinematics):
        if not is_unbounded:
            raise Rejection(
                f"was trained on an observation with bounds, and Kinematics has none; {_NAME_IT}"
            )
        return
    if is_unbounded and isinstance(observation, PaperNeighbours):
        return  # the authors' environment has no bounds
    if is_unbounded:
        raise Rejection(
            f"was trained on an observation without bounds, and {observation.name} has bounds; for "
            f"highway-env's Kinematics, give --observation '{{type: Kinematics, vehicles_count: "
            f"{len(low)}}}' with the options of its environment; for {observation.name} that was "
            "normalised, give --normalise"
        )
    if not ((low == -high).all() and (high[1:] == 1).all()):
        raise Rejection(
            f"was trained on an observation with other bounds than those of {observation.name}, as "
            "behind a wrapper that changes it; an exported network receives the observation itself"
        )


def _words(observation: Observed | None) -> str:
    assert observation is not None
    options = observation.model_dump(mode="json", exclude_defaults=True)
    return json.dumps({"type": observation.name, **options}) if options else observation.name


def read_statistics(path: Path, trained: Trained, order: NDArray[np.int64]) -> dict[str, Any]:
    """The statistics of a `VecNormalize` in a NumPy archive, as fields of `Given`.

    They are in the order of the harness. No pickle is loaded.

    Raises:
        Rejection: It cannot be read, or does not fit.
    """
    wanted = f"expected a file made in Python with {_SAVE}; clip=numpy.inf for Gymnasium's wrapper"
    try:
        if not read_limited(path, STATISTICS_LIMIT_BYTES).startswith(b"PK"):
            raise Rejection(f"{path} is not a NumPy archive; {wanted}")
        with np.load(path, allow_pickle=False) as archive:
            if sum(each.file_size for each in archive.zip.infolist()) > STATISTICS_LIMIT_BYTES:
                raise Rejection(f"{path} unpacks to more than {STATISTICS_LIMIT_BYTES:,} bytes")
            arrays = {name: np.asarray(archive[name], np.float64) for name in archive.files}
    except OSError as error:
        raise Rejection(f"{path} cannot be read: {error.strerror or error}") from error
    except Rejection:
        raise
    except Exception as error:  # zipfile and numpy raise many kinds
        raise Rejection(f"{path} cannot be read: {error}; {wanted}") from error
    if missing := {"mean", "var", "clip"} - set(arrays):
        raise Rejection(f"{path} has no {min(missing)}; {wanted}")
    mean, var, clip = arrays["mean"], arrays["var"], arrays["clip"]
    if mean.size != order.size or var.shape != mean.shape or clip.size != 1:
        shape = trained.shape or (order.size,)
        raise Rejection(f"{path} has mean {mean.shape} and var {var.shape}; expected {shape}")
    variance = var + arrays.get("epsilon", np.array(1e-8)).item()
    if not (np.isfinite(mean).all() and (variance > 0).all() and clip.item() > 0):
        raise Rejection(f"{path}: expected finite means, and variances and a clip above 0")
    mean, deviation = mean.ravel()[order], np.sqrt(variance).ravel()[order]
    return {"mean": mean, "deviation": deviation, "clip": clip.item()}
