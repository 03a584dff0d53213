"""Field types of validated models, such as suites."""

from pathlib import Path
from typing import Annotated

from pydantic import AfterValidator, BaseModel, BeforeValidator, ConfigDict, Field

# Within these bounds, no quantity of a simulation overflows.
Positive = Annotated[float, Field(ge=1e-9, le=1e9)]
NonNegative = Annotated[float, Field(ge=0, le=1e9)]
Finite = Annotated[float, Field(ge=-1e9, le=1e9)]


class FrozenModel(BaseModel):
    """A strict, immutable model in which an unknown key is an error."""

    model_config = ConfigDict(frozen=True, extra="forbid", strict=True)


def _printable(text: str) -> str:
    """Refuses characters that move a terminal's cursor or change the writing direction."""
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
