"""Learning curves: the points of both kinds of stages, and their CSV file."""

import csv
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, fields
from io import StringIO
from pathlib import Path
from typing import Any

from charms_bench.engine.endings import GOAL, OFF_ROAD, TIME
from charms_bench.foundation.files import write_bytes


@dataclass(frozen=True)
class Point:
    """What is known of the episodes that ended since the previous point; None without episodes."""

    steps: int
    episodes: int
    return_mean: float | None
    """Mean over episodes of the sum of rewards."""
    length_mean: float | None
    """Mean number of decisions of an episode."""
    crashed_share: float | None
    off_road_share: float | None
    loss: float | None
    """Mean loss of the last gradient steps."""
    exploration: float
    """Probability of a random action."""

    @property
    def in_words(self) -> str:
        """The point for a progress bar; empty without episodes."""
        if self.return_mean is None or self.crashed_share is None:
            return ""
        return f"return {self.return_mean:z.1f}, {self.crashed_share:.0%} crashed"


@dataclass(frozen=True)
class Epoch:
    """What is known of a network that learns from human driving, after an epoch."""

    epoch: int
    """Epochs so far; 0 is before the first."""
    loss: float
    """L_total, eq. 11, over all training samples."""
    temperature: float
    """T at which the training samples are the most likely under softmax(Q / T)."""
    log_likelihood: float | None
    """Mean of the sum of y log softmax(Q / T) over held-out samples, in nats; None without any."""
    agreement: float | None
    """Proportion of held-out samples in which the network's action is the label's most probable
    one, or one of several; None if no samples are held out."""

    @property
    def in_words(self) -> str:
        """The point for a progress bar."""
        agrees = "" if self.agreement is None else f", agrees with {self.agreement:.1%}"
        return f"loss {self.loss:.3f}{agrees}"


def point_of(
    ended: Sequence[Mapping[str, Any]], steps: int, loss: float, exploration: float
) -> Point:
    """The point of the episodes that ended since the previous point."""
    count = len(ended)
    endings = [episode["ending"] for episode in ended]
    off_road = endings.count(OFF_ROAD)
    crashed = count - off_road - endings.count(TIME) - endings.count(GOAL)

    def mean(total: float) -> float | None:
        return total / count if count else None

    return Point(
        steps=steps,
        episodes=count,
        return_mean=mean(sum(episode["episode_return"] for episode in ended)),
        length_mean=mean(sum(episode["steps"] for episode in ended)),
        crashed_share=mean(crashed),
        off_road_share=mean(off_road),
        loss=loss if loss == loss else None,
        exploration=exploration,
    )


def write_csv(path: Path, kind: type[Point | Epoch], curve: Sequence[Point | Epoch]) -> None:
    """Writes one row per point, with the fields of `kind` as columns."""
    file = StringIO()
    rows = csv.DictWriter(file, fieldnames=[field.name for field in fields(kind)])
    rows.writeheader()
    rows.writerows(asdict(point) for point in curve)
    write_bytes(path, file.getvalue().encode())
