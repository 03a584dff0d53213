"""Realism: distances from people with intervals, against scipy and a plain loop."""

from pathlib import Path

import ego_table
import numpy as np
import polars as pl
import pytest
from scipy import stats
from scipy.spatial.distance import jensenshannon

from charms_bench.humans.reference import Reference
from charms_bench.recording.columns import COUNT_SCHEMA
from charms_bench.report.realism_table import (
    FLOOR,
    KEYS,
    LONG,
    WITHIN_LIMITS,
    distances,
    from_frame,
    realism_table,
    smallest_distances,
)
from charms_bench.report.run_files import write_table
from charms_bench.report.table import long_schema
from charms_bench.runs.cells import TrafficCounts
from charms_bench.statistics.intervals import RESAMPLES, resample
from charms_bench.world.following_bins import BIN, BINS

EPISODES = 30
UNITS = 25
SUITE = ego_table.SUITE.model_copy(update={"episodes": EPISODES, "seed": 4})
RNG = np.random.default_rng(0)
PLACES = BIN * np.arange(BINS) + BIN / 2


@pytest.fixture(autouse=True)
def _same_numbers_in_any_order_of_tests() -> None:
    RNG.bit_generator.state = np.random.default_rng(2).bit_generator.state


def reference(name: str = "here", **counts: tuple[tuple[int, ...], ...]) -> Reference:
    texts = dict.fromkeys(("origin", "terms", "unit", "speed_is", "dhw_is"), "said")
    both = {"speed": (), "dhw": (), **counts}
    return Reference(name=name, **texts, vehicles=9, lane_changes=None, **both)


def drawn(mean: float, size: int = 400) -> tuple[int, ...]:
    values = RNG.normal(mean, 3.0, size)
    return tuple(np.histogram(values, bins=BINS, range=(0, BINS * BIN))[0].tolist())


def people(mean: float) -> tuple[tuple[int, ...], ...]:
    return tuple(drawn(mean, 20) for _ in range(UNITS))


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


def test_intervals_are_from_resampled_episodes_and_resampled_people() -> None:
    speeds, recorded = traffic("t", 25.0), people(22.0)
    table = realism_table(SUITE, [speeds], [reference(speed=recorded)]).frame()
    row = only(table, metric="wasserstein_speed", traffic="t")
    counts, units = speeds.of_quantity("speed"), np.array(recorded)
    plain = [
        stats.wasserstein_distance(
            PLACES,
            PLACES,
            (drivers[:, None] * units).sum(axis=0),
            (weights[:, None] * counts).sum(0),
        )
        for weights, drivers in zip(
            resample(np.random.default_rng(4), EPISODES, RESAMPLES),
            resample(np.random.default_rng((4, 1)), UNITS, RESAMPLES),
            strict=True,
        )
    ]
    # Deviations from their mean, widened as in the interval of a mean of 25 values.
    widened = stats.t.ppf(0.975, 24) / stats.norm.ppf(0.975) * np.sqrt(25 / 24)
    deviations = (np.quantile(plain, [0.025, 0.975]) - np.mean(plain)) * widened
    assert (row["low"], row["high"]) == pytest.approx(tuple(row["value"] + deviations), rel=1e-5)
    assert row["low"] < row["value"] < row["high"]
    assert row["n"] == 40 * EPISODES


def test_a_single_recording_gives_no_interval_and_no_noise_floor() -> None:
    table = realism_table(SUITE, [traffic("t", 25.0)], [reference(speed=people(22.0)[:1])]).frame()
    assert table.select("low", "high").null_count().row(0) == (len(table), len(table))
    assert FLOOR not in table["traffic"].to_list()


def test_the_traffic_that_drives_like_people_is_nearest_in_all_metrics() -> None:
    traffics = [traffic("like", 25.0), traffic("unlike", 29.0, 30.0)]
    table = realism_table(SUITE, traffics, [reference(speed=people(25.0), dhw=people(20.0))])
    long = table.frame()
    assert long.columns == ["traffic", "reference", "metric", "value", "low", "high", "n"]
    assert long["metric"].n_unique() == 6
    for metric in long["metric"].unique():
        like, unlike, perfect = (
            only(long, metric=metric, traffic=t) for t in ("like", "unlike", FLOOR)
        )
        assert like["high"] < unlike["low"]
        assert perfect["low"] < perfect["value"] < perfect["high"] < unlike["value"]
        assert like["value"] < 1.5 * perfect["high"]
    marked = {row.labels[0] for row in table.rows if all(n.marked for n in row.numbers)}
    assert marked == {"like"}


def test_traffics_that_the_people_do_not_separate_are_not_marked() -> None:
    traffics = [traffic("like", 25.0), traffic("also", 25.2), traffic("unlike", 35.0)]
    table = realism_table(SUITE, traffics, [reference(speed=people(25.0))])
    assert not any(number.marked for row in table.rows for number in row.numbers)


@pytest.mark.parametrize(
    ("first", "second", "perfect", "marked"),
    [
        ((2.0, 1.5, 2.5), (4.0, 3.0, 5.0), (0.5, 0.1, 1.0), True),
        ((2.0, 1.5, 3.1), (4.0, 3.0, 5.0), (0.5, 0.1, 1.0), False),  # intervals overlap
        ((2.0, 1.5, 2.5), (4.0, 3.0, 5.0), (3.0, 1.0, 4.5), False),  # both may be perfect
        ((2.0, None, None), (4.0, 3.0, 5.0), (0.5, 0.1, 1.0), False),  # no interval
    ],
)
def test_only_what_the_data_separate_is_marked(
    first: tuple[float, ...], second: tuple[float, ...], perfect: tuple[float, ...], marked: bool
) -> None:
    rows = {"first": first, "second": second, WITHIN_LIMITS: (0.2, 0.1, 0.3), FLOOR: perfect}
    records = [(name, "here", "js_speed", *numbers, 9) for name, numbers in rows.items()]
    frame = pl.DataFrame(records, schema=long_schema(KEYS, LONG), orient="row")
    found = {row.labels[0]: row.numbers[0].marked for row in from_frame(frame, SUITE).rows}
    assert found == {"first": marked, "second": False, WITHIN_LIMITS: False, FLOOR: False}


def test_the_smallest_distances_within_limits_are_those_of_two_speeds() -> None:
    # Half of the people drive 20.25 m/s, which is 2 m/s below the bin of the limit of 22 m/s.
    human = np.zeros(BINS)
    human[[40, 50]] = 50.0
    found = smallest_distances(human, (22.0, 33.0), 1000)
    assert found["wasserstein_speed"] == pytest.approx(0.5 * 2.0)
    # All simulated vehicles drive 25 m/s, as the other half does.
    expected = jensenshannon([0.5, 0.5], [0.0, 1.0], base=2) ** 2
    assert found["js_speed"] == pytest.approx(expected)


def test_no_speeds_within_limits_are_nearer_than_the_smallest_distances() -> None:
    human = np.array(drawn(24.0), dtype=np.float64)
    least = smallest_distances(human, (22.0, 33.0), 400)
    inside = np.zeros(BINS)
    inside[44:67] = 1.0
    for concentration in (0.1, 1.0, 10.0):
        weights = inside * (human / human.max() + 0.05) * concentration
        simulated = 400 * RNG.dirichlet(np.maximum(weights, 1e-12), size=200) * inside
        found = distances(human, simulated, "speed")
        assert (found["js_speed"] >= least["js_speed"]).all()
        assert (found["wasserstein_speed"] >= least["wasserstein_speed"]).all()


def test_what_was_not_recorded_is_not_compared_and_what_nobody_did_has_no_value() -> None:
    nobody = TrafficCounts("t", np.zeros((EPISODES, 2, BINS)))
    table = realism_table(
        SUITE, [nobody], [reference("a", speed=people(25.0)), reference("b")]
    ).frame()
    assert table["reference"].unique().to_list() == ["a"]
    table = table.filter(traffic="t")
    assert table["metric"].to_list() == ["kl_speed", "js_speed", "wasserstein_speed"]
    assert table.select("value", "low", "high").null_count().row(0) == (3, 3, 3)
    assert table["n"].to_list() == [0, 0, 0]


def test_the_table_is_written_reference_by_reference(tmp_path: Path) -> None:
    traffics = [traffic("like", 25.0), traffic("un|like", 29.0)]
    recorded = {"speed": people(20.0), "dhw": people(20.0)}
    table = realism_table(
        SUITE, traffics, [reference("a", speed=people(25.0)), reference("b", **recorded)]
    )
    path = write_table(tmp_path, table, ["Where people were recorded."])
    read = pl.read_csv(path.with_suffix(".csv"))
    assert read["reference"].to_list() == ["a"] * 12 + ["b"] * 24
    assert read["traffic"].to_list()[:6] == ["like"] * 3 + ["un|like"] * 3
    text = path.read_text(encoding="utf-8")
    assert text.startswith("Where people were recorded.")
    assert text.index("## a: speed") < text.index("## b: speed") < text.index("## b: headway")
    assert "| like | **" in text
    assert "| un\\|like | " in text
    assert f"| {40 * EPISODES:,} |" in text, "n, which all distances of a row share"


def test_the_note_of_the_suite_is_printed_with_the_table() -> None:
    suite = SUITE.model_copy(update={"note": "The second traffic learnt from the reference."})
    table = realism_table(suite, [traffic("t", 25.0)], [reference(speed=people(25.0))])
    assert table.note.endswith(" The second traffic learnt from the reference.")
