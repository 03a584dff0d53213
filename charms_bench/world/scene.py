"""The state of B scenes of N vehicles, as arrays.

Lane 0 is the leftmost and its centre is y = 0; y grows to the right, x along the road, and a
heading is positive towards the right.

N is a capacity: a vehicle has a place, and there can be empty places (`Scene.present`). Its number,
which no other vehicle of the episode has, does not depend on its place (`Scene.entry`).
"""

from functools import cached_property, lru_cache
from typing import Annotated, Any, Protocol

import numpy as np
from numpy.typing import NDArray
from pydantic import (
    BeforeValidator,
    Field,
    SerializerFunctionWrapHandler,
    ValidationError,
    model_serializer,
    model_validator,
)
from pydantic_core import InitErrorDetails, PydanticCustomError

from charms_bench.errors import InputError, suggestion
from charms_bench.foundation.arrays import Bools as Bools
from charms_bench.foundation.arrays import Floats as Floats
from charms_bench.foundation.arrays import Ints as Ints
from charms_bench.foundation.compiled import Unpacked, unpacked
from charms_bench.foundation.fields import Duration, FrozenModel, Name, Ratio
from charms_bench.world.candidate_lanes import CANDIDATES, neighbours_on
from charms_bench.world.gaps import gap_to
from charms_bench.world.named_road import DRAWN, NamedRoad
from charms_bench.world.profile import CHARMS, PROFILES, Constants, Profile
from charms_bench.world.recordings import RecordedMoments
from charms_bench.world.road import Straight, distance_along
from charms_bench.world.road_network import Network
from charms_bench.world.scenario import Scenario
from charms_bench.world.scene_arrays import SceneArrays
from charms_bench.world.vehicle_types import LENGTHS_M, WIDTHS_M, VehicleType, range_of

Vehicles = tuple[Ints, ...]
"""M vehicles: their scenes (M,) and their places in them (M,). Indexes any `[B, N]` array."""
Observations = NDArray[np.float32]
"""(M, rows, columns): the observations of M vehicles."""
EVALUATION_SEEDS = 1_000_000_000
"""Seeds of evaluation episodes lie below this number; those of training episodes do not."""
VACANT_X_M = -1e7
"""Where the vehicles of empty places stand, each 1 km further: on no lane, and near nobody."""
SIMULATION_HZ_LIMIT = 1000
DECISIONS_LIMIT = 20_000
"""The most decisions of an episode: almost two hours at the usual 3 Hz."""


def _with_overrides(value: object) -> object:
    """The profile's fields, from its name or from its name and other values for some fields."""
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


@lru_cache
def _decisions_until(duration_s: float, decision_hz: int) -> int:
    """The decisions until the sum of their intervals reaches a duration [`AbstractEnv.step`]."""
    decisions, time = 0, 0.0
    while time < duration_s:
        decisions, time = decisions + 1, time + 1 / decision_hz
    return decisions


class Inflow(FrozenModel):
    """Open boundaries: vehicles also enter at the start of the road, and leave at its end."""

    vehicles_per_hour_and_lane: Annotated[float, Field(gt=0, le=10_000)]
    """How many arrive, on average; the times between two arrivals are exponentially distributed."""
    capacity: Annotated[int, Field(ge=1, le=5000)]
    """How many vehicles that have entered can be on the road at once; more are an error."""


_OF_CELLS = {
    "road": "give it as one of the suite's `roads`",
    "network": "give it as one of the suite's `roads`",
    "scenario": "give the scenario as a traffic model",
}
"""What the road or the traffic model of a cell decides, and no key of a scene."""


ProfileLike = Annotated[Profile, BeforeValidator(_with_overrides)]
"""A profile, its name, or its name and other values for some of its fields."""


class SceneSettings(FrozenModel):
    """What every scene of a suite has in common."""

    profile: ProfileLike = CHARMS
    """A profile, its name, or its name and other values for some of its fields. With `roads`, the
    default is `roads`."""
    lanes: Annotated[int, Field(ge=2, le=8)] = 3
    """Lanes of the road; lane 0 is the leftmost."""
    traffic_vehicles: Annotated[int, Field(ge=0, le=2000)] = 20
    """Vehicles around the ego at the start."""
    density: Ratio = 1.0
    """The distances between vehicles at the start are proportional to 1 / density."""
    ego_slots: Annotated[int, Field(ge=1)] = 6
    """How many of the first vehicles can be the ego; each is equally likely."""
    simulation_hz: Annotated[int, Field(ge=1, le=SIMULATION_HZ_LIMIT)] = 15
    """Simulation steps per second."""
    decision_hz: Annotated[int, Field(ge=1, le=1000)] = 3
    """Rows per second: how often the ego's decisions are recorded and, with the `ego_control_rate`
    `decision`, how often its control changes, whatever the rate of its agent."""
    duration_s: Duration = 20.0
    """Duration of an episode, unless the ego crashes first."""
    vehicle_types: Annotated[tuple[VehicleType, ...], Field(max_length=100, strict=False)] = ()
    """Types of vehicles, which are drawn for each vehicle; if empty, all are the profile's."""
    ego_type: Name | None = None
    """The type of the ego; by default, the ego is the profile's vehicle."""
    inflow: Inflow | None = None
    """Vehicles that enter the road during the episode; by default, none do, and the road is longer
    than any vehicle drives. With it, the road has the length that the profile says, and the episode
    ends when the ego has reached its end. On one of the suite's `roads`, vehicles enter where its
    lanes begin."""
    recording: RecordedMoments | None = None
    """Recordings at moments of which episodes start. They decide the lanes' width and the number of
    vehicles, and of lanes if it is not given: that of most vehicles."""
    network: Annotated[NamedRoad | None, Field(exclude=True)] = None
    """The road of highway-env that the scene has; a suite gives it as one of its `roads`."""
    scenario: Annotated[Scenario | None, Field(exclude=True)] = None
    """The scenario that places the vehicles; a suite gives it as the traffic model."""

    @model_validator(mode="before")
    @classmethod
    def _of_cells(cls, value: Any) -> Any:
        """Rejects keys that a suite gives as a road or as a traffic model."""
        for name, what in _OF_CELLS.items() if isinstance(value, dict) else ():
            if name in value:
                kind = PydanticCustomError("of_cells", "{what}", {"what": what})
                unknown = InitErrorDetails(type=kind, loc=(name,), input=value[name])
                raise ValidationError.from_exception_data(cls.__name__, [unknown])
        return value

    @model_validator(mode="after")
    def _rates_fit(self) -> "SceneSettings":
        if self.simulation_hz % self.decision_hz:
            raise ValueError(
                f"simulation_hz {self.simulation_hz} is not a multiple of "
                f"decision_hz {self.decision_hz}"
            )
        is_unread = self.recording is not None and not self.recording.sha256
        if self.ego_slots > 1 + self.traffic_vehicles and not is_unread:
            raise ValueError(
                f"ego_slots {self.ego_slots} exceeds the {1 + self.traffic_vehicles} vehicles of a "
                "scene"
            )
        if self.inflow and self._spawned_within_m > self.profile.road_length_m:
            raise ValueError(
                f"profile.road_length_m: with the inflow, {self.profile.road_length_m:g} m are too "
                f"short for the {1 + self.traffic_vehicles} vehicles at the start; expected at "
                f"least {self._spawned_within_m:.0f} m"
            )
        self._check_types()
        if not self.duration_s * self.decision_hz <= DECISIONS_LIMIT:
            raise ValueError(
                f"duration_s is longer than {DECISIONS_LIMIT:,} decisions, which are kept in memory"
            )
        if self.decisions < 1:
            raise ValueError("duration_s is shorter than one decision")
        return self

    def simulation_hz_for(self, hz: float) -> int | None:
        """The lowest `simulation_hz`, from this one on, with whole steps between an agent's
        decisions, too; None if there is none."""
        rates = range(self.simulation_hz, SIMULATION_HZ_LIMIT + 1, self.decision_hz)
        return next((rate for rate in rates if hz > 0 and (rate / hz).is_integer()), None)

    def _check_types(self) -> None:
        names = [each.name for each in self.vehicle_types]
        if names and abs(sum(each.share for each in self.vehicle_types) - 1) > 1e-9:
            total = sum(each.share for each in self.vehicle_types)
            raise ValueError(f"vehicle_types: the proportions sum to {total:g}; expected 1")
        if len(set(names)) < len(names):
            raise ValueError("vehicle_types: two types have the same name")
        if self.ego_type not in (None, *names):
            known = suggestion(str(self.ego_type), dict.fromkeys(names))
            raise ValueError(f"ego_type: no vehicle type called '{self.ego_type}'. {known}")
        slowest, fastest = self.profile.speed_min_mps, self.profile.speed_max_mps
        for k, each in enumerate(self.vehicle_types):
            low, high = range_of(each.desired_speed_mps or (slowest, fastest))
            if low < slowest or high > fastest:
                raise ValueError(
                    f"vehicle_types[{k}].desired_speed_mps: {low:g} to {high:g} is outside the "
                    f"profile's speeds; expected {max(slowest, 0):g} to {fastest:g}"
                )

    @model_serializer(mode="wrap")
    def _without_types(self, dump: SerializerFunctionWrapHandler) -> dict[str, Any]:
        """As before there were some fields, if they are empty: a suite keeps its fingerprint."""
        fields: dict[str, Any] = dump(self)
        new = ("vehicle_types", "ego_type", "inflow", "recording")
        return {name: value for name, value in fields.items() if value or name not in new}

    def of_scenario(self, scenario: Scenario | None) -> "SceneSettings":
        """The same settings for the vehicles of a scenario; for None, these settings.

        A scenario gives its vehicles' sizes itself, so types have no effect on it.

        Raises:
            InputError: Something else places vehicles, too.
        """
        if scenario is None:
            return self
        for name in ("inflow", "recording"):
            if getattr(self, name):
                raise InputError(f"scene.{name}: a scenario places all vehicles; remove one")
        changes = {"scenario": scenario, "traffic_vehicles": len(scenario.vehicles), "ego_slots": 1}
        changes |= {"vehicle_types": (), "ego_type": None, "inflow": None}
        return self.model_copy(update=changes)

    @property
    def is_recorded(self) -> bool:
        """Whether vehicles start where they were recorded."""
        starts_recorded = self.network is not None and self.network.start != DRAWN
        return self.recording is not None or starts_recorded

    def check_straight(self, what: str) -> None:
        """Raises an `InputError` on a road of highway-env, where something is not possible."""
        if self.network is not None:
            raise InputError(f"{what} the straight road, not the road '{self.network}'")

    @property
    def straight_inflow(self) -> Inflow | None:
        """The inflow of a straight road, where replays name vehicles by the order of entry; on
        other roads, they name places."""
        return self.inflow if self.network is None else None

    @property
    def vehicles(self) -> int:
        """The places for vehicles in a scene, including the ego's."""
        return self.traffic_vehicles + 1 + (self.inflow.capacity if self.inflow else 0)

    @property
    def decisions(self) -> int:
        """The decisions of a full episode."""
        if not self.profile.sums_time:
            return round(self.duration_s * self.decision_hz)
        return _decisions_until(self.duration_s, self.decision_hz)

    @property
    def steps_per_decision(self) -> int:
        """The simulation steps of a decision interval."""
        return self.simulation_hz // self.decision_hz

    @property
    def sizes_m(self) -> list[tuple[float, float]]:
        """The least and the largest length and width of each vehicle type, then the profile's.

        If a scenario gives sizes or recordings do, the bounds of these follow.
        """
        length, width = self.profile.vehicle_length_m, self.profile.vehicle_width_m
        own: list[tuple[float, float]] = []
        for each in self.vehicle_types:
            sizes = range_of(each.length_m or length), range_of(each.width_m or width)
            own += zip(*sizes, strict=True)
        bounds = zip(LENGTHS_M, WIDTHS_M, strict=True)
        has_bounds = self.scenario is not None and self.scenario.has_sizes
        has_bounds |= self.is_recorded
        return [*own, (length, width), *(bounds if has_bounds else ())]

    @property
    def road_length_m(self) -> float:
        """The profile's road, or one that is long enough for all vehicles until the end.

        With an inflow, it is the profile's, and what the ego drives in a decision interval more, so
        that the ego is on the road when its episode ends.
        """
        profile = self.profile
        fastest = max(profile.speed_limit_mps, profile.speed_max_mps, profile.ego_speed_mps)
        if self.straight_inflow:
            return profile.road_length_m + fastest / self.decision_hz
        return max(profile.road_length_m, self._spawned_within_m + fastest * self.duration_s)

    @property
    def _spawned_within_m(self) -> float:
        """No vehicle spawns further along the road."""
        profile, vehicles = self.profile, 1 + self.traffic_vehicles
        fastest = max(profile.speed_limit_mps, profile.speed_max_mps, profile.ego_speed_mps)
        spacing = max(profile.ego_spacing or 0.0, 1 / self.density)
        # Each vehicle spawns at most this far ahead of the furthest before it [`engine.spawning`].
        furthest = 1.1 * spacing * (12 + fastest) * (vehicles + 3)
        longest = max(length for length, _ in self.sizes_m)
        return furthest + (longest - profile.vehicle_length_m) * vehicles

    @property
    def road(self) -> Straight:
        """The road of a scene."""
        limit = self.profile.speed_limit_mps
        return Straight(self.lanes, self.profile.lane_width_m, self.road_length_m, limit)

    @property
    def constants(self) -> Constants:
        """The constants of a scene as compiled code reads them."""
        return self.profile.constants(1.0 / self.simulation_hz, len(self.sizes_m) > 1)


class Junctions(Protocol):
    """What is along and across the ways of vehicles, where a road has junctions."""

    def describe(
        self, vehicles: Vehicles, observations: Observations, occlusion: bool, exit_lanes: bool
    ) -> None:
        """Completes the observations `interaction` of M vehicles; see `interaction_observation`."""

    def observe(self, vehicles: Vehicles) -> NDArray[Any]:
        """The observations `highway_env` of M vehicles; see `highway_env_observation`."""


class Scene(SceneArrays):
    """B scenes of N vehicles. A driver model may only write `WRITABLE` of its own vehicles."""

    def __repr__(self) -> str:
        scenes, vehicles = self.x.shape
        lanes = np.size(self.road.lanes) if isinstance(self.road, Network) else self.road.lanes
        return f"<Scene: {scenes} scenes x {vehicles} vehicles, {lanes} lanes>"

    @cached_property
    def unpacked(self) -> Unpacked:
        """The scene for compiled code, which unpacks it once."""
        return unpacked(self)

    @cached_property
    def junctions(self) -> Junctions | None:
        """The junctions of the road; None on a straight road."""
        return None

    def at(self, junctions: Junctions | None) -> "Scene":
        """The same scenes, on a road with junctions or without."""
        scene = super()._replace()
        if junctions is not None:
            vars(scene)["junctions"] = junctions
        return scene

    def _replace(self, **arrays: Any) -> "Scene":
        """The same scenes with other arrays, at the same junctions."""
        return super()._replace(**arrays).at(self.junctions)

    def __getstate__(self) -> None:
        """A copy of the scene is unpacked anew."""

    def __setattr__(self, name: str, value: object) -> None:
        raise AttributeError(f"scene.{name} cannot be set; a scene is read-only")

    @classmethod
    def empty(
        cls, settings: SceneSettings, scenes: int, parameters: int = 0, memory: int = 0
    ) -> "Scene":
        """Some scenes of vehicles of the profile's size, all zeros else; an engine fills them.

        P is `parameters` and Q is `memory`.
        """
        shape = (scenes, settings.vehicles)
        places = np.tile(np.arange(settings.vehicles, dtype=np.int32), (scenes, 1))
        nobody = np.full((*shape, len(CANDIDATES)), -1, dtype=np.int32)
        per_vehicle: dict[str, NDArray[Any]] = {
            name: np.zeros(shape, dtype)
            for dtype, names in _PER_VEHICLE.items()
            for name in names.split()
        }
        per_vehicle["present"][:] = True
        per_vehicle["direction_x"][:] = 1.0
        per_vehicle["length"][:] = settings.profile.vehicle_length_m
        per_vehicle["width"][:] = settings.profile.vehicle_width_m
        return cls(
            **per_vehicle,
            parameters=np.zeros((*shape, parameters)),
            memory=np.zeros((*shape, memory)),
            generator=np.zeros((scenes, 6), dtype=np.uint64),
            ego=np.zeros(scenes, dtype=np.int64),
            active=np.zeros(scenes, dtype=np.bool_),
            entry=places,
            order=places.copy(),
            rank=places.copy(),
            leaders=nobody,
            followers=nobody.copy(),
            road=settings.road,
            constants=settings.constants,
        )

    def read_only(self) -> "Scene":
        """The same scenes for a plugin, which can write to `WRITABLE` only."""
        views = {name: getattr(self, name).view() for name in ARRAYS}
        for name, view in views.items():
            view.flags.writeable = name in WRITABLE
        return self._replace(**views)

    def leader(self, vehicles: Vehicles, lane: Ints) -> tuple[Ints, Bools]:
        """The nearest vehicle at or ahead of each vehicle on a lane; see `candidate_lanes`.

        Args:
            vehicles: M vehicles.
            lane: (M,) the lane to search; there are no vehicles on lanes outside the road.

        Returns:
            The places (M,), which are only meaningful where the mask (M,) beside them is true.
        """
        return self._neighbour(0, vehicles, lane)

    def follower(self, vehicles: Vehicles, lane: Ints) -> tuple[Ints, Bools]:
        """The nearest vehicle behind each vehicle on a lane; see `leader`."""
        return self._neighbour(1, vehicles, lane)

    def gap_to(self, vehicles: Vehicles, ahead: Ints) -> Floats:
        """The gaps (M,) from the fronts of M vehicles to the rears of the vehicles `ahead` (M,), m.

        `ahead` are places in the same scenes, as `leader` returns them.
        """
        other = vehicles[0], ahead
        positions = self.x[vehicles], self.y[vehicles], self.x[other], self.y[other]
        distance = distance_along(self.road, self.lane[vehicles], *positions)
        return np.asarray(gap_to(distance, self.length[vehicles], self.length[other]))

    def _neighbour(self, which: int, vehicles: Vehicles, lane: Ints) -> tuple[Ints, Bools]:
        on_road = (lane >= 0) & (lane < self.road.lanes)
        found = neighbours_on(self, vehicles[0], vehicles[1], np.where(on_road, lane, 0))[which]
        present = on_road & (found >= 0)
        return np.where(present, found, 0), present


_PER_VEHICLE: dict[type, str] = {
    np.float64: "x y heading direction_x direction_y speed acceleration steering length width "
    "target_speed timer_s temperament impact_x impact_y",
    np.int64: "lane target_lane repeats",
    np.bool_: "present crashed impact",
}
"""The arrays [B, N] of a `Scene` by the type of their values."""
WRITABLE = ("timer_s", "memory")
"""The arrays that a driver model may change for its own vehicles."""
ARRAYS = tuple(name for name in Scene._fields if name not in ("road", "constants"))
"""The fields of a `Scene` that are arrays."""
