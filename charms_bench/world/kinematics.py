"""highway-env's own observation, `Kinematics`, of many vehicles at once.

A row a vehicle: first the one that looks, then the others within 200 m, nearest along the road
first. [`KinematicObservation`, highway-env 1.12]
"""

from collections.abc import Callable
from typing import Annotated, ClassVar, Literal

import numpy as np
from pydantic import AfterValidator, Field, field_validator

from charms_bench.world.compiled import compiled
from charms_bench.world.fields import Finite, FrozenModel
from charms_bench.world.scene import Floats, Ints, Observations, Scene, Vehicles

FEATURES: dict[str, Callable[[Scene, Vehicles], Floats]] = {
    "presence": lambda scene, seen: np.ones(seen[1].shape),
    "x": lambda scene, seen: scene.x[seen],
    "y": lambda scene, seen: scene.y[seen],
    "vx": lambda scene, seen: scene.speed[seen] * scene.direction_x[seen],
    "vy": lambda scene, seen: scene.speed[seen] * scene.direction_y[seen],
    "heading": lambda scene, seen: scene.heading[seen],
    "cos_h": lambda scene, seen: scene.direction_x[seen],
    "sin_h": lambda scene, seen: scene.direction_y[seen],
    "cos_d": lambda scene, seen: np.zeros(seen[1].shape),  # where a route leads: nobody has one
    "sin_d": lambda scene, seen: np.zeros(seen[1].shape),
    "long_off": lambda scene, seen: scene.x[seen],
    "lat_off": lambda scene, seen: scene.y[seen] - scene.lane[seen] * scene.constants.lane_width,
    "ang_off": lambda scene, seen: (scene.heading[seen] + np.pi) % (2 * np.pi) - np.pi,
}
"""What can stand in a row [`Vehicle.to_dict`]."""
RELATIVE = ("x", "y", "vx", "vy")
SPEED_MPS = 40.0
"""What ranges follow from, whatever the profile's fastest speed is [Vehicle.MAX_SPEED]."""
LANE_WIDTH_M = 4.0
"""Likewise [AbstractLane.DEFAULT_WIDTH]."""
PERCEPTION_M = 5.0 * SPEED_MPS
"""[PERCEPTION_DISTANCE]"""


def _known(feature: str) -> str:
    if feature not in FEATURES:
        raise ValueError(f"no feature '{feature}'; there are: {', '.join(FEATURES)}")
    return feature


Feature = Annotated[str, AfterValidator(_known)]


class Kinematics(FrozenModel):
    """highway-env's `Kinematics`; its options, by their names there and with their defaults.

    `order: shuffled` draws at random and is none of them: a policy decides the same again.
    """

    name: ClassVar[str] = "Kinematics"

    vehicles_count: Annotated[int, Field(ge=2, le=501)] = 5
    """Rows."""
    features: Annotated[tuple[Feature, ...], Field(strict=False, min_length=1)] = (
        "presence",
        *RELATIVE,
    )
    """Columns."""
    features_range: dict[Feature, Annotated[tuple[Finite, Finite], Field(strict=False)]] | None = (
        None
    )
    """What is mapped to [-1, 1], and from where; by default x from 200 m either way, y from a lane
    width either way for every lane, vx and vy from 80 m/s either way."""
    absolute: bool = False
    """Whether x, y, vx and vy of the others are as on the road, not relative to the first row's."""
    order: Literal["sorted"] = "sorted"
    normalize: bool = True
    """Whether `features_range` applies."""
    clip: bool = True
    """Whether what it applies to is clipped to [-1, 1]."""
    see_behind: bool = False
    """Whether to look further back than two vehicle lengths."""
    observe_intentions: bool = False
    """Whether cos_d and sin_d hold a direction: not where nobody plans a route, as here."""
    include_obstacles: bool = True
    """Of which there are none."""

    @field_validator("features")
    @classmethod
    def _no_feature_twice(cls, value: tuple[str, ...]) -> tuple[str, ...]:
        if len(set(value)) < len(value):
            raise ValueError("a feature stands here twice")
        return value

    @field_validator("features_range")
    @classmethod
    def _ranges_have_a_width(
        cls, value: dict[str, tuple[float, float]] | None
    ) -> dict[str, tuple[float, float]] | None:
        for feature, (low, high) in (value or {}).items():
            if low >= high:
                raise ValueError(f"the range of {feature} is not from low to high")
        return value

    @property
    def shape(self) -> tuple[int, int]:
        """The rows and columns that one vehicle sees."""
        return self.vehicles_count, len(self.features)

    def __call__(self, scene: Scene, vehicles: Vehicles) -> Observations:
        """What M vehicles see, (M, rows, columns)."""
        rows, places = vehicles
        nearest = np.full((rows.size, self.vehicles_count), -1)
        back_m = np.inf if self.see_behind else 2 * scene.constants.length
        _find_nearest(scene.x, scene.y, rows, places, back_m, nearest)
        seen = (np.broadcast_to(rows[:, None], nearest.shape), nearest)
        columns = [self._column(feature, scene, seen) for feature in self.features]
        observations = np.stack(columns, axis=-1, dtype=np.float32)
        observations[nearest < 0] = 0.0
        return observations

    def _column(self, feature: str, scene: Scene, seen: Vehicles) -> Floats:
        """A feature of the vehicles that M others see, (M, rows)."""
        values = FEATURES[feature](scene, seen)
        if feature in RELATIVE and not self.absolute:
            values[:, 1:] -= values[:, :1]
        limits = self._ranges(scene.constants.lanes).get(feature)
        if limits is None or not self.normalize:
            return values
        low, high = limits
        values = -1 + (values - low) * 2 / (high - low)  # [`utils.lmap`], in its order
        return values.clip(-1.0, 1.0) if self.clip else values

    def _ranges(self, lanes: int) -> dict[str, tuple[float, float]]:
        """[`KinematicObservation.normalize_obs`]"""
        if self.features_range:
            return self.features_range
        limits = (5 * SPEED_MPS, LANE_WIDTH_M * lanes, 2 * SPEED_MPS, 2 * SPEED_MPS)
        return {feature: (-limit, limit) for feature, limit in zip(RELATIVE, limits, strict=True)}


@compiled
def _find_nearest(
    x: Floats, y: Floats, rows: Ints, places: Ints, back_m: float, nearest: Ints
) -> None:
    """Writes for M vehicles whom they see, (M, rows): itself, then the nearest along the road.

    Of two that are equally far, first the one that was spawned first. Places that nobody takes
    are left. [`Road.close_objects_to`]
    """
    distances = np.empty(nearest.shape[1])
    for m in range(rows.size):
        b, i = rows[m], places[m]
        nearest[m, 0] = i
        count = 1
        for j in range(x.shape[1]):
            ahead, across = x[b, j] - x[b, i], y[b, j] - y[b, i]
            if j == i or not np.sqrt(ahead * ahead + across * across) < PERCEPTION_M:
                continue
            if not -back_m < ahead:
                continue
            k = count
            while k > 1 and abs(ahead) < distances[k - 1]:
                k -= 1
            if k == nearest.shape[1]:
                continue
            count = min(count + 1, nearest.shape[1])
            for later in range(count - 1, k, -1):
                nearest[m, later], distances[later] = nearest[m, later - 1], distances[later - 1]
            nearest[m, k], distances[k] = j, abs(ahead)
