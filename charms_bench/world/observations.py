"""The observations of policies.

`neighbours` is (7, 5) float32, one row per vehicle: presence, x, y, vx, vy. Row 0 is the vehicle
itself: 1, 1, y / 12 m, and its velocity / 66 m/s. Rows 1 to 6 are its nearest neighbours within
99 m, relative to it: x / 165 m, y / 12 m, velocity / 66 m/s, clipped to [-1, 1]. A row without a
neighbour is all zeros. Neighbours follow highway-env's rule; see `Scene.leader`.

`Kinematics` is highway-env's own observation, with its options; see
`charms_bench.world.kinematics_observation`.
"""

import json
from collections.abc import Mapping
from typing import Any, ClassVar, Protocol

import numpy as np
from pydantic import ValidationError

from charms_bench.errors import InputError, first_problem, suggestion
from charms_bench.world.compiled import clip, compiled_of_scenes
from charms_bench.world.fields import FrozenModel
from charms_bench.world.kinematics_observation import Kinematics
from charms_bench.world.scene import Ints, Observations, Scene, Vehicles


class Observation(Protocol):
    """What a policy observes. `OBSERVATIONS` lists the observations that have a name."""

    @property
    def shape(self) -> tuple[int, int]:
        """The rows and columns of one vehicle's observation."""

    def __call__(self, scene: Scene, vehicles: Vehicles) -> Observations:
        """The observations of M vehicles, (M, rows, columns)."""


ObservationLike = str | Mapping[str, Any] | Observation
"""An observation, its name, or its name and options: `{type: name, option: value}`."""

EGO, LEFT_FRONT, LEFT_REAR, FRONT, REAR, RIGHT_FRONT, RIGHT_REAR = range(7)
"""The rows of `neighbours`."""
X_SCALE_M = 165.0
Y_SCALE_M = 12.0
SPEED_SCALE_MPS = 66.0
RANGE_M = 99.0


class Neighbours(FrozenModel):
    """The observation `neighbours`; it has no options."""

    name: ClassVar[str] = "neighbours"

    @property
    def shape(self) -> tuple[int, int]:
        """The rows and columns of one vehicle's observation."""
        return 7, 5

    def __call__(self, scene: Scene, vehicles: Vehicles) -> Observations:
        """The observations of M vehicles, (M, 7, 5)."""
        observations = np.zeros((vehicles[0].size, 7, 5), dtype=np.float32)
        _fill(scene, vehicles[0], vehicles[1], observations)
        return observations


neighbours = Neighbours()

OBSERVATIONS = {kind.name: kind for kind in (Neighbours, Kinematics)}
"""The observations that have a name."""


def observation_of(like: ObservationLike) -> Observation:
    """The observation itself, made from its name and options if need be.

    Raises:
        InputError: The name is unknown, or the options are wrong.
    """
    return like if callable(like) else named_observation(like)


def named_observation(like: str | Mapping[str, Any]) -> Neighbours | Kinematics:
    """The observation of a name, or of `{type: name, option: value}`; see `observation_of`."""
    options = dict(like) if isinstance(like, Mapping) else {"type": like}
    name = str(options.pop("type", None))[:80]
    if name not in OBSERVATIONS:
        raise InputError(f"no observation named '{name}'. {suggestion(name, OBSERVATIONS)}")
    try:
        return OBSERVATIONS[name].model_validate(options)
    except ValidationError as error:
        location, what = first_problem(error)
        raise InputError(f"observation {name}: {'.'.join(map(str, location))}: {what}") from error


def described(observation: Neighbours | Kinematics) -> str:
    """An observation as text, for the metadata of an ONNX file."""
    if isinstance(observation, Kinematics):
        return json.dumps({"type": observation.name, **observation.model_dump(mode="json")})
    return (
        "neighbours: (7, 5) float32, rows self, left front, left rear, front, rear, right front, "
        "right rear; columns presence, x / 165 m, y / 12 m, vx / 66 m/s, vy / 66 m/s"
    )


def observation_described(text: str) -> Neighbours | Kinematics:
    """The observation that a text from `described` describes.

    Raises:
        InputError: The text describes no known observation.
    """
    if not text.startswith("{"):
        return named_observation(text.partition(":")[0])
    try:
        return named_observation(json.loads(text))
    except (ValueError, RecursionError) as error:
        raise InputError(f"observation: is not JSON: {error}") from error


@compiled_of_scenes
def _fill(scene: Scene, rows: Ints, places: Ints, observations: Observations) -> None:
    x, y, speed, lanes = scene.x, scene.y, scene.speed, scene.constants.lanes
    direction_x, direction_y = scene.direction_x, scene.direction_y
    lane, leaders, followers = scene.lane, scene.leaders, scene.followers
    for m in range(rows.size):
        b, i = rows[m], places[m]
        vx, vy = speed[b, i] * direction_x[b, i], speed[b, i] * direction_y[b, i]
        observations[m, 0, 0] = 1.0
        observations[m, 0, 1] = 1.0
        observations[m, 0, 2] = y[b, i] / Y_SCALE_M
        observations[m, 0, 3] = vx / SPEED_SCALE_MPS
        observations[m, 0, 4] = vy / SPEED_SCALE_MPS
        for side in range(3):
            on = lane[b, i] + side - 1
            if not 0 <= on < lanes:
                continue
            for behind in range(2):
                j = followers[b, i, on] if behind else leaders[b, i, on]
                if j < 0 or abs(x[b, j] - x[b, i]) > RANGE_M:
                    continue
                row = 1 + 2 * side + behind
                other_vx = speed[b, j] * direction_x[b, j]
                other_vy = speed[b, j] * direction_y[b, j]
                observations[m, row, 0] = 1.0
                observations[m, row, 1] = clip((x[b, j] - x[b, i]) / X_SCALE_M, -1.0, 1.0)
                observations[m, row, 2] = clip((y[b, j] - y[b, i]) / Y_SCALE_M, -1.0, 1.0)
                observations[m, row, 3] = clip((other_vx - vx) / SPEED_SCALE_MPS, -1.0, 1.0)
                observations[m, row, 4] = clip((other_vy - vy) / SPEED_SCALE_MPS, -1.0, 1.0)
