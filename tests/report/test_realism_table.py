"""Realism: distances from people with intervals, against scipy and a plain loop."""

from pathlib import Path

import numpy as np
import polars as pl
import pytest
from scipy import stats

from charms_bench.engine.columns import COUNT_SCHEMA
from charms_bench.engine.following import BIN, BINS
from charms_bench.people.reference import Reference
from charms_bench.report.realism_table import distances, realism_table
from charms_bench.report.run_files import write_table
from charms_bench.runs.cells import TrafficCounts
from charms_bench.runs.suite import Suite
from charms_bench.statistics.intervals import RESAMPLES, resample

EPISODES = 30
SUITE = Suite.model_validate(
    {
        "suite": "s",
        "episodes": EPISODES,
        "seed": 4,
        "egos": [{"agent": "a"}],
        "traffics": [{"traffic": "t"}],
    }
)
RNG = np.random.default_rng(0)
PLACES = BIN * np.arange(BINS) + BIN / 2


def reference(name: str = "here", **counts: tuple[int, ...] | None) -> Reference:
    texts = dict.fromkeys(("origin", "terms", "speed_is", "dhw_is"), "said")
    both = {"speed": None, "dhw": None, **counts}
    return Reference(name=name, **texts, vehicles=9, lane_changes=None, **both)


def drawn(mean: float, size: int = 400) -> tuple[int, ...]:
    values = RNG.normal(mean, 3.0, size)
    return tuple(np.histogram(values, bins=BINS, range=(0, BINS * BIN))[0].tolist())


def traffic(name: str, speed: float, dhw: float = 20.0) -> TrafficCounts:
    counts = [[drawn(speed, 40), drawn(dhw, 2)] for _ in range(EPISODES)]
    return TrafficCounts(name, np.array(counts, dtype=np.float64))


def only(long: pl.DataFrame, **where: object) -> dict[str, float]:
    return long.filter(**where).row(0, named=True)


def test_counts_go_to_their_episode_quantity_and_bin() -> None:
    episodes = pl.DataFrame({"episode": [7, 8, 9]}, schema={"episode": pl.UInt64})
    rows = [(9, "dhw", 99, 2), (7, "speed", 46, 5)]
    parts = [(episodes, pl.DataFrame(rows, COUNT_SCHEMA, orient="row"))]
    counts = TrafficCounts.of("t", 3, parts).counts
    assert counts.shape == (3, 2, BINS)
    assert {tuple(map(int, at)): int(counts[tuple(at)]) for at in np.argwhere(counts)} == {
        (2, 1, 99): 2,
        (0, 0, 46): 5,
    }


def test_kl_is_scipys_entropy_on_wider_bins_with_half_a_count_more() -> None:
    human, simulated = np.array(drawn(22.0), float), np.array(drawn(25.0), float)
    for quantity, width in (("speed", 1.0), ("dhw", 5.0)):
        edges = np.arange(0, BINS * BIN + width, width)
        p, q = (np.histogram(PLACES, edges, weights=c)[0] + 0.5 for c in (human, simulated))
        found = distances(human, simulated, quantity)
        assert found[f"kl_{quantity}"] == pytest.approx(stats.entropy(p, q))
        assert found[f"wasserstein_{quantity}"] == pytest.approx(
            stats.wasserstein_distance(PLACES, PLACES, human, simulated)
        )


def test_intervals_are_percentiles_over_resampled_episodes() -> None:
    speeds, people = traffic("t", 25.0), drawn(22.0)
    table = realism_table(SUITE, [speeds], [reference(speed=people)]).frame()
    row = only(table, metric="wasserstein_speed")
    counts = speeds.of_quantity("speed")
    plain = [
        stats.wasserstein_distance(PLACES, PLACES, people, (weights[:, None] * counts).sum(axis=0))
        for weights in resample(np.random.default_rng(4), EPISODES, RESAMPLES)
    ]
    low, high = np.quantile(plain, [0.025, 0.975])
    assert (row["low"], row["high"]) == pytest.approx((low, high), rel=1e-5)
    assert row["low"] < row["value"] < row["high"]
    assert row["n"] == 40 * EPISODES


def test_the_traffic_that_drives_like_people_is_nearest_in_all_metrics() -> None:
    people = reference(speed=drawn(25.0), dhw=drawn(20.0))
    table = realism_table(
        SUITE, [traffic("like", 25.0), traffic("unlike", 29.0, 30.0)], [people]
    ).frame()
    assert table.columns == ["traffic", "reference", "metric", "value", "low", "high", "n"]
    assert table["metric"].n_unique() == 6
    for metric in table["metric"].unique():
        like, unlike = (only(table, metric=metric, traffic=t) for t in ("like", "unlike"))
        assert like["high"] < unlike["low"]


def test_what_was_not_recorded_is_not_compared_and_what_nobody_did_has_no_value() -> None:
    nobody = TrafficCounts("t", np.zeros((EPISODES, 2, BINS)))
    table = realism_table(
        SUITE, [nobody], [reference("a", speed=drawn(25.0)), reference("b")]
    ).frame()
    assert table["reference"].unique().to_list() == ["a"]
    assert table["metric"].to_list() == ["kl_speed", "js_speed", "wasserstein_speed"]
    assert table.select("value", "low", "high").null_count().row(0) == (3, 3, 3)
    assert table["n"].to_list() == [0, 0, 0]


def test_the_table_is_written_reference_by_reference(tmp_path: Path) -> None:
    traffics = [traffic("like", 25.0), traffic("un|like", 29.0)]
    people = [reference("a", speed=drawn(25.0)), reference("b", speed=drawn(20.0), dhw=drawn(20))]
    table = realism_table(SUITE, traffics, people)
    path = write_table(tmp_path, table, ["Where people were recorded."])
    read = pl.read_csv(path.with_suffix(".csv"))
    assert read["reference"].to_list() == ["a"] * 6 + ["b"] * 12
    assert read["traffic"].to_list()[:6] == ["like"] * 3 + ["un|like"] * 3
    text = path.read_text(encoding="utf-8")
    assert text.startswith("Where people were recorded.")
    assert text.index("## a: speed") < text.index("## b: speed") < text.index("## b: dhw")
    assert "| like | **" in text
    assert "| un\\|like | " in text
    assert f"| {40 * EPISODES:,} |" in text, "n, which all distances of a row share"
