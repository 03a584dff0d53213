from typing import Any

import numpy as np
import polars as pl
import pytest
from handmade_rows import frames
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from charms_bench.metrics import METRIC_SETS, PAPER, MetricSet, standard, sums_by_episode
from charms_bench.world.scene import SceneSettings

SCENE = SceneSettings()
METRICS = [*PAPER.metrics, *standard(warm_up_s=0.5).metrics]
"""With a warm-up of one decision; the episodes here are short."""


def number(low: float, high: float) -> st.SearchStrategy[float]:
    return st.floats(low, high, width=32)


def step_rows() -> st.SearchStrategy[dict[str, Any]]:
    ego = {
        "speed": number(0, 40),
        "heading": number(-0.125, 0.125),
        "acceleration": number(-8, 8),
        "steering": number(-1, 1),
        "lane": st.integers(0, 2),
        "vehicles_near": st.integers(1, 6),
    }
    leader = {
        "leader": st.integers(1, 3),
        "leader_distance": number(0, 100),
        "leader_speed": number(0, 40),
    }
    follower = {
        "follower_distance": number(0, 100),
        "follower_speed": number(0, 40),
        "follower_acceleration": number(-8, 8),
    }
    return st.builds(
        lambda *parts: {key: value for part in parts for key, value in part.items()},
        st.fixed_dictionaries(ego),
        st.one_of(st.just({}), st.fixed_dictionaries(leader)),
        st.one_of(st.just({}), st.fixed_dictionaries(follower)),
    )


def runs() -> st.SearchStrategy[tuple[Any, ...]]:
    episode = st.fixed_dictionaries(
        {
            "ending": st.sampled_from(["time", "rear_end", "side", "off_road"]),
            "distance_m": number(1, 700),
            "struck": st.none() | st.booleans(),
            "traffic_crashed": st.integers(0, 20),
        }
    )
    rows = st.lists(step_rows(), min_size=1, max_size=5)
    return st.lists(st.tuples(episode, rows), min_size=2, max_size=5).map(tuple)


def values(episodes: pl.DataFrame, steps: pl.DataFrame) -> list[float]:
    sums = sums_by_episode(METRICS, episodes, steps, SCENE)
    return [float(m.value(s.sum(axis=0))) for m, s in zip(METRICS, sums, strict=True)]


@settings(max_examples=25, deadline=None, derandomize=True)
@given(runs())
def test_the_sums_of_shards_are_those_of_the_whole(run: tuple[Any, ...]) -> None:
    episodes, steps = frames(*run)
    shards = [pl.col("episode") < 1, pl.col("episode") >= 1]
    parts = [
        sums_by_episode(METRICS, episodes.filter(shard), steps.filter(shard), SCENE)
        for shard in shards
    ]
    whole = sums_by_episode(METRICS, episodes, steps, SCENE)
    for first, second, both in zip(*parts, whole, strict=True):
        assert_allclose(np.concatenate([first, second]), both, rtol=1e-12)


@settings(max_examples=25, deadline=None, derandomize=True)
@given(runs(), st.randoms(use_true_random=False))
def test_the_order_of_rows_does_not_matter(run: tuple[Any, ...], random: Any) -> None:
    episodes, steps = frames(*run)
    order = list(range(len(steps)))
    random.shuffle(order)
    shuffled = values(episodes[::-1], steps[order])
    assert_allclose(shuffled, values(episodes, steps), rtol=1e-12)


@settings(max_examples=25, deadline=None, derandomize=True)
@given(runs())
def test_proportions_lie_between_0_and_1_and_nothing_is_negative(run: tuple[Any, ...]) -> None:
    for metric, value in zip(METRICS, values(*frames(*run)), strict=True):
        assert not value < 0, metric.name
        if not metric.unit:
            assert not value > 1, metric.name


def test_the_paper_set_has_the_names_of_the_papers_tables() -> None:
    assert [metric.name for metric in PAPER.metrics] == [
        "collision_rate",
        "ttc_below_3s",
        "ttc_below_3s_closing",
        "speed_mean",
        "speed_std",
        "acc_mean",
        "acc_std",
        "yaw_std",
        "harsh_acc_rate",
        "harsh_acc_rate_all_steps",
        "dhw_mean",
        "dhw_std",
        "interaction_density",
    ]


@pytest.mark.parametrize("metric_set", METRIC_SETS, ids=lambda each: each.label)
def test_names_differ_within_a_set(metric_set: MetricSet) -> None:
    names = [metric.name for metric in metric_set.metrics]
    assert len(set(names)) == len(names)


def test_an_episode_without_steps_is_still_an_episode() -> None:
    episodes, steps = frames(({}, [{}]), ({"ending": "side", "steps": 0}, []))
    by_name = dict(zip([m.name for m in METRICS], values(episodes, steps), strict=True))
    assert by_name["crashed_episodes"] == 0.5
    assert by_name["tet"] == 0.0
