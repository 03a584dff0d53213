"""Types of vehicles in the traffic, such as cars and trucks, and how common each is."""

import math
from collections.abc import Mapping, Sequence
from typing import Annotated

import numpy as np
from pydantic import AfterValidator, Field, model_validator

from charms_bench.errors import ScenarioError, suggestion
from charms_bench.foundation.arrays import Floats
from charms_bench.foundation.fields import UNLESS_EMPTY, Finite, FrozenModel, Name, Positive, Speed
from charms_bench.world.parameter_points import DECIMALS, truncated_normal

TRUCK_LENGTH_M = 8.0
"""Exports call a vehicle of at least this length a truck."""
LENGTHS_M, WIDTHS_M = (1.0, 30.0), (0.5, 5.0)
"""The bounds of sizes other than the profile's."""
OF_VEHICLES = ("desired_speed_mps", "length_m", "width_m")
"""What is drawn for a vehicle, whatever its driver."""
Range = tuple[float, float]


def _ordered(value: Range) -> Range:
    if value[0] > value[1]:
        raise ValueError(f"{value[0]:g} exceeds {value[1]:g}")
    return value


Uniform = Annotated[tuple[Finite, Finite], Field(strict=False), AfterValidator(_ordered)]


class Distribution(FrozenModel):
    """A distribution, truncated to a range."""

    range: Uniform
    """Least and largest value."""
    normal: Annotated[tuple[Finite, Positive], Field(strict=False)] | None = None
    """Mean and standard deviation."""
    lognormal: Annotated[tuple[Positive, Positive], Field(strict=False)] | None = None
    """Median, and the standard deviation of the logarithm."""

    @model_validator(mode="after")
    def _is_one(self) -> "Distribution":
        if (self.normal is None) == (self.lognormal is None):
            raise ValueError("expected either normal or lognormal")
        center = (self.normal or self.lognormal or self.range)[0]
        if not self.range[0] <= center <= self.range[1]:
            raise ValueError(f"range: the center {center:g} is outside")
        if self.lognormal and self.range[0] <= 0:
            raise ValueError(f"range: {self.range[0]:g}; a lognormal distribution is above 0")
        return self

    def quantiles(self, uniforms: Floats) -> Floats:
        """The values below which these proportions (M,) of the distribution lie."""
        low, high = self.range
        if self.normal is not None:
            values = truncated_normal(uniforms, self.normal, self.range)
        else:
            assert self.lognormal is not None
            normal = math.log(self.lognormal[0]), self.lognormal[1]
            bounds = math.log(low), math.log(high)
            values = np.exp(truncated_normal(uniforms, normal, bounds))
        # Rounded, so that the last bits of the distribution's function do not matter.
        return np.asarray(np.clip(np.round(values, DECIMALS), low, high))


Length = Annotated[float, Field(ge=LENGTHS_M[0], le=LENGTHS_M[1])]
Width = Annotated[float, Field(ge=WIDTHS_M[0], le=WIDTHS_M[1])]


class VehicleType(FrozenModel):
    """A type of vehicle; what it does not give is the profile's."""

    name: Name
    """Its name, for `ego_type`."""
    share: Annotated[float, Field(gt=0, le=1, alias="proportion")]
    """The proportion of vehicles of this type; those of all types sum to 1."""
    length_m: Length | Distribution | None = None
    """Its length; by default the profile's."""
    width_m: Width | Distribution | None = None
    """Its width; by default the profile's."""
    desired_speed_mps: (
        Annotated[tuple[Speed, Speed], Field(strict=False), AfterValidator(_ordered)]
        | Distribution
        | None
    ) = None
    """The range of desired speeds, which are drawn uniformly, or their distribution; by default, a
    vehicle wants the speed at which it starts."""
    driver_parameters: Annotated[dict[Name, Uniform | Distribution], Field(max_length=100)] = {}  # noqa: RUF012
    """Ranges or distributions that replace the ranges of `DriverModel.parameters`, in which they
    must lie."""
    correlations: Annotated[
        tuple[
            Annotated[tuple[Name, Name, Annotated[float, Field(ge=-1, le=1)]], Field(strict=False)],
            ...,
        ],
        Field(strict=False, max_length=1000),
        UNLESS_EMPTY,
    ] = ()
    """Two quantities of the type, and the correlation of the normal scores of their values; all
    other quantities are independent (a Gaussian copula)."""

    @model_validator(mode="after")
    def _fits_together(self) -> "VehicleType":
        for name, bounds in (("length_m", LENGTHS_M), ("width_m", WIDTHS_M)):
            low, high = range_of(getattr(self, name) or bounds)
            if low < bounds[0] or high > bounds[1]:
                raise ValueError(
                    f"{name}: {low:g} to {high:g}; expected {bounds[0]:g} to {bounds[1]:g}"
                )
        if range_of(self.desired_speed_mps or (1.0, 1.0))[0] <= 0:
            raise ValueError("desired_speed_mps: expected speeds above 0")
        drawn = [
            name for name in OF_VEHICLES if isinstance(getattr(self, name), tuple | Distribution)
        ]
        names = [*drawn, *self.driver_parameters]
        pairs = [frozenset(pair[:2]) for pair in self.correlations]
        for pair in pairs:
            for name in pair:
                if name not in names:
                    known = suggestion(name, dict.fromkeys(names))
                    raise ValueError(f"correlations: the type draws no '{name}'. {known}")
            if len(pair) < 2 or pairs.count(pair) > 1:
                raise ValueError(f"correlations: '{min(pair)}' twice; expected pairs, each once")
        if self.correlations and np.linalg.eigvalsh(self.correlation_matrix(names)).min() < 1e-9:
            raise ValueError("correlations: no distribution has these; use weaker ones")
        return self

    def correlation_matrix(self, names: Sequence[str]) -> Floats:
        """The correlations (K, K) of the normal scores of K quantities."""
        matrix = np.eye(len(names))
        for one, other, correlation in self.correlations:
            if one in names and other in names:
                i, j = names.index(one), names.index(other)
                matrix[i, j] = matrix[j, i] = correlation
        return matrix

    def correlated(self, names: Sequence[str], uniforms: Floats) -> Floats:
        """Correlated uniform numbers (M, K) of K quantities, from independent ones.

        Those of the first quantities do not depend on which quantities come after them.
        """
        if not self.correlations:
            return uniforms
        from scipy.special import ndtr, ndtri

        scores = ndtri(np.clip(uniforms, 1e-16, 1 - 1e-16))
        factor = np.linalg.cholesky(self.correlation_matrix(names))
        # No product of matrices: the order of its sums depends on the processor.
        return np.asarray(ndtr((scores[:, None, :] * factor).cumsum(axis=2)[:, :, -1]))


def range_of(value: float | Range | Distribution) -> Range:
    """The least and the largest value that can be drawn."""
    if isinstance(value, Distribution):
        return value.range
    return value if isinstance(value, tuple) else (value, value)


def drawn_from(value: float | Range | Distribution, uniforms: Floats) -> Floats:
    """The values (M,) of a distribution at uniform numbers (M,); a range has the uniform one."""
    if isinstance(value, Distribution):
        return value.quantiles(uniforms)
    low, high = range_of(value)
    return np.asarray(low + (high - low) * uniforms)


def check_driver_parameters(
    types: Sequence[VehicleType], models: Mapping[str, Mapping[str, Range]]
) -> None:
    """Checks the driver parameters of types against the ranges of the models in a cell, by agent.

    Raises:
        ScenarioError: No model has such a parameter, or a model's range is narrower.
    """
    known = dict.fromkeys(name for ranges in models.values() for name in ranges)
    for k, each in enumerate(types):
        for name, given in each.driver_parameters.items():
            low, high = range_of(given)
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
