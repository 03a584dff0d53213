"""Rates and proportions of what drivers do to each other, against hand calculation."""

import numpy as np
import polars as pl
import pytest
from handmade_rows import SCENE, driver, frames

from charms_bench.metrics import METRIC_SETS, Metric, sums_by_episode
from charms_bench.metrics.rows import LANE_CHANGE_WINDOW_S
from charms_bench.recording import encroachment, lane_changes
from charms_bench.recording.columns import DRIVER_SCHEMA

METRICS = {metric.name: metric for metric in METRIC_SETS[-1].metrics}


DRIVERS = pl.DataFrame(
    [
        driver(0, "a", True, conflicts_to=1, pet_to=2, pet_below_2s_to=1, rss_by_s=5.0),
        driver(0, "a", False, vehicles=2, distance_m=1000.0, gaps_taken=3, conflicts_by=1),
        driver(0, "b", False, vehicles=3, distance_m=1500.0, gaps_taken=2, time_s=60.0),
        driver(1, "a", True, conflicts_to=2, pet_to=2, pet_below_2s_to=2, near_misses_by=1),
        driver(1, "b", False, vehicles=5, distance_m=2500.0, rss_to_s=10.0),
    ],
    schema=DRIVER_SCHEMA,
    strict=False,
)


def measured(metric: Metric) -> float:
    episodes, steps = frames(({}, [{}, {}]), ({}, [{}, {}, {}]))
    (sums,) = sums_by_episode([metric], episodes, steps, SCENE, DRIVERS)
    return float(metric.value(sums.sum(axis=0)))


@pytest.mark.parametrize(
    ("name", "expected"),
    [
        ("conflicts_to_per_1000km", 3000.0),  # 3 in 1 km
        ("conflicts_by_per_1000km", 0.0),
        ("near_misses_by_per_1000km", 1000.0),
        ("pet_below_2s_to", 0.75),  # 3 of 4
        ("rss_by", 0.125),  # 5 of 40 s
        ("traffic_gaps_taken_per_1000km", 1000.0),  # 5 in 5 km
        ("traffic_conflicts_by_per_1000km", 200.0),
        ("traffic_rss_to", 0.1),  # 10 of 20 + 60 + 20 s
    ],
)
def test_rates_and_proportions_are_those_of_the_sums(name: str, expected: float) -> None:
    assert measured(METRICS[name]) == pytest.approx(expected)


@pytest.mark.parametrize("name", ["pet_below_2s_by", "traffic_pet_below_2s_to"])
def test_a_proportion_of_nothing_is_not_defined(name: str) -> None:
    assert np.isnan(measured(METRICS[name]))


def test_vehicles_are_those_that_n_counts() -> None:
    episodes, steps = frames(({}, [{}, {}]), ({}, [{}]))
    metric = METRICS["traffic_gaps_taken_per_1000km"]
    (sums,) = sums_by_episode([metric], episodes, steps, SCENE, DRIVERS)
    assert sums[:, 0].tolist() == [5.0, 5.0]


def test_recorded_events_have_the_default_thresholds_of_the_metrics_of_steps() -> None:
    assert lane_changes.IMPOSED_S == LANE_CHANGE_WINDOW_S
    assert encroachment.SHORT_PET_S == 2.0  # the columns and metrics are named after it
