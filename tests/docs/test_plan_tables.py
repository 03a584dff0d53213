"""The tables of the older plans: intervals over seeds, and differences of styles."""

import sys
from collections.abc import Iterator
from types import ModuleType

import numpy as np
import polars as pl
import pytest
from scipy import stats
from written import ROOT

STYLES = [(p, s) for p in ("Efficient", "Safe") for s in ("Egoistic", "Prosocial")]


@pytest.fixture(scope="module")
def tool() -> Iterator[ModuleType]:
    sys.path.insert(0, str(ROOT / "tools"))
    import plan_results

    yield plan_results
    sys.path.remove(str(ROOT / "tools"))


def test_the_interval_is_that_of_students_t(tool: ModuleType) -> None:
    values = np.array([0.8, 0.9, 0.6, 1.0, 1.3])
    expected = stats.ttest_1samp(values, 0.0).confidence_interval(0.95)
    assert tool.t_interval(values) == pytest.approx((expected.low, expected.high), rel=1e-12)


def test_the_table_has_the_mean_and_the_worst_seed(tool: ModuleType) -> None:
    others = dict.fromkeys(tool.DRIVING, 0.5)
    at_fault, changes = [0.01, 0.02, 0.03, 0.02, 0.02], [0.2, 0.3, 0.05, 0.3, 0.74]
    rows = [
        {"traffic": "T", "ego": "A", **others, "crashed_at_fault": crash, "lane_changes_per_km": k}
        for crash, k in zip(at_fault, changes, strict=True)
    ]
    text = tool.summary(pl.DataFrame(rows), tool.DRIVING, tool.KEYS)
    # A standard deviation of 0.707 %, times 2.776 over the root of 5, is 0.88 %.
    assert "| T | A | mean of 5 [t interval] | 2.00 % [1.12, 2.88] |" in text
    worst = next(line for line in text.splitlines() if "worst seed" in line).split(" | ")
    assert worst[3] == "3.00 %"
    assert worst[6] == "0.05", "0.05 is further below 0.1 than 0.74 is from 0.75"


def values(metrics: dict[str, tuple[float, float]], rng: np.random.Generator) -> pl.DataFrame:
    """Styles of five seeds; a metric is its first number in safe styles, or else its second."""
    rows = [
        {"style": f"{priority}-{svo}", "seed": seed}
        | {
            name: safe if priority == "Safe" else efficient
            for name, (safe, efficient) in metrics.items()
        }
        for seed in range(5)
        for priority, svo in STYLES
    ]
    frame = pl.DataFrame(rows)
    noise = [pl.col(name) + pl.Series(rng.normal(0, 0.01, len(rows))) for name in metrics]
    return frame.with_columns(noise)


def test_a_difference_of_styles_is_paired_by_seed(tool: ModuleType) -> None:
    means = dict.fromkeys((metric for metric, *_ in tool.STYLES.values()), (2.0, 3.0))
    found = values(means, np.random.default_rng(0))
    offset = pl.col("speed_mean") + 100.0 * pl.col("seed")  # the same for all styles of a seed
    found = found.with_columns(offset)
    text = tool.style_statements(found, found)
    faster = next(line for line in text.splitlines() if "faster" in line)
    efficient, safe = (
        found.filter(pl.col("style").str.starts_with(word))
        .group_by("seed", maintain_order=True)
        .agg(pl.col("speed_mean").mean())["speed_mean"]
        .to_numpy()
        for word in ("Efficient", "Safe")
    )
    expected = stats.ttest_rel(efficient, safe).confidence_interval(0.95)
    difference = (efficient - safe).mean()
    assert f"{difference:.3f} [{expected.low:.3f}, {expected.high:.3f}]" in faster


def test_a_style_is_shown_by_the_means_of_its_seeds_and_its_worst_crash_rate(
    tool: ModuleType,
) -> None:
    shown = dict.fromkeys((name for name in tool.STYLE_MEANS if name != "worst"), 0.0)
    rows = [
        {"style": style, "seed": seed, **shown, "speed_mean": speed, "crashed_at_fault": rate}
        for style, seed, speed, rate in [
            ("Safe", 1, 23.0, 0.01),
            ("Efficient", 1, 26.0, 0.0),
            ("Safe", 2, 24.0, 0.02),
            ("Efficient", 2, 26.5, 0.0),
        ]
    ]
    safe, efficient = tool.style_means(pl.DataFrame(rows)).splitlines()[2:]
    assert safe == "| Safe | 23.50 | 0.00 | 0.00 | 0.00 | 0.0 | 1.50 % | 2.00 % |"
    assert efficient.startswith("| Efficient | 26.25 |")


def test_the_tables_on_the_page_are_those_of_the_numbers(tool: ModuleType) -> None:
    results = ROOT / "docs" / "results"
    numbers = pl.read_csv(results / "plan.csv").filter(tool._of_main())
    main = (results / "plan-main.md").read_text(encoding="utf-8")
    assert main == tool.summary(numbers, tool.DRIVING, tool.KEYS)
    others = (results / "plan-conditions.md").read_text(encoding="utf-8")
    assert others == tool.plan_conditions(results)
