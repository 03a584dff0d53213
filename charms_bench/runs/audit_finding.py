"""What the checks of an audit find."""

from dataclasses import dataclass
from typing import Literal

Verdict = Literal["pass", "fail", "unknown"]
VERDICTS: tuple[Verdict, ...] = ("pass", "unknown", "fail")
"""From the best to the worst."""


@dataclass(frozen=True)
class Finding:
    """What a check has found."""

    check: str
    """`software`, `files`, `networks`, `rows` or `tables`."""
    where: str
    """The file or the place in it; empty for the check as a whole."""
    verdict: Verdict
    what: str
    undrawn: float = 0.0
    """Probability that the sample of this check does not contain a single false shard."""
