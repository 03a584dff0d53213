"""What each number of a report is: its metric's definition, and where its interval comes from."""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache

from charms_bench.errors import CharmsBenchError
from charms_bench.metrics import METRIC_SETS, Metric
from charms_bench.metrics.metric import Interval
from charms_bench.report.realism import DISTANCES, RESTS_ON, TITLE
from charms_bench.runs.metric_sets import metric_sets

INTERVALS: Mapping[Interval, str] = {
    "bootstrap": "percentiles of resampled episodes",
    "share": "percentiles of resampled episodes; Wilson's where all or nothing was counted",
    "rate": "percentiles of resampled episodes; Garwood's where nothing was counted",
    "wilson": "Wilson's score interval of a share of episodes",
    "garwood": "Garwood's exact interval of a Poisson rate",
}


@dataclass(frozen=True)
class Definition:
    """What a metric is, in words."""

    id: str
    """Where it stands in the report."""
    name: str
    belongs_to: str
    """The metric set with its version, or what else the metric is part of."""
    unit: str
    text: str
    rests_on: str
    """What n counts."""
    interval: str


@lru_cache
def define_set(label: str) -> dict[str, Definition]:
    """The definitions of a metric set, by metric, from its label in a table.

    One that is not installed, or is in another version, is said to be unknown.
    """
    match = re.fullmatch(r"(.+?)-(\d+)(?:\((.*)\))?", label)
    name, options = (match[1], match[3]) if match else (label, None)
    try:
        (found,) = metric_sets([f"{name}:{options}" if options else name])
    except CharmsBenchError:
        return {}
    if found.label != label:
        return {}
    return {metric.name: _definition(label, metric) for metric in found.metrics}


def define_paired() -> dict[str, Definition]:
    """Of what egos are compared in pair by pair, by metric: from the first set that has it."""
    every = [(each.label, metric) for each in METRIC_SETS for metric in each.metrics]
    return {metric.name: _definition(label, metric) for label, metric in reversed(every)}


def define_distances() -> dict[str, Definition]:
    """Of the distances from people, by metric."""
    return {
        f"{name}_{quantity}": Definition(
            id=f"is-realism-{name}_{quantity}",
            name=f"{name}_{quantity}",
            belongs_to=f"realism: {title.lower()}",
            unit="",
            text=text,
            rests_on=RESTS_ON,
            interval="percentiles of resampled episodes",
        )
        for quantity, title in TITLE.items()
        for name, text in DISTANCES.items()
    }


_STAGES = {
    "steps": ("", "decisions that the stage was trained on"),
    "wall_s": ("", "how long the stage took, in seconds"),
    "steps_per_s": ("", "decisions a second, learning included"),
    "return": ("", "mean return of an episode at the learning curve's last point, exploring"),
    "crashed": ("", "share of episodes that ended in a crash at that point, exploring"),
    "agreement_before": (
        "",
        "share of held-out human decisions that the network takes too, before learning from people",
    ),
    "agreement": ("", "the same, afterwards"),
    "log_likelihood_before": (
        "nats",
        "mean log-likelihood of held-out human decisions, before it learns from people",
    ),
    "log_likelihood": ("nats", "the same, afterwards"),
}
"""Unit and meaning of what a training says of its stages, by column of `stages.csv`."""


def define_stages(columns: Sequence[str]) -> dict[str, Definition]:
    """Of what a training says of its stages, by column."""
    return {
        name: Definition(
            id=_id("training", name),
            name=name,
            belongs_to="training",
            unit=_STAGES.get(name, ("", ""))[0],
            text=_STAGES.get(name, ("", "As the pipeline that trained it calls it"))[1],
            rests_on="one training",
            interval="there is none",
        )
        for name in columns
    }


def unknown(label: str, metric: str) -> Definition:
    """Of a metric whose set is not installed here."""
    return Definition(
        id=_id(label, metric),
        name=metric,
        belongs_to=label,
        unit="",
        text=f"The metric set {label} is not installed where this report was made",
        rests_on="not known here",
        interval="not known here",
    )


def _definition(label: str, metric: Metric) -> Definition:
    return Definition(
        id=_id(label, metric.name),
        name=metric.name,
        belongs_to=label,
        unit=metric.unit,
        text=metric.description,
        rests_on=metric.rests_on,
        interval=INTERVALS[metric.interval],
    )


def _id(label: str, metric: str) -> str:
    """A name that a link can hold."""
    return re.sub(r"[^\w.-]", "_", f"is-{label}-{metric}")
