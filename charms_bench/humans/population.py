"""Populations of drivers: the aggregate parameters that calibration writes and agents draw from."""

import json
from functools import cached_property
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from pydantic import Field, ValidationError, model_validator

from charms_bench.errors import DataError, first_problem, suggestion
from charms_bench.foundation.fields import Finite, FrozenModel, NonNegative, Positive
from charms_bench.foundation.files import read_limited
from charms_bench.world.scene import Floats

POPULATIONS = Path(__file__).with_name("populations")
"""The populations in the package: `NAME.json`."""
_LIMIT_BYTES = 2**20
Numbers = Annotated[tuple[Finite, ...], Field(strict=False)]


class Artefact(FrozenModel):
    """What the package holds as JSON."""

    def to_json(self) -> str:
        """It as JSON, one field per line."""
        fields = self.model_dump(mode="json")
        lines = [f"  {json.dumps(key)}: {json.dumps(value)}" for key, value in fields.items()]
        return "{\n" + ",\n".join(lines) + "\n}\n"


class LaneChanges(FrozenModel):
    """When drivers change lanes; see `humans.lane_choices`."""

    threshold_mps2: Finite
    scale_mps2: Positive
    speed_mps: Positive
    """The mean recorded speed, at which the probability is that of one second."""
    changes: Annotated[int, Field(ge=0)]
    """Number of lane changes that these numbers rest on."""


class Population(Artefact):
    """Drivers of one data set; two data sets are never pooled."""

    name: str
    origin: str
    terms: str
    """Source and licence of the recording."""
    model: Literal["idm", "fvdm"]
    parameters: Annotated[tuple[str, ...], Field(strict=False)]
    """The model's P parameters, and the two numbers of the situation that follow them."""
    mean: Numbers
    """(P + 2,) mean of their logarithms."""
    covariance: Annotated[tuple[Numbers, ...], Field(strict=False)]
    """(P + 2, P + 2) of their logarithms."""
    not_identified: Annotated[tuple[str, ...], Field(strict=False)]
    """Parameters about which a driver's own trips say less than the other drivers' trips."""
    lag_s: NonNegative
    """Time constant with which the acceleration follows the model's."""
    noise_mps2: NonNegative
    noise_s: Positive
    """Standard deviation and correlation time of the Ornstein-Uhlenbeck process added to it."""
    error: Positive
    correlation_s: Positive
    """Standard deviation of the logarithm of simulated over recorded gap of a driver fitted alone,
    and the time over which it stays alike."""
    drivers: int
    """Number of drivers that were fitted."""
    drivers_at_bound: int
    """How many of them end at a bound if they are fitted alone."""
    held_out: int
    seed: int
    """Number of drivers that were not fitted, and the seed that chose them."""
    lane_changes: LaneChanges | None = None
    """None if the recording has too few lane changes, or no neighbours."""

    @model_validator(mode="after")
    def _sizes_fit(self) -> "Population":
        size = len(self.mean)
        rows = {len(row) for row in self.covariance}
        if len(self.parameters) != size or rows != {size} or len(self.covariance) != size:
            raise ValueError(f"expected {len(self.parameters)} means, and as many rows and columns")
        if np.linalg.eigvalsh(np.array(self.covariance)).min() <= 0:
            raise ValueError("the covariance is not positive definite")
        return self

    @cached_property
    def arrays(self) -> tuple[Floats, Floats]:
        """The mean and the covariance."""
        return np.array(self.mean), np.array(self.covariance)


def read_population(name: str) -> Population:
    """A population of the package by its name, or the one in a JSON file.

    Raises a `DataError` if there is no such population, or the file is not one.
    """
    path = Path(name)
    if path.suffix != ".json":
        known = {each.stem: each for each in sorted(POPULATIONS.glob("*.json"))}
        if name not in known:
            raise DataError(
                f"no population named '{name}'; `charms-bench calibrate` writes one to a file "
                f"that ends in .json. {suggestion(name, known)}"
            )
        path = known[name]
    try:
        data = read_limited(path, _LIMIT_BYTES)
    except OSError as error:
        raise DataError(f"{path}: cannot be read: {error.strerror}") from error
    try:
        return Population.model_validate_json(data)
    except ValidationError as error:
        where, what = first_problem(error)
        raise DataError(f"{path}: {'.'.join(map(str, where))}: {what}") from error
