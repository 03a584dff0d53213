"""A profile: the constants of the road, the vehicles and their controllers.

Four are built in: `charms`, the constants of the CHARMS paper and its release, `roads`, the same
at any speed from 0, `highway-env`, the values highway-env 1.12 ships with, and `naturalistic`, in
which vehicles also queue and stop. A suite names one and may override any field. The names in
brackets are highway-env's.
"""

import math
from itertools import pairwise
from typing import Annotated, Literal, NamedTuple

from pydantic import Field, model_validator

from charms_bench.foundation.fields import (
    UNLESS_EMPTY,
    Acceleration,
    Distance,
    Duration,
    FrozenModel,
    Ratio,
    Speed,
    Velocity,
)
from charms_bench.world.actions import STEPS_LIMIT


class IdmMobilParameters(NamedTuple):
    """`IdmMobilConstants` as compiled code reads them."""

    acceleration_mps2: float
    deceleration_mps2: float
    jam_distance_m: float
    time_headway_s: float
    exponent_low: float
    exponent_high: float
    acceleration_limit_mps2: float
    politeness: float
    lane_change_gain_mps2: float
    imposed_braking_mps2: float
    lane_change_period_s: float
    least_gap_m: float = -math.inf


class Constants(NamedTuple):
    """The constants of the vehicles of a scene as compiled code reads them; SI units."""

    length: float
    """Of a vehicle whose size nothing else gives, as `width`."""
    width: float
    mixed_sizes: bool
    """Whether other sizes can occur; loops that read sizes only then are faster without."""
    speed_min: float
    speed_max: float
    can_reverse: bool
    tau_acceleration: float
    tau_heading: float
    tau_lateral: float
    steering_limit: float
    dt: float
    idm_mobil: IdmMobilParameters


class IdmMobilConstants(FrozenModel):
    """IDM (Treiber et al. 2000) and MOBIL (Kesting et al. 2007) as `IDMVehicle` combines them."""

    acceleration_mps2: Acceleration = 3.0
    """Desired maximum acceleration, a [COMFORT_ACC_MAX]."""
    deceleration_mps2: Acceleration = 5.0
    """Comfortable deceleration, b [-COMFORT_ACC_MIN]."""
    jam_distance_m: Distance = 10.0
    """Distance to a stationary leader, centre to centre, s0 [DISTANCE_WANTED]."""
    time_headway_s: Duration = 1.5
    """Desired time headway, T [TIME_WANTED]."""
    exponent_low: Ratio = 3.5
    """Smallest acceleration exponent, delta [DELTA_RANGE]."""
    exponent_high: Ratio = 4.5
    """Largest acceleration exponent; each driver's lies uniformly between the two."""
    acceleration_limit_mps2: Acceleration = 6.0
    """Bound of the commanded acceleration, either way [ACC_MAX]."""
    politeness: Annotated[float, Field(ge=0, le=1000)] = 0.0
    """Weight of the followers' accelerations in MOBIL's incentive [POLITENESS]."""
    lane_change_gain_mps2: Annotated[float, Field(ge=-1000, le=1000)] = 0.2
    """Acceleration that a lane change must gain [LANE_CHANGE_MIN_ACC_GAIN]."""
    imposed_braking_mps2: Acceleration = 2.0
    """Braking that may be imposed on the new follower [LANE_CHANGE_MAX_BRAKING_IMPOSED]."""
    lane_change_period_s: Duration = 1.0
    """Time between two considerations of a lane change [LANE_CHANGE_DELAY]."""
    least_gap_m: Annotated[float | None, Field(ge=0, le=1e6), UNLESS_EMPTY] = None
    """The desired gap is at least this, centre to centre. Without it, as in highway-env, vehicles
    want no gap behind a leader that is much faster, and so cut in beside others."""


class Profile(FrozenModel):
    """The constants of every vehicle and every scene of a suite."""

    name: str
    lane_width_m: Annotated[float, Field(ge=0.1, le=100)] = 4.0
    """Width of every lane."""
    road_length_m: Distance = 10_000.0
    """The least length; scenes with more vehicles than fit have a longer road."""
    speed_limit_mps: Speed
    """Speed limit of the road."""
    vehicle_length_m: Annotated[float, Field(ge=0.1, le=100)] = 5.0
    """Length of a vehicle without a type."""
    vehicle_width_m: Annotated[float, Field(ge=0.1, le=20)] = 2.0
    """Width of a vehicle without a type."""
    speed_min_mps: Velocity
    """A slower vehicle is accelerated towards this speed [MIN_SPEED]."""
    speed_max_mps: Speed
    """A faster vehicle is braked towards this speed [MAX_SPEED]."""
    can_reverse: Annotated[bool, Field(exclude_if=bool)] = True
    """Whether a vehicle that brakes passes through 0 to negative speeds, as in highway-env; if not,
    it stops, and its acceleration in that simulation step is the one that stops it."""
    tau_acceleration_s: Duration
    """Time constant of the speed controller [TAU_ACC]."""
    tau_heading_s: Duration
    """Time constant of the heading controller [TAU_HEADING]."""
    tau_lateral_s: Duration
    """Time constant of the lateral position controller [TAU_LATERAL]."""
    steering_limit_rad: Annotated[float, Field(ge=1e-9, le=1.57)] = 1.0471975511965976
    """[MAX_STEERING_ANGLE], pi / 3."""
    lane_command_from: Literal["current_lane", "target_lane"]
    """The lane that LANE_LEFT and LANE_RIGHT refer to."""
    target_speed_step_mps: Speed = 5.0
    """FASTER and SLOWER change the target speed by this, unless one of the next two is given."""
    target_speed_steps_mps: Annotated[
        tuple[Speed, ...], Field(strict=False, max_length=STEPS_LIMIT), UNLESS_EMPTY
    ] = ()
    """Changes that grow while a vehicle repeats FASTER or SLOWER: the first by which it changes its
    target speed, then the second, and so on to the last. Any other meta-action begins anew. A
    policy may have steps of its own; see `plugins.agent.Policy`."""
    target_speed_min_mps: Velocity
    """Lowest target speed."""
    target_speed_max_mps: Speed
    """Highest target speed."""
    target_speeds_mps: tuple[Velocity, ...] = Field(default=(), strict=False, max_length=100)
    """Evenly spaced target speeds between which FASTER and SLOWER choose [target_speeds]."""
    spawn_speed_low: Ratio = 0.7
    """Smallest initial speed of the traffic, as a proportion of the speed limit."""
    spawn_speed_high: Ratio = 0.8
    """Largest initial speed of the traffic, as a proportion of the speed limit."""
    ego_speed_mps: Speed
    """Initial speed of the ego."""
    ego_spacing: Ratio | None = None
    """Spacing at which the ego spawns; by default that of the traffic, 1 / density."""
    ego_control_rate: Literal["decision", "simulation"]
    """How often the ego's steering and acceleration are computed: once per decision (zero-order
    hold) or in every simulation step."""
    offroad_terminal: bool
    """Whether the episode ends when the ego leaves the road."""
    sums_time: bool
    """Whether an episode's time is the sum of its decision intervals, rounded at every decision as
    in highway-env. Some durations then take one decision more, such as 20 s at 3 Hz."""
    idm_mobil: IdmMobilConstants = IdmMobilConstants()

    @model_validator(mode="after")
    def _ranges_are_ordered(self) -> "Profile":
        for low, high in (
            ("speed_min_mps", "speed_max_mps"),
            ("target_speed_min_mps", "target_speed_max_mps"),
            ("spawn_speed_low", "spawn_speed_high"),
        ):
            if getattr(self, low) > getattr(self, high):
                raise ValueError(f"{low} {getattr(self, low)} exceeds {high} {getattr(self, high)}")
        if self.idm_mobil.exponent_low > self.idm_mobil.exponent_high:
            raise ValueError("idm_mobil.exponent_low exceeds idm_mobil.exponent_high")
        if len(self.target_speeds_mps) == 1:
            raise ValueError("target_speeds_mps needs none or at least two speeds")
        if len(self.target_speed_steps_mps) == 1:
            raise ValueError("target_speed_steps_mps needs none or at least two steps")
        if any(faster <= slower for slower, faster in pairwise(self.target_speeds_mps)):
            raise ValueError("target_speeds_mps are not in increasing order")
        if self.target_speeds_mps and self.target_speed_steps_mps:
            raise ValueError("expected target_speeds_mps or target_speed_steps_mps, not both")
        return self

    def beginning_at(self, speed_mps: float) -> "Profile":
        """The same profile, whose target speeds begin at a lower speed if they are all above it.

        Target speeds that are listed go on in the same distances until one is not above the speed.
        """
        if speed_mps >= self.target_speed_min_mps:
            return self
        speeds = self.target_speeds_mps
        if speeds:
            distance = (speeds[-1] - speeds[0]) / (len(speeds) - 1)
            more = math.ceil((speeds[0] - speed_mps) / distance)
            speeds = (*(speeds[0] - k * distance for k in range(more, 0, -1)), *speeds)
        changes = {"target_speed_min_mps": speed_mps, "target_speeds_mps": speeds}
        return self.model_copy(update=changes)

    def constants(self, dt: float, mixed_sizes: bool = False) -> Constants:
        """The constants as compiled code reads them, for simulation steps of `dt` seconds."""
        return Constants(
            length=self.vehicle_length_m,
            width=self.vehicle_width_m,
            mixed_sizes=mixed_sizes,
            speed_min=self.speed_min_mps,
            speed_max=self.speed_max_mps,
            can_reverse=self.can_reverse,
            tau_acceleration=self.tau_acceleration_s,
            tau_heading=self.tau_heading_s,
            tau_lateral=self.tau_lateral_s,
            steering_limit=self.steering_limit_rad,
            dt=dt,
            idm_mobil=IdmMobilParameters(**self.idm_mobil.model_dump()),
        )


CHARMS = Profile(
    name="charms",
    speed_limit_mps=33.0,
    speed_min_mps=22.0,
    speed_max_mps=33.0,
    tau_acceleration_s=0.8,
    tau_heading_s=0.5,
    tau_lateral_s=1.5,
    lane_command_from="current_lane",
    target_speed_step_mps=1.0,
    target_speed_min_mps=22.0,
    target_speed_max_mps=33.0,
    ego_speed_mps=30.0,
    ego_control_rate="decision",
    offroad_terminal=True,
    sums_time=False,
    idm_mobil=IdmMobilConstants(time_headway_s=1.0),
)
"""The constants of the CHARMS paper and its release."""

ROADS = CHARMS.model_copy(
    update={
        "name": "roads",
        "speed_min_mps": 0.0,
        "target_speed_min_mps": 0.0,
        "ego_control_rate": "simulation",
    }
)
"""CHARMS's constants at any speed from 0, with the ego's control in every simulation step: the
default on all roads but straight motorways, where vehicles turn, yield and stop."""

HIGHWAY_ENV = Profile(
    name="highway-env",
    speed_limit_mps=30.0,
    speed_min_mps=-40.0,
    speed_max_mps=40.0,
    tau_acceleration_s=0.6,
    tau_heading_s=0.2,
    tau_lateral_s=0.6,
    lane_command_from="target_lane",
    target_speed_min_mps=20.0,
    target_speed_max_mps=30.0,
    target_speeds_mps=(20.0, 25.0, 30.0),
    ego_speed_mps=25.0,
    ego_spacing=2.0,
    ego_control_rate="simulation",
    offroad_terminal=False,
    sums_time=True,
)
"""The values highway-env 1.12's `highway-v0` ships with."""

NATURALISTIC = Profile(
    name="naturalistic",
    speed_limit_mps=36.0,
    speed_min_mps=0.0,
    speed_max_mps=36.0,
    can_reverse=False,
    tau_acceleration_s=0.8,
    tau_heading_s=0.5,
    tau_lateral_s=2.0,
    lane_command_from="target_lane",
    target_speed_steps_mps=(0.25, 0.5, 1.0, 2.0),
    target_speed_min_mps=0.0,
    target_speed_max_mps=36.0,
    ego_speed_mps=28.0,
    ego_control_rate="simulation",
    offroad_terminal=True,
    sums_time=False,
    idm_mobil=IdmMobilConstants(
        acceleration_mps2=1.4,
        deceleration_mps2=2.0,
        jam_distance_m=7.0,
        time_headway_s=1.2,
        acceleration_limit_mps2=8.0,
        politeness=0.2,
        least_gap_m=7.0,
    ),
)
"""Vehicles that queue, stop and start, at up to 130 km/h. IDM's accelerations and jam distance, 2 m
between bumpers, are those of Kesting et al. (2010, Enhanced IDM, table 1)."""

PROFILES = {profile.name: profile for profile in (CHARMS, ROADS, HIGHWAY_ENV, NATURALISTIC)}
