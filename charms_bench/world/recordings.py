"""Which moments of recordings the episodes of a suite start at, as YAML says it."""

from typing import Annotated, Literal

from pydantic import Field

from charms_bench.foundation.fields import FilePath, FrozenModel


class Split(FrozenModel):
    """One of the two parts into which recordings are split."""

    by: Literal["driver", "time", "place"]
    """What the two parts do not share. By driver, a fifth of the vehicles are the egos of the test
    part, and both parts meet the same traffic. By time, the last fifth of each recording is the
    test part. By place, the last fifth of the locations is, and at least one."""
    part: Literal["train", "test"]
    """Which of the two parts is used."""


class RecordedMoments(FrozenModel):
    """Moments of recordings in highD's format; a plain string is the folder."""

    plain_text = "folder"
    folder: FilePath
    """The folder of the recordings, relative to the suite's folder."""
    main_lanes: Annotated[int, Field(ge=1)] | None = None
    """The egos start on this many lanes, counted from the left; by default on any."""
    split: Split | None = None
    """The part that is used; by default all."""
    sha256: Annotated[str, Field(pattern=r"^([0-9a-f]{64})?$")] = ""
    """Hash of the files; found when they are first read."""
