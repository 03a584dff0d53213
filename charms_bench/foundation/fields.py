"""Field types of validated models, such as suites."""

import json
import operator
from pathlib import Path
from typing import Annotated, Any, ClassVar, Self

from pydantic import (
    AfterValidator,
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    ValidationError,
    ValidationInfo,
    model_validator,
)
from pydantic_core import InitErrorDetails, PydanticCustomError

from charms_bench.errors import suggestion
from charms_bench.foundation.files import given_once

# Within these bounds, no quantity of a simulation overflows.
Positive = Annotated[float, Field(ge=1e-9, le=1e9)]
NonNegative = Annotated[float, Field(ge=0, le=1e9)]
Finite = Annotated[float, Field(ge=-1e9, le=1e9)]

# Larger numbers are of no road and no vehicle, but mistakes, such as of the unit.
Distance = Annotated[float, Field(ge=1e-9, le=1e6)]
"""m."""
Duration = Annotated[float, Field(ge=1e-9, le=1e5)]
"""s."""
Speed = Annotated[float, Field(ge=1e-9, le=1000)]
"""m/s."""
Velocity = Annotated[float, Field(ge=-1000, le=1000)]
"""m/s, also backwards."""
Acceleration = Annotated[float, Field(ge=1e-9, le=1000)]
"""m/s2."""
Ratio = Annotated[float, Field(ge=1e-9, le=1000)]

UNLESS_EMPTY = Field(exclude_if=operator.not_)
"""Of a field that is younger than stored suites: without a value, it is not written, so that they
keep their fingerprints."""


class FrozenModel(BaseModel):
    """A strict, immutable model in which an unknown key is an error.

    An alias is the name of a field in YAML; run folders have the field's own name.
    """

    model_config = ConfigDict(frozen=True, extra="forbid", strict=True, populate_by_name=True)
    plain_text: ClassVar[str] = ""
    """The field that a plain text stands for, if any."""

    @model_validator(mode="before")
    @classmethod
    def _name_known_keys(cls, data: Any, info: ValidationInfo) -> Any:
        """Says at an unknown key which keys there are, which pydantic's own error does not."""
        if cls.plain_text and isinstance(data, str):
            return {cls.plain_text: data}
        if cls.plain_text and not isinstance(data, dict | BaseModel):
            raise ValueError("expected a text or a mapping")
        known = {field.alias or name: field for name, field in cls.model_fields.items()}
        names = known if info.context else {**known, **cls.model_fields}  # in YAML, or elsewhere
        unknown = [key for key in data if key not in names] if isinstance(data, dict) else []
        if not unknown:
            return data
        shown = {name: field for name, field in known.items() if not field.exclude}
        first = {unknown[0]: f"unknown key. {suggestion(str(unknown[0]), shown)}"}
        problems = []
        for key, what in (dict.fromkeys(unknown, "unknown key") | first).items():
            kind = PydanticCustomError("unknown_key", "{what}", {"what": what})
            problems.append(InitErrorDetails(type=kind, loc=(key,), input=data[key]))
        raise ValidationError.from_exception_data(cls.__name__, problems)

    @classmethod
    def model_validate_json(cls, json_data: str | bytes | bytearray, **options: Any) -> Self:
        """As pydantic's own, which takes the last value of a name that is given twice."""
        found = super().model_validate_json(json_data, **options)
        try:
            json.loads(json_data, object_pairs_hook=given_once)
        except ValueError as error:
            kind = PydanticCustomError("given_twice", "{what}", {"what": str(error)})
            problem = InitErrorDetails(type=kind, input=None)
            raise ValidationError.from_exception_data(cls.__name__, [problem]) from error
        return found


def _printable(text: str) -> str:
    """Rejects characters that move a terminal's cursor or change the writing direction."""
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
