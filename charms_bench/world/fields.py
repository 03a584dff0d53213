"""Field types of validated models: what a suite or an option may hold."""

from pathlib import Path
from typing import Annotated

from pydantic import AfterValidator, BaseModel, BeforeValidator, ConfigDict, Field

# Within these, no quantity of a simulation leaves what floating-point numbers hold.
Positive = Annotated[float, Field(ge=1e-9, le=1e9)]
NonNegative = Annotated[float, Field(ge=0, le=1e9)]
Finite = Annotated[float, Field(ge=-1e9, le=1e9)]


class FrozenModel(BaseModel):
    """A strict, immutable model in which an unknown key is an error."""

    model_config = ConfigDict(frozen=True, extra="forbid", strict=True)


def _printable(text: str) -> str:
    """Refuses what would move a terminal's cursor or turn the direction of writing."""
    if not text.isprintable():
        raise ValueError("expected characters that can be printed, on one line")
    return text


def _path(value: object) -> object:
    if isinstance(value, str) and (len(value) > 1000 or not value.isprintable()):
        raise ValueError("expected a path of up to 1,000 characters that can be printed")
    return value


Line = Annotated[str, Field(max_length=1000), AfterValidator(_printable)]
Name = Annotated[str, Field(min_length=1, max_length=80), AfterValidator(_printable)]
FilePath = Annotated[Path, Field(strict=False), BeforeValidator(_path)]
