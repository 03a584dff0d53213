"""The table of training seeds: Student's t interval, its coverage, and the worst seed."""

import sys
from collections.abc import Iterator
from types import ModuleType

import numpy as np
import polars as pl
import pytest
from scipy import stats
from written import ROOT

RESULTS = ROOT / "docs" / "results"


@pytest.fixture(scope="module")
def tool() -> Iterator[ModuleType]:
    sys.path.insert(0, str(ROOT / "tools"))
    import seeds

    yield seeds
    sys.path.remove(str(ROOT / "tools"))


def test_the_interval_is_that_of_students_t(tool: ModuleType) -> None:
    values = np.array([0.8, 0.9, 0.6, 1.0, 1.3])
    expected = stats.ttest_1samp(values, 0.0).confidence_interval(0.95)
    assert tool.t_interval(values) == pytest.approx((expected.low, expected.high), rel=1e-12)


def test_the_interval_of_five_normal_seeds_holds_95_percent_and_of_others_less(
    tool: ModuleType,
) -> None:
    normal, *skewed, mixture = tool.coverage().values()
    assert normal == pytest.approx(0.95, abs=0.002)  # 4 standard deviations of 200,000 samples
    assert all(0.8 < each < 0.93 for each in skewed)
    # A third of the samples (0.8 to the power of 5) have no bad seed, and tell nothing of it.
    assert mixture < 1 - 0.9 * 0.8**5


def test_the_table_has_mean_and_worst_seed_and_calls_nothing_95_percent(tool: ModuleType) -> None:
    crashed = {"Careful": [0.01, 0.02, 0.03, 0.02, 0.02], "Mixed": [0.1, 0.0, 0.9, 0.0, 0.0]}
    others = {name: 0.5 for name in tool.COLUMNS if name != "crashed_episodes"}
    rows = [
        {"configuration": name, "crashed_episodes": each, **others, "process_minutes": 1.0}
        for name, values in crashed.items()
        for each in values
    ]
    text = tool.summary(pl.DataFrame(rows))
    # Standard deviations 0.707 % and 39.37 %, times 2.776 over the root of 5: 0.88 % and 48.9 %.
    assert "| Careful | mean [t interval] | 2.0 % [1.1, 2.9] |" in text
    assert "|  | worst seed | 3.0 % |" in text
    assert "| Mixed | mean [t interval] | 20.0 % [0.0, 68.9] |" in text
    assert "95" not in text


def test_the_slowest_seed_is_the_worst_in_speed(tool: ModuleType) -> None:
    rows = [
        {**dict.fromkeys(tool.COLUMNS, 0.5), "speed_mean": speed, "configuration": "A"}
        for speed in (28.0, 30.0)
    ]
    text = tool.summary(pl.DataFrame(rows).with_columns(process_minutes=1.0))
    assert "|  | worst seed | 50.0 % | 50.0 % | 28.00 |" in text


def test_the_tables_on_the_page_are_those_of_the_numbers(tool: ModuleType) -> None:
    values = pl.read_csv(RESULTS / "seeds.csv")
    assert values.group_by("configuration").len()["len"].to_list() == [tool.SEEDS] * 9
    assert (RESULTS / "seeds.md").read_text(encoding="utf-8").startswith(tool.summary(values))
    assert (RESULTS / "seed-coverage.md").read_text(encoding="utf-8") == tool.coverage_table()
