"""Types of vehicles in a traffic, such as cars and trucks, and how common each is."""

from typing import Annotated

from pydantic import Field, model_validator

from charms_bench.foundation.fields import Finite, FrozenModel, Name, Positive

TRUCK_LENGTH_M = 8.0
"""Exports call a vehicle of at least this length a truck."""
Range = Annotated[tuple[Finite, Finite], Field(strict=False)]
Length = Annotated[float, Field(ge=1, le=30)]
Width = Annotated[float, Field(ge=0.5, le=5)]


class VehicleType(FrozenModel):
    """A type; what it does not give is that of every other vehicle."""

    name: Name
    share: Annotated[float, Field(gt=0, le=1)]
    """The proportion of vehicles of this type; those of all types sum to 1."""
    length_m: Length | None = None
    """The profile's `vehicle_length_m` by default."""
    width_m: Width | None = None
    """The profile's `vehicle_width_m` by default."""
    desired_speed_mps: Annotated[tuple[Positive, Positive], Field(strict=False)] | None = None
    """The range of desired speeds, which are drawn uniformly; by default, a vehicle wants the speed
    at which it starts."""
    driver_parameters: Annotated[dict[Name, Range], Field(max_length=100)] = {}  # noqa: RUF012
    """Narrower ranges for parameters of the drivers, for agents with `DriverModel.parameters`."""

    @model_validator(mode="after")
    def _ranges_are_ordered(self) -> "VehicleType":
        ranges = {
            f"driver_parameters.{name}": each for name, each in self.driver_parameters.items()
        }
        for name, (low, high) in {
            "desired_speed_mps": self.desired_speed_mps or (0, 0),
            **ranges,
        }.items():
            if low > high:
                raise ValueError(f"{name}: {low:g} exceeds {high:g}")
        return self
