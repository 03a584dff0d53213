"""highway-env's own observation, `Kinematics`, for many vehicles at once.

It has one row per vehicle: first the observing vehicle, then the vehicles within 200 m, sorted by
their distance along the road [`KinematicObservation`, highway-env 1.12].
"""

from functools import cached_property
from typing import Annotated, ClassVar, Literal

import numpy as np
from pydantic import AfterValidator, Field, field_validator

from charms_bench.errors import suggestion
from charms_bench.foundation.compiled import clip, compiled, compiled_of_scenes
from charms_bench.foundation.fields import Finite, FrozenModel
from charms_bench.world.road import local_coordinates
from charms_bench.world.scene import Floats, Ints, Observations, Scene, Vehicles

FEATURES = (
    *("presence", "x", "y", "vx", "vy", "heading", "cos_h", "sin_h"),
    *("cos_d", "sin_d", "long_off", "lat_off", "ang_off"),
)
"""The features that a row can have, of which they are indices [`Vehicle.to_dict`]."""
RELATIVE = ("x", "y", "vx", "vy")
DEFAULT = ("presence", *RELATIVE)
SPEED_MPS = 40.0
"""The default ranges depend on this speed, not on the profile's [Vehicle.MAX_SPEED]."""
LANE_WIDTH_M = 4.0
"""The default ranges depend on this width, likewise [AbstractLane.DEFAULT_WIDTH]."""
PERCEPTION_M = 5.0 * SPEED_MPS
"""[PERCEPTION_DISTANCE]"""


def _known(feature: str) -> str:
    if feature not in FEATURES:
        known = suggestion(feature, dict.fromkeys(FEATURES))
        raise ValueError(f"no feature named '{feature}'. {known}")
    return feature


Feature = Annotated[str, AfterValidator(_known)]
Ranges = dict[Feature, Annotated[tuple[Finite, Finite], Field(strict=False)]]


class Kinematics(FrozenModel):
    """highway-env's `Kinematics`; the options have highway-env's names and defaults.

    `order: shuffled` is not available: it is random, and policies must be deterministic.
    """

    name: ClassVar[str] = "Kinematics"

    vehicles_count: Annotated[int, Field(ge=2, le=2001)] = 5
    """Number of rows."""
    features: Annotated[tuple[Feature, ...], Field(strict=False, min_length=1)] = DEFAULT
    """The columns."""
    features_range: Ranges | None = None
    """The features that are mapped to [-1, 1], and their ranges. By default, x has ±200 m, y has
    ± one lane width times the number of lanes, and vx and vy have ±80 m/s."""
    absolute: bool = False
    """Whether x, y, vx and vy are absolute; otherwise they are relative to the first row."""
    order: Literal["sorted"] = "sorted"
    normalize: bool = True
    """Whether `features_range` applies."""
    clip: bool = True
    """Whether the features that `features_range` maps are clipped to [-1, 1]."""
    see_behind: bool = False
    """Whether to include vehicles more than two vehicle lengths behind."""
    observe_intentions: bool = False
    """Accepted for compatibility: vehicles here plan no route, so cos_d and sin_d are 0."""
    include_obstacles: bool = True
    """Accepted for compatibility: there are no obstacles."""

    @field_validator("features")
    @classmethod
    def _no_feature_twice(cls, value: tuple[str, ...]) -> tuple[str, ...]:
        if len(set(value)) < len(value):
            raise ValueError("a feature is listed twice")
        return value

    @field_validator("features_range")
    @classmethod
    def _ranges_have_a_width(cls, value: Ranges | None) -> Ranges | None:
        for feature, (low, high) in (value or {}).items():
            if low >= high:
                raise ValueError(f"the range of {feature} is {low} to {high}; expected low < high")
        return value

    @property
    def shape(self) -> tuple[int, int]:
        """The rows and columns of one vehicle's observation."""
        return self.vehicles_count, len(self.features)

    def __call__(self, scene: Scene, vehicles: Vehicles) -> Observations:
        """The observations of M vehicles, (M, rows, columns)."""
        rows, places = vehicles
        observations = np.zeros((rows.size, *self.shape), dtype=np.float32)
        lanes = scene.road.lanes
        if (columns := self._columns_by_lanes.get(lanes)) is None:
            columns = self._columns_by_lanes[lanes] = self._columns(lanes)
        _fill(scene, rows, places, self.see_behind, columns, self.clip, observations)
        return observations

    @cached_property
    def _columns_by_lanes(self) -> dict[int, Floats]:
        """What `_columns` has returned so far."""
        return {}

    def _columns(self, lanes: int) -> Floats:
        """What is done to each feature: its index, whether it is relative, and its range.

        A feature without a range has infinite bounds.
        """
        ranges = self._ranges(lanes) if self.normalize else {}
        columns = []
        for feature in self.features:
            is_relative = feature in RELATIVE and not self.absolute
            low, high = ranges.get(feature, (-np.inf, np.inf))
            columns.append((FEATURES.index(feature), is_relative, low, high))
        return np.array(columns, dtype=np.float64)

    def _ranges(self, lanes: int) -> Ranges:
        """[`KinematicObservation.normalize_obs`]"""
        if self.features_range:
            return self.features_range
        limits = (5 * SPEED_MPS, LANE_WIDTH_M * lanes, 2 * SPEED_MPS, 2 * SPEED_MPS)
        return {feature: (-limit, limit) for feature, limit in zip(RELATIVE, limits, strict=True)}


@compiled
def _feature(feature: int, b: int, i: int, scene: Scene) -> float:
    """A feature of a vehicle, by its index in `FEATURES`. Vehicles here have no route."""
    heading = scene.heading[b, i]
    if feature == 0:
        return 1.0
    if feature == 1 or feature == 10:
        return float(scene.x[b, i])
    if feature == 2:
        return float(scene.y[b, i])
    if feature == 3:
        return float(scene.speed[b, i] * scene.direction_x[b, i])
    if feature == 4:
        return float(scene.speed[b, i] * scene.direction_y[b, i])
    if feature == 5:
        return float(heading)
    if feature == 6:
        return float(scene.direction_x[b, i])
    if feature == 7:
        return float(scene.direction_y[b, i])
    if feature == 11:
        x, y, lane = scene.x[b, i], scene.y[b, i], scene.lane[b, i]
        return float(local_coordinates(scene.road, lane, x, y)[1])
    if feature == 12:
        return float((heading + np.pi) % (2 * np.pi) - np.pi)
    return 0.0


@compiled_of_scenes
def _fill(
    scene: Scene,
    rows: Ints,
    places: Ints,
    sees_behind: bool,
    columns: Floats,
    is_clipped: bool,
    observations: Observations,
) -> None:
    """Writes what M vehicles see; see `Kinematics._columns`."""
    nearest = np.empty(observations.shape[1], dtype=np.int64)
    distances = np.empty(nearest.size)
    for m in range(rows.size):
        b, i = rows[m], places[m]
        back_m = np.inf if sees_behind else 2 * scene.length[b, i]
        positions = scene.x[b], scene.y[b], scene.entry[b]
        for k in range(_find_nearest(*positions, i, back_m, nearest, distances)):
            for column in range(len(columns)):
                feature, low, high = int(columns[column, 0]), columns[column, 2], columns[column, 3]
                value = _feature(feature, b, nearest[k], scene)
                if columns[column, 1] and k > 0:
                    value -= _feature(feature, b, i, scene)
                if np.isfinite(low):
                    value = -1 + (value - low) * 2 / (high - low)  # in the order of `utils.lmap`
                    value = clip(value, -1.0, 1.0) if is_clipped else value
                observations[m, k, column] = value


@compiled
def _find_nearest(
    x: Floats, y: Floats, entry: Ints, i: int, back_m: float, nearest: Ints, distances: Floats
) -> int:
    """Writes the places of the vehicles in the rows of vehicle i's observation, and counts them.

    The first is the vehicle itself, then follow the nearest along the road; of two at the same
    distance, the first to enter comes first [`Road.close_objects_to`].
    """
    nearest[0] = i
    count = 1
    for j in range(x.size):
        ahead, across = x[j] - x[i], y[j] - y[i]
        if j == i or not np.sqrt(ahead * ahead + across * across) < PERCEPTION_M:
            continue
        if not -back_m < ahead:
            continue
        k = count
        while k > 1 and (
            abs(ahead) < distances[k - 1]
            or (abs(ahead) == distances[k - 1] and entry[j] < entry[nearest[k - 1]])
        ):
            k -= 1
        if k == nearest.size:
            continue
        count = min(count + 1, nearest.size)
        for later in range(count - 1, k, -1):
            nearest[later], distances[later] = nearest[later - 1], distances[later - 1]
        nearest[k], distances[k] = j, abs(ahead)
    return count
