"""The state of B scenes of N vehicles, as arrays.

Lane 0 is the leftmost and its centre is y = 0; y grows to the right, x along the road, and a
heading is positive towards the right. Vehicles keep the order in which they were spawned.
"""

from typing import Annotated, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from pydantic import BeforeValidator, Field, model_validator

from charms_bench.errors import suggestion
from charms_bench.world.fields import FrozenModel, Positive
from charms_bench.world.lanes import is_on_lane
from charms_bench.world.profile import CHARMS, PROFILES, Constants, Profile, constants

Floats = NDArray[np.float64]
Ints = NDArray[np.signedinteger[Any]]
Bools = NDArray[np.bool_]
Vehicles = tuple[Ints, ...]
"""M vehicles: their scenes (M,) and their places in them (M,); indexes any `[B, N]` array."""
Observations = NDArray[np.float32]
"""(M, rows, columns): what M vehicles see."""
EVALUATION_SEEDS = 1_000_000_000
"""Episodes of evaluations have seeds below this, those of trainings above."""
DECISIONS_LIMIT = 20_000
"""Of an episode, almost two hours at the usual 3 Hz."""


def _with_overrides(value: object) -> object:
    """A profile by name, or by name with other values for some of its fields."""
    name = value.get("name") if isinstance(value, dict) else value
    if isinstance(value, Profile) or not isinstance(name, str):
        return value
    if name not in PROFILES:
        raise ValueError(f"no profile named '{name}'. {suggestion(name, PROFILES)}")
    merged = PROFILES[name].model_dump()
    for key, override in (value if isinstance(value, dict) else {}).items():
        if isinstance(override, dict) and isinstance(merged.get(key), dict):
            merged[key] = {**merged[key], **override}
        else:
            merged[key] = override
    return merged


class SceneSettings(FrozenModel):
    """What every scene of a suite has in common."""

    profile: Annotated[Profile, BeforeValidator(_with_overrides)] = CHARMS
    """A profile, its name, or its name with other values for some of its fields."""
    lanes: Annotated[int, Field(ge=2, le=8)] = 3
    traffic_vehicles: Annotated[int, Field(ge=0, le=500)] = 20
    density: Positive = 1.0
    ego_slots: Annotated[int, Field(ge=1)] = 6
    """The ego is one of this many first vehicles, each equally likely."""
    simulation_hz: Annotated[int, Field(ge=1, le=1000)] = 15
    decision_hz: Annotated[int, Field(ge=1, le=1000)] = 3
    duration_s: Positive = 20.0

    @model_validator(mode="after")
    def _rates_fit(self) -> "SceneSettings":
        if self.simulation_hz % self.decision_hz:
            raise ValueError(
                f"simulation_hz {self.simulation_hz} is no multiple of "
                f"decision_hz {self.decision_hz}"
            )
        if self.ego_slots > self.vehicles:
            raise ValueError(
                f"ego_slots {self.ego_slots} exceeds the {self.vehicles} vehicles of a scene"
            )
        if not self.duration_s * self.decision_hz <= DECISIONS_LIMIT:
            raise ValueError(
                f"duration_s is longer than {DECISIONS_LIMIT:,} decisions, which are kept in memory"
            )
        if self.decisions < 1:
            raise ValueError("duration_s is shorter than one decision")
        return self

    @property
    def vehicles(self) -> int:
        """Vehicles in a scene, the ego included."""
        return self.traffic_vehicles + 1

    @property
    def decisions(self) -> int:
        """Decisions in a full episode."""
        return round(self.duration_s * self.decision_hz)

    @property
    def constants(self) -> Constants:
        """The constants of a scene as compiled code reads them."""
        return constants(self.profile, self.lanes, self.simulation_hz)


class Scene(NamedTuple):
    """B scenes of N vehicles. A driver model may write `timer_s` of its vehicles, nothing else."""

    x: Floats
    """[B, N] centre along the road, m."""
    y: Floats
    """[B, N] centre across the road, m."""
    heading: Floats
    """[B, N] rad."""
    direction_x: Floats
    """[B, N] cosine of the heading."""
    direction_y: Floats
    """[B, N] sine of the heading."""
    speed: Floats
    """[B, N] along the heading, m/s."""
    acceleration: Floats
    """[B, N] as commanded and clipped in the last simulation step, m/s2."""
    steering: Floats
    """[B, N] steering angle of the last simulation step, rad."""
    target_speed: Floats
    """[B, N] the speed the driver wants, m/s."""
    lane: Ints
    """[B, N] nearest lane."""
    target_lane: Ints
    """[B, N] the lane steered to; differs from `lane` during a lane change."""
    crashed: Bools
    """[B, N] whether the vehicle has collided."""
    timer_s: Floats
    """[B, N] time since the driver model set it to 0; starts within a lane-change period."""
    temperament: Floats
    """[B, N] a number in [0, 1] drawn once a vehicle, for what varies between drivers."""
    ego: Ints
    """[B] the ego's place."""
    active: Bools
    """[B] whether the scene still runs; an ended one stays as it was."""
    order: Ints
    """[B, N] the vehicles' places, sorted by x."""
    rank: Ints
    """[B, N] each vehicle's index in `order`."""
    leaders: Ints
    """[B, N, L] nearest vehicle ahead on each lane, -1 for none; see `leader`."""
    followers: Ints
    """[B, N, L] nearest vehicle behind on each lane, -1 for none; see `follower`."""
    impact_x: Floats
    """[B, N] displacement a collision causes in the next step, m."""
    impact_y: Floats
    impact: Bools
    """[B, N] whether there is one."""
    constants: Constants

    @classmethod
    def empty(cls, settings: SceneSettings, scenes: int) -> "Scene":
        """`scenes` scenes without a state yet."""
        shape = (scenes, settings.vehicles)

        def floats() -> Floats:
            return np.zeros(shape)

        def ints(*more: int) -> Ints:
            return np.zeros(shape + more, dtype=np.int64)

        def bools() -> Bools:
            return np.zeros(shape, dtype=np.bool_)

        return cls(
            x=floats(),
            y=floats(),
            heading=floats(),
            direction_x=np.ones(shape),
            direction_y=floats(),
            speed=floats(),
            acceleration=floats(),
            steering=floats(),
            target_speed=floats(),
            lane=ints(),
            target_lane=ints(),
            crashed=bools(),
            timer_s=floats(),
            temperament=floats(),
            ego=np.zeros(scenes, dtype=np.int64),
            active=np.zeros(scenes, dtype=np.bool_),
            order=np.tile(np.arange(shape[1]), (scenes, 1)),
            rank=np.tile(np.arange(shape[1]), (scenes, 1)),
            leaders=np.full((*shape, settings.lanes), -1, dtype=np.int64),
            followers=np.full((*shape, settings.lanes), -1, dtype=np.int64),
            impact_x=floats(),
            impact_y=floats(),
            impact=bools(),
            constants=settings.constants,
        )

    def leader(self, vehicles: Vehicles, lane: Ints) -> tuple[Ints, Bools]:
        """The nearest vehicle at or ahead of each vehicle on a lane.

        highway-env's rule (`Road.neighbour_vehicles`): a vehicle is on a lane while its centre
        is at most half a lane and 1 m from the lane's centre, so it can be on two.

        Args:
            vehicles: M vehicles.
            lane: (M,) the lane to look on; one outside the road has nobody.

        Returns:
            Its place (M,), only meaningful where the mask (M,) beside it is true.
        """
        return self._neighbour(self.leaders, vehicles, lane)

    def follower(self, vehicles: Vehicles, lane: Ints) -> tuple[Ints, Bools]:
        """The nearest vehicle behind each vehicle on a lane; see `leader`."""
        return self._neighbour(self.followers, vehicles, lane)

    def _neighbour(self, table: Ints, vehicles: Vehicles, lane: Ints) -> tuple[Ints, Bools]:
        on_road = (lane >= 0) & (lane < self.constants.lanes)
        found = table[vehicles[0], vehicles[1], np.where(on_road, lane, 0)]
        present = on_road & (found >= 0)
        return np.where(present, found, 0), present

    @property
    def off_road(self) -> Bools:
        """[B, N] whether the vehicle's centre is beside its lane [`RoadObject.on_road`]."""
        margin = 0.0
        return np.asarray(~is_on_lane(self.x, self.y, self.lane, self.constants, margin))
