"""Scenarios: vehicles placed around the ego, their prescribed actions, and parameters.

Every value is a formula over the parameters, so one scenario describes as many episodes as its
parameters have points; see `points`.
"""

from typing import Annotated, Literal

from pydantic import Field, model_validator

from charms_bench.foundation.fields import UNLESS_EMPTY, Finite, FrozenModel, Line, Name, Positive
from charms_bench.foundation.formula import Formula

EGO = "ego"
"""The ego's name in a scenario."""
PRESCRIBED = "prescribed"
"""What drives a vehicle without an agent: its prescribed actions."""
POINTS_LIMIT = 100_000
"""Most points that a scenario lists."""
Nodes = Annotated[tuple[Name, Name] | None, Field(strict=False), UNLESS_EMPTY]
"""The road between two nodes."""
Node = Annotated[Name | None, UNLESS_EMPTY]
"""The node to which a vehicle drives."""


class Parameter(FrozenModel):
    """A parameter; a plain list of two numbers is its range."""

    range: Annotated[tuple[Finite, Finite], Field(strict=False)]
    """Lowest and highest value."""
    steps: Annotated[int, Field(ge=2, le=10_000)] = 5
    """Values of a grid, evenly spaced over the range."""
    normal: Annotated[tuple[Finite, Positive], Field(strict=False)] | None = None
    """Mean and standard deviation of a normal distribution, truncated to the range; without it,
    the distribution is uniform."""

    @model_validator(mode="before")
    @classmethod
    def _from_range(cls, value: object) -> object:
        return {"range": value} if isinstance(value, list | tuple) else value

    @model_validator(mode="after")
    def _is_ordered(self) -> "Parameter":
        if self.range[0] > self.range[1]:
            raise ValueError(f"range: {self.range[0]:g} exceeds {self.range[1]:g}")
        if self.normal and not self.range[0] <= self.normal[0] <= self.range[1]:
            raise ValueError(f"normal: the mean {self.normal[0]:g} is outside the range")
        return self


class Action(FrozenModel):
    """What a vehicle does from a time on: it accelerates, or it moves to another lane."""

    at_s: Formula
    """Time since the start; the action begins with the first simulation step at or after it."""
    acceleration_mps2: Formula | None = None
    """Acceleration, negative for braking, until the next such action or until `until_mps`."""
    until_mps: Formula | None = None
    """Speed at which the acceleration ends; by default 0 for braking, else the profile's
    highest speed."""
    lane: Formula | None = None
    """Lane whose centre the vehicle moves to, at constant lateral speed."""
    duration_s: Formula | None = None
    """Duration of that movement."""

    @model_validator(mode="after")
    def _is_one_action(self) -> "Action":
        along = self.acceleration_mps2 is not None
        across = self.lane is not None and self.duration_s is not None
        others = self.lane is not None or self.duration_s is not None
        if along == across or (along and others) or (across and self.until_mps is not None):
            raise ValueError(
                "expected acceleration_mps2, with or without until_mps; or lane and duration_s"
            )
        return self


class EgoStart(FrozenModel):
    """Where the ego starts."""

    lane: Formula
    """Its lane; 0 is the leftmost."""
    speed_mps: Formula
    """Its speed at the start."""
    x_m: Formula = 100.0
    """Position of its centre along the road."""
    length_m: Formula | None = None
    """Its length and its width are the profile's by default."""
    width_m: Formula | None = None
    road: Nodes = None
    """On one of the suite's `roads`, the names of the two nodes between which its lane is, such as
    `[b, c]`; by default, where the ego of highway-env's environment starts."""
    destination: Node = None
    """On one of the suite's `roads`, the node to which it drives; by default, it keeps the route of
    the environment, if it starts on it."""


class PlacedVehicle(FrozenModel):
    """A vehicle of the scenario: where it starts, and what drives it."""

    name: Name
    """Its name, for `ahead_of` and `behind` of later vehicles."""
    lane: Formula
    """Its lane; 0 is the leftmost."""
    speed_mps: Formula
    """Its speed at the start."""
    length_m: Formula | None = None
    """Its length and its width are the profile's by default."""
    width_m: Formula | None = None
    x_m: Formula | None = None
    """Position of its centre along the road; or a gap to another vehicle instead."""
    ahead_of: Name | None = None
    """The vehicle, or `ego`, from whose front `gap_m` is measured to this vehicle's rear."""
    behind: Name | None = None
    """The vehicle, or `ego`, from whose rear `gap_m` is measured to this vehicle's front."""
    gap_m: Formula | None = None
    """The gap from bumper to bumper."""
    agent: Line | None = None
    """The agent that drives it; without one, it keeps its speed and lane but for `actions`."""
    driver_parameters: Annotated[dict[Name, Formula], Field(max_length=100)] = {}  # noqa: RUF012
    """Parameters of its driver, for an agent with `DriverModel.parameters`; the middles of their
    ranges by default."""
    actions: Annotated[tuple[Action, ...], Field(max_length=20, strict=False)] = ()
    """What a vehicle without an agent does, at most 20 actions."""
    road: Nodes = None
    """On one of the suite's `roads`, the names of the two nodes between which its `x_m` begins; by
    default, they are those of the ego."""
    destination: Node = None
    """On one of the suite's `roads`, the node to which it drives; by default, it goes on to the
    nearest lane wherever a lane ends."""

    @model_validator(mode="after")
    def _is_placed_once(self) -> "PlacedVehicle":
        by_gap = (self.ahead_of is None) != (self.behind is None) and self.gap_m is not None
        is_free = self.ahead_of is None and self.behind is None and self.gap_m is None
        if not (by_gap and self.x_m is None) and not (is_free and self.x_m is not None):
            raise ValueError("expected x_m, or gap_m with either ahead_of or behind")
        if self.agent is not None and self.actions:
            raise ValueError("actions are for vehicles without an agent")
        if self.agent is None and self.driver_parameters:
            raise ValueError("driver_parameters are for vehicles with an agent")
        if self.agent == PRESCRIBED:
            raise ValueError(f"agent: '{PRESCRIBED}' is what drives a vehicle without an agent")
        return self


class LatinHypercube(FrozenModel):
    """Points of a Latin hypercube, whose number has to be known."""

    latin_hypercube: Annotated[int, Field(ge=1, le=1_000_000)]


class Scenario(FrozenModel):
    """Vehicles around the ego, over the points of a space of parameters."""

    parameters: Annotated[
        dict[Annotated[str, Field(pattern=r"^[a-z][a-z0-9_]{0,39}$")], Parameter],
        Field(max_length=20),
    ] = {}  # noqa: RUF012  # a field of pydantic, which copies it
    """The parameters by name; formulas use these names."""
    points: (
        Literal["sobol", "random", "grid"]
        | LatinHypercube
        | Annotated[
            tuple[dict[str, Finite], ...],
            Field(min_length=1, max_length=POINTS_LIMIT, strict=False),
        ]
    ) = "sobol"
    """Which points are the episodes; an episode's seed is the number of its point."""
    ego: EgoStart
    """Where the ego starts."""
    vehicles: Annotated[
        tuple[PlacedVehicle, ...], Field(min_length=1, max_length=100, strict=False)
    ]
    """The other vehicles, at most 100."""

    @property
    def has_sizes(self) -> bool:
        """Whether it gives the size of a vehicle."""
        starts: tuple[EgoStart | PlacedVehicle, ...] = (self.ego, *self.vehicles)
        return any((each.length_m, each.width_m) != (None, None) for each in starts)

    @property
    def agents(self) -> tuple[str, ...]:
        """What drives each of the vehicles."""
        return tuple(vehicle.agent or PRESCRIBED for vehicle in self.vehicles)
