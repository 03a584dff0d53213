"""Finds metric sets by name and options, such as `standard:ttc_s=2`.

An entry point of the group `charms_bench.metrics` is a `MetricSet` or a function that makes one
from keyword options. The options become part of its label, so that a table shows which thresholds
its values were computed with.
"""

import re
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import get_args

import numpy as np
import polars as pl

from charms_bench.errors import PLUGIN_ERRORS, InputError, RegistryError, suggestion
from charms_bench.metrics import METRIC_SETS, SCENARIOS, Metric, MetricSet, sums_by_episode
from charms_bench.metrics.metric import Interval
from charms_bench.plugins.registry import METRICS, load, make
from charms_bench.recording.columns import EPISODE_SCHEMA, STEP_SCHEMA
from charms_bench.runs.document import name_and_options
from charms_bench.world.scene import SceneSettings


def metric_sets(
    texts: Sequence[str], default: tuple[MetricSet, ...] = METRIC_SETS
) -> tuple[MetricSet, ...]:
    """Returns the metric sets that texts like `NAME` or `NAME:OPTION=VALUE,...` ask for.

    Without any text these are those of the `default`, whose options are also those that a text
    does not give. The set `scenarios` of the `default` is always among them, because it says what
    the others leave out.

    Raises:
        InputError: A text is not of that form, or two ask for the same set.
        RegistryError: A set is not installed, does not take the options, or cannot be computed.
    """
    usual = {each.name: each.options for each in default if each.options}
    found = tuple(_metric_set(text, usual) for text in texts) or default
    if SCENARIOS in default and SCENARIOS not in found:
        found = (*found, SCENARIOS)
    labels = [each.label for each in found]
    for label in labels:
        if labels.count(label) > 1:
            raise InputError(f"metric set '{label}': given twice")
    return found


def asked_by(label: str) -> str | None:
    """Returns the text that asks for the set that a table calls `label`; None if it is no label."""
    match = re.fullmatch(r"(.+?)-\d+(?:\((.*)\))?", label)
    return match and ":".join(filter(None, match.groups()))


def _metric_set(text: str, usual: Mapping[str, str]) -> MetricSet:
    name, options = name_and_options(text, "metric set")
    if name in usual:
        options = {**name_and_options(f"{name}:{usual[name]}", "metric set")[1], **options}
    made = load(METRICS, name)
    if not isinstance(made, MetricSet):
        made = make(METRICS, name, options, MetricSet)
    elif options:
        raise InputError(f"metric set '{name}' takes no options; given: {', '.join(options)}")
    _try_out(made)
    return replace(made, options=",".join(f"{key}={value}" for key, value in options.items()))


def _try_out(metric_set: MetricSet) -> None:
    """Computes the set for an episode of one step, to find a broken metric before a run."""
    whose = f"metric set '{metric_set.name}'"
    if not all(isinstance(metric, Metric) for metric in metric_set.metrics):
        raise RegistryError(f"{whose}: expected metrics of the class Metric")
    for metric in metric_set.metrics:
        if metric.interval not in get_args(Interval):
            known = suggestion(str(metric.interval), dict.fromkeys(get_args(Interval)))
            what = f"no interval named '{metric.interval}'. {known}"
            raise RegistryError(f"{whose}: {metric.name}: {what}")
    names = [metric.name for metric in metric_set.metrics]
    for name in names:
        if names.count(name) > 1:
            raise RegistryError(f"{whose}: two metrics named '{name}'")
    if not _problem_of(metric_set.metrics):
        return
    for metric in metric_set.metrics:
        if problem := _problem_of([metric]):
            raise RegistryError(
                f"{whose}: {metric.name}: {problem}; expected sums of an "
                "episode's rows, and a value of shape (...) of totals (..., k)"
            )


def _problem_of(metrics: Sequence[Metric]) -> str:
    """Returns what is wrong with some metrics, in words; empty if nothing is."""
    head = dict.fromkeys(EPISODE_SCHEMA, 0) | {"ending": "time", "steps": 1}
    episodes = pl.DataFrame([head], schema=EPISODE_SCHEMA)
    steps = pl.DataFrame([dict.fromkeys(STEP_SCHEMA, 0) | {"step": 1}], schema=STEP_SCHEMA)
    try:
        every = sums_by_episode(metrics, episodes, steps, SceneSettings())
        values = [metric.value(sums) for metric, sums in zip(metrics, every, strict=True)]
    except PLUGIN_ERRORS as error:
        return f"{type(error).__name__}: {error}".splitlines()[0]
    shapes = [np.shape(value) for value in values]
    return next((f"value has shape {shape}" for shape in shapes if shape != (1,)), "")
