"""A number of a table, with what is known about it."""

from dataclasses import dataclass, replace


@dataclass(frozen=True)
class Number:
    """A value and what is known about it; None stands for whatever is not defined."""

    value: float | None = None
    low: float | None = None
    """Lower end of the 95 % interval."""
    high: float | None = None
    n: int | None = None
    """How many observations the value is computed from; `Column.counted` says of what."""
    reference: float | None = None
    """The value to compare with, such as the paper's; `Table.reference` names its source."""
    p: float | None = None
    """The p-value, corrected for the number of tests."""
    marked: bool = False
    """Whether the number stands out, for the reason that the table's note gives."""

    def scaled(self, factor: float) -> "Number":
        """The number times a factor, without its reference value."""
        value, low, high = (
            None if each is None else each * factor for each in (self.value, self.low, self.high)
        )
        return replace(self, value=value, low=low, high=high, reference=None)


Cell = Number | str
