"""Reference histograms of human driving, which simulated driving is compared with."""

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import numpy as np
from pydantic import Field, model_validator

from charms_bench.errors import suggestion
from charms_bench.foundation.fields import FilePath, FrozenModel, Name
from charms_bench.humans.following_samples import DECISION_HZ, LANE_CHANGE_SPEED_MPS, followers
from charms_bench.humans.population import Artefact
from charms_bench.world.following_bins import BIN, BINS, FOLLOWING_RANGE_M, bins_of
from charms_bench.world.recording_folder import read_folder
from charms_bench.world.scene import Floats, Ints

LEADER = f"leader within {FOLLOWING_RANGE_M:g} m in the same lane, centre to centre"
SPEED = f"speed along the road with a {LEADER}, at {DECISION_HZ} Hz"
DHW = f"distance to a {LEADER}, at the start of a lane change"
START = (
    "the start is the last moment before the vehicle leaves its lane at which its speed towards "
    f"the new lane is {LANE_CHANGE_SPEED_MPS:g} m/s or less"
)
BINNING = f"{BINS} bins of {BIN:g} m/s and {BIN:g} m from 0; the last bin has no upper limit"

REFERENCES = Path(__file__).with_name("references")
"""The references in the package: `NAME.json`."""

Counts = Annotated[tuple[Annotated[int, Field(ge=0)], ...], Field(min_length=BINS, max_length=BINS)]


class ReferenceSpec(FrozenModel):
    """Names a reference in the package, or a folder of recordings in highD's format."""

    plain_text = "name"
    name: Name | None = None
    """A reference in the package: `i24`, `i75`, `us101_corrected` or `us101`."""
    recordings: FilePath | None = None
    """A folder of recordings, relative to the suite's folder."""
    label: Name | None = None
    """Its name in tables; by default its name, or that of the folder."""

    @model_validator(mode="after")
    def _one_of_two(self) -> "ReferenceSpec":
        if (self.name is None) == (self.recordings is None):
            raise ValueError("give a name, or a folder of recordings as {recordings: path}")
        known = {path.stem: path for path in sorted(REFERENCES.glob("*.json"))}
        if self.name is not None and self.name not in known:
            raise ValueError(
                f"no reference named '{self.name}'; a folder of recordings is "
                f"{{recordings: path}}. {suggestion(self.name, known)}"
            )
        return self

    @property
    def title(self) -> str:
        """The reference's name in tables."""
        folder = self.recordings or Path()
        return self.label or self.name or folder.name or str(folder)


class Reference(Artefact):
    """What recorded drivers did while they followed; two references are never pooled."""

    name: str
    origin: str
    """Where and how the drivers were recorded, with the limits of the recording."""
    terms: str
    """Source and licence of the recording."""
    speed_is: str
    dhw_is: str
    """Definitions of the two quantities."""
    binning: str = BINNING
    vehicles: int
    """Number of recorded vehicles, with or without a leader."""
    lane_changes: int | None
    """Number of recorded lane changes, with or without a leader; None if lanes are unknown."""
    unit: str
    """What is taken to be independent of each other: vehicles, recordings or runs."""
    speed: tuple[Counts, ...]
    """Speeds of drivers at decisions in each unit, in the bins of `world.following_bins`;
    empty if the quantity was not recorded."""
    dhw: tuple[Counts, ...]
    """Distance headways at starts of lane changes, likewise."""

    def __repr__(self) -> str:
        counted = {"speeds": self.counts("speed"), "distance headways": self.counts("dhw")}
        parts = [f"{int(n.sum()):,} {what}" for what, n in counted.items() if n is not None]
        return f"<Reference {self.name}: {', '.join([f'{self.vehicles:,} vehicles', *parts])}>"

    def __str__(self) -> str:
        return f"{self!r}\n{self.origin}\nTerms: {self.terms}"

    def units(self, quantity: str) -> Floats:
        """[U, BINS] counts of a quantity of `world.following_bins.QUANTITIES`, by unit with any."""
        counts = np.array({"speed": self.speed, "dhw": self.dhw}[quantity], dtype=np.float64)
        counts = counts.reshape(-1, BINS)
        return counts[counts.any(axis=1)]

    def counts(self, quantity: str) -> Floats | None:
        """(BINS,) counts of all units; None if nothing was recorded."""
        units = self.units(quantity)
        return units.sum(axis=0) if len(units) else None


def histograms(values: Floats, units: Ints) -> tuple[tuple[int, ...], ...]:
    """(BINS,) number of values in each bin, for each unit; `units` has that of each value."""
    return tuple(
        tuple(np.bincount(bins_of(values[units == unit]), minlength=BINS).tolist())
        for unit in np.unique(units)
    )


def references() -> dict[str, Reference]:
    """The references in the package, by the names that suites use.

    Each has its origin, the terms of the recording, the number of recorded vehicles, and the counts
    of speeds and distance headways; `counts("speed")` sums them over all recorded units.
    """
    return {path.stem: _read(path) for path in sorted(REFERENCES.glob("*.json"))}


def _read(path: Path) -> Reference:
    return Reference.model_validate_json(path.read_bytes(), strict=False)


def read_references(specs: Sequence[ReferenceSpec], folder: Path) -> list[Reference]:
    """The references of a suite; relative paths of recordings start at `folder`.

    Raises a `DataError` if the recordings cannot be used.
    """
    return [
        from_recordings(folder / spec.recordings, name=spec.title)
        if spec.recordings is not None
        else _read(REFERENCES / f"{spec.name}.json").model_copy(update={"name": spec.title})
        for spec in specs
    ]


def from_recordings(folder: Path, **fields: str) -> Reference:
    """A reference made from a folder of recordings in highD's format.

    By default, its `fields` name, origin and terms are derived from the folder's name. Raises a
    `DataError` if the recordings cannot be used.
    """
    found = followers(read_folder(folder))
    described = {
        "name": folder.resolve().name,
        "origin": f"recordings in {folder}",
        "terms": "the terms of the recordings",
        "speed_is": SPEED,
        "dhw_is": f"{DHW}; {START}",
    } | fields
    return Reference(
        **described,
        vehicles=found.vehicles,
        lane_changes=found.lane_changes,
        unit=found.unit,
        speed=histograms(found.speed, found.speed_units),
        dhw=histograms(found.dhw, found.dhw_units),
    )
