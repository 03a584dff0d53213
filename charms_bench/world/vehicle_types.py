"""Types of vehicles in a traffic, such as cars and trucks, and how common each is."""

from collections.abc import Mapping, Sequence
from typing import Annotated

from pydantic import AfterValidator, Field

from charms_bench.errors import ScenarioError, suggestion
from charms_bench.foundation.fields import Finite, FrozenModel, Name, Positive

TRUCK_LENGTH_M = 8.0
"""Exports call a vehicle of at least this length a truck."""
LENGTHS_M, WIDTHS_M = (1.0, 30.0), (0.5, 5.0)
"""The bounds of sizes other than the profile's."""


def _ordered(value: tuple[float, float]) -> tuple[float, float]:
    if value[0] > value[1]:
        raise ValueError(f"{value[0]:g} exceeds {value[1]:g}")
    return value


class VehicleType(FrozenModel):
    """A type; its vehicles are the profile's but for what it gives."""

    name: Name
    share: Annotated[float, Field(gt=0, le=1)]
    """The proportion of vehicles of this type; those of all types sum to 1."""
    length_m: Annotated[float, Field(ge=LENGTHS_M[0], le=LENGTHS_M[1])] | None = None
    width_m: Annotated[float, Field(ge=WIDTHS_M[0], le=WIDTHS_M[1])] | None = None
    desired_speed_mps: (
        Annotated[tuple[Positive, Positive], Field(strict=False), AfterValidator(_ordered)] | None
    ) = None
    """The range of desired speeds, which are drawn uniformly; by default, a vehicle wants the speed
    at which it starts."""
    driver_parameters: Annotated[
        dict[Name, Annotated[tuple[Finite, Finite], Field(strict=False), AfterValidator(_ordered)]],
        Field(max_length=100),
    ] = {}  # noqa: RUF012
    """Ranges that replace those of `DriverModel.parameters`, in which they must lie."""


def check_driver_parameters(
    types: Sequence[VehicleType], models: Mapping[str, Mapping[str, tuple[float, float]]]
) -> None:
    """Checks the driver parameters of types against the ranges of the models in a cell, by agent.

    Raises:
        ScenarioError: No model has such a parameter, or a model's range is narrower.
    """
    known = dict.fromkeys(name for ranges in models.values() for name in ranges)
    for k, each in enumerate(types):
        for name, (low, high) in each.driver_parameters.items():
            at = ("vehicle_types", k, "driver_parameters", name)
            if name not in known:
                agents = ", ".join(models)
                what = f"no driver of {agents} has a parameter '{name}'. {suggestion(name, known)}"
                raise ScenarioError(at, what)
            for agent, ranges in models.items():
                least, most = ranges.get(name, (low, high))
                if low < least or high > most:
                    what = f"{low:g} to {high:g} is outside the range of agent '{agent}'"
                    raise ScenarioError(at, f"{what}; expected {least:g} to {most:g}")
