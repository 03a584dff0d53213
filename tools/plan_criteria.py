"""The criteria of the plan, and what they are about in the values of its test."""

import re
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from functools import partial
from typing import NamedTuple

import numpy as np
import polars as pl
from plan_styles import pch_differences, statements

from charms_bench.world.scene import Floats

Frames = Mapping[str, pl.DataFrame]
"""The values of the test, one row per cell and seed, by name (`plan_tables.FRAMES`)."""
Limits = tuple[float, float]
CHARMS, RULE = "CHARMS", "IDM+MOBIL"
CONFLICTS = "conflicts_by_per_1000km"
"""It counts from the first step, whatever a suite leaves out of other metrics."""
CONDITIONS = {
    "main": ("3 lanes, density 1", 0),
    "density-1-5": ("density 1.5", 1),
    "density-2": ("density 2", 2),
    "lanes-2": ("2 lanes", 3),
    "lanes-4": ("4 lanes", 3),
    "lanes-5": ("5 lanes", 3),
    "others": ("other traffic models", 4),
    "sealed-density": ("density 1.75 (sealed)", 5),
    "sealed-lanes": ("6 lanes (sealed)", 5),
    "sealed-traffic": ("another traffic model (sealed)", 5),
}
"""By test of `tools/plan.py`: its label in tables, and which limit of crashes at fault it has."""


class Measured(NamedTuple):
    """The values of a criterion in one cell."""

    part: int
    """Which of the limits holds for it."""
    cell: str
    values: Floats
    """One per seed."""
    limits: Limits | None = None
    """Where the plan's text does not have them."""


def _driving(
    frames: Frames, metric: str, *conditions: str
) -> Iterable[tuple[str, str, Floats, float]]:
    """Condition, traffic model, CHARMS's values and IDM+MOBIL's value in each cell."""
    found = frames["driving"].filter(pl.col("condition").is_in(conditions))
    for (condition, traffic), part in found.group_by("condition", "traffic", maintain_order=True):
        ours, rule = (part.filter(ego=ego)[metric].drop_nans().to_numpy() for ego in (CHARMS, RULE))
        if len(ours):
            yield str(condition), str(traffic), ours, rule[0] if len(rule) else np.nan


def _at_fault(frames: Frames) -> Iterable[Measured]:
    for condition, traffic, values, _ in _driving(frames, "crashed_at_fault", *CONDITIONS):
        label, part = CONDITIONS[condition]
        yield Measured(part, f"{label}, {traffic}", values)
    if "hazards" in frames:  # apart, because nobody avoids some of them; the last limit holds
        for each in _scenarios("hazards", "at_fault", 6, frames):
            yield each._replace(cell=f"hazard (sealed), {each.cell}")


def _scenarios(frame: str, metric: str, part: int, frames: Frames) -> Iterable[Measured]:
    values = frames[frame].filter(ego=CHARMS)
    for (kind,), each in values.group_by("scenario", maintain_order=True):
        yield Measured(part, str(kind), each[metric].to_numpy())


def _conflicts(frames: Frames) -> Iterable[Measured]:
    for condition, traffic, values, _ in _driving(frames, CONFLICTS, "main", "density-1-5"):
        label, part = CONDITIONS[condition]
        if traffic == RULE:
            yield Measured(part, f"{label}, {RULE}", values)


def _faster(frames: Frames) -> Iterable[Measured]:
    for _, traffic, values, rule in _driving(frames, "speed_mean", "main"):
        if not np.isnan(rule):
            yield Measured(int(traffic == RULE), traffic, values - rule)


def _main(metric: str, frames: Frames) -> Iterable[Measured]:
    for k, (_, traffic, values, _) in enumerate(_driving(frames, metric, "main")):
        yield Measured(k, traffic, values)


def undone(frames: Frames) -> Iterable[Measured]:
    """The proportions of lane changes undone, with those of IDM+MOBIL as their limits."""
    cells = _driving(frames, "lane_changes_undone", "main")
    for k, (_, traffic, values, rule) in enumerate(cells):
        if not np.isnan(rule):
            yield Measured(k, traffic, values, (-np.inf, rule))


def _statements(frames: Frames) -> Iterable[Measured]:
    """The corrected p-values after fine-tuning; 1 for a difference in the other direction."""
    for each in statements(frames["styles"]).to_dicts():
        if each["fine-tuning"] == "after":
            p = each["p"] if each["difference"] > 0 else 1.0
            yield Measured(0, each["statement"], np.array([p]), (-np.inf, 0.05))


def _told(frames: Frames) -> Iterable[Measured]:
    (by,), first = next(iter(frames["told"].group_by("by", maintain_order=True)))
    yield Measured(0, str(by), first["told"].to_numpy())


def _pch(frames: Frames) -> Iterable[Measured]:
    for part, of, metric, words in (
        (0, "beta", "traffic_speed_mean", "speed at β = 1 less β = 0, mean over τ"),
        (1, "tau", "traffic_gaps_taken_per_1000km", "gaps at τ = 3 less τ = 0.5, mean over β"),
    ):
        over_other = pch_differences(frames["pch"], of).filter(pl.col("at").is_null())
        yield Measured(part, words, over_other[metric].to_numpy())


def _style_traffic(frames: Frames) -> Iterable[Measured]:
    for (style,), each in frames["style-traffic"].group_by("traffic", maintain_order=True):
        yield Measured(0, str(style), each["traffic_crashes_per_1000km"].to_numpy())


@dataclass(frozen=True)
class Criterion:
    """A row of the plan's table of criteria, in its words."""

    quantity: str
    limit: str
    aim: str
    form: str = ""
    of: str | Callable[[Frames], Iterable[Measured]] = ""
    """A metric of the main test, or what measures something else; other commands do if empty."""
    frame: str = "driving"
    """What is measured in."""
    least: bool = False
    """Whether the limit is the smallest value instead of the largest."""
    signed: bool = False

    @property
    def texts(self) -> list[str]:
        """The limits one by one, with their unit."""
        if not self.of:
            return [self.limit]
        unit = self.limit[len(self.limit.rstrip(" %/²ms")) :]
        return [re.sub(r"([0-9])$", rf"\1{unit}", each) for each in re.split("[,;] ", self.limit)]

    def limits(self, text: str) -> Limits:
        """The ends of one of the `texts`."""
        scale = 0.01 if text.endswith("%") else 1.0
        ends = [scale * float(each) for each in re.findall(r"[0-9]+(?:\.[0-9]+)?", text)]
        if len(ends) == 1:
            ends = [*ends, np.inf] if self.least else [-np.inf, *ends]
        return ends[0], ends[1]

    def measured(self, frames: Frames) -> list[Measured]:
        """Its values in each cell; none if what it is measured in is missing."""
        if not self.of or self.frame not in frames:
            return []
        return list(_main(self.of, frames) if isinstance(self.of, str) else self.of(frames))


CRITERIA = (
    Criterion(
        "at fault: main; density 1.5, 2; 2, 4, 5 lanes; other traffics; sealed",
        "0.1; 0.3, 0.7; 0.2; 0.2; 0.3 %", "0.03 %", ".3%", _at_fault,
    ),
    Criterion(
        "conflicts caused per 1,000 km among IDM+MOBIL, density 1; 1.5",
        "30; 60", "IDM+MOBIL's", ".1f", _conflicts,
    ),
    Criterion(
        "R157: crashed where IDM+MOBIL or a careful driver survives, each kind, without pile-ups",
        "1 %", "0", ".2%", partial(_scenarios, "r157", "any", 0), frame="r157",
    ),
    Criterion(
        "speed less IDM+MOBIL's, among `human`; IDM+MOBIL",
        "0.3; 0.1 m/s", "on the front of IDM+MOBIL's headways", ".2f", _faster,
        least=True, signed=True,
    ),
    Criterion(
        "lane changes per km", "0.1 to 0.75", "at most 0.45", ".2f", "lane_changes_per_km"
    ),
    Criterion("lane changes undone within 5 s", "IDM+MOBIL's", "5 %", ".1%", undone),
    Criterion(
        "standard deviation of the mean acceleration of a decision",
        "0.2 to 0.5 m/s²", "0.25 to 0.43", ".2f", "mean_acceleration_std",
    ),
    Criterion("decisions above 1.1 m/s²", "3 %", "2 %", ".1%", "strong_acceleration_rate"),
    Criterion(
        "acceleration reversals per minute",
        "1 to 6", "2 to 5", ".1f", "acceleration_reversals_per_min",
    ),
    Criterion(
        "headways between centres below 1 s",
        "5 to 21 %", "6 to 21 %", ".1%", "centre_headway_below_1s",
    ),
    Criterion(
        "likeness, mean of the seeds, on I-24 and I-75",
        "above constant velocity and above PPO, intervals apart", "that of calibrated drivers",
    ),
    Criterion(
        "style statements below, Holm over all",
        "hold", "", "p", _statements, frame="styles",
    ),
    Criterion(
        "the style told from one episode by headway, relative speed, gaps, yielding and imposed "
        "braking; the mean speed alone stands beside it",
        "35 %", "60 %", ".1%", _told, frame="told", least=True,
    ),
    Criterion(
        "PCH: speed of the traffic between β = 0 and 1; gaps that the traffic takes between "
        "τ = 0.5 and 3",
        "1.5 m/s; an interval without 0", "", ".2f", _pch, frame="pch", least=True, signed=True,
    ),
    Criterion(
        "crashed vehicles in the traffic of any style alone, per 1,000 km",
        "3", "0.3", ".1f", _style_traffic, frame="style-traffic",
    ),
    Criterion(
        "kilometres until the faults of known size are in order ([mutants](mutants.md)), five "
        "repetitions, PCH traffic",
        "interval below IDM+MOBIL's", "below `human`'s",
    ),
)  # fmt: skip
"""In the order of the plan; the numbers are those in the texts of the limits."""


def limits_of(metric: str) -> Limits:
    """The limits of a metric of the main test."""
    (criterion,) = (each for each in CRITERIA if each.of == metric)
    return criterion.limits(criterion.limit)
