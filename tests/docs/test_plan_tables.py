"""The tables of the plan: criteria of the page, statements on styles, scenarios and PCH."""

import json
import sys
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import polars as pl
import pytest
import yaml
from scipy import stats
from written import ROOT

import charms_bench
from charms_bench.report.stored import stored_tables
from charms_bench.runs.resumable_folder import RunFolder


@pytest.fixture(scope="module")
def tools() -> Iterator[SimpleNamespace]:
    sys.path.insert(0, str(ROOT / "tools"))
    import plan_criteria
    import plan_seeds
    import plan_styles
    import plan_tables
    import plan_verdicts

    yield SimpleNamespace(
        criteria=plan_criteria,
        seeds=plan_seeds,
        styles=plan_styles,
        tables=plan_tables,
        verdicts=plan_verdicts,
    )
    sys.path.remove(str(ROOT / "tools"))


def row_of(text: str, *words: str) -> list[str]:
    """The cells of the only row of a Markdown table with these words."""
    (line,) = (each for each in text.splitlines() if all(word in each for word in words))
    return [cell.strip() for cell in line[1:-1].split("|")]


def test_the_criteria_are_those_of_the_page(tools: SimpleNamespace) -> None:
    page = (ROOT / "docs" / "training-plan.md").read_text(encoding="utf-8")
    table = page.rpartition("## Criteria")[2].split("\n\n")[2]
    rows = [
        f"| {' | '.join((each.quantity, each.limit, each.aim))} |".replace("|  |", "| |")
        for each in tools.criteria.CRITERIA
    ]
    assert table.splitlines()[2 : 2 + len(rows)] == rows
    assert len(table.strip().splitlines()) == 2 + len(rows)


@pytest.mark.parametrize(
    ("begins", "expected"),
    [
        ("at fault", [(-np.inf, each) for each in (0.001, 0.003, 0.007, 0.002, 0.002, 0.003)]),
        ("conflicts caused", [(-np.inf, 30.0), (-np.inf, 60.0)]),
        ("speed less", [(0.3, np.inf), (0.1, np.inf)]),
        ("lane changes per km", [(0.1, 0.75)]),
        ("standard deviation", [(0.2, 0.5)]),
        ("headways between", [(0.05, 0.21)]),
        ("the style told", [(0.35, np.inf)]),
    ],
)
def test_limits_are_the_numbers_of_the_page(
    tools: SimpleNamespace, begins: str, expected: list[tuple[float, float]]
) -> None:
    (criterion,) = (c for c in tools.criteria.CRITERIA if c.quantity.startswith(begins))
    found = [criterion.limits(text) for text in criterion.texts]
    assert found == [pytest.approx(each) for each in expected]


def driving(tools: SimpleNamespace, **values: list[float]) -> pl.DataFrame:
    """The main test among human drivers: IDM+MOBIL's values, and then those of CHARMS by seed."""
    count = len(next(iter(values.values())))
    rows: dict[str, Any] = {
        "condition": ["main"] * count,
        "traffic": ["Human (I-75)"] * count,
        "ego": ["IDM+MOBIL"] + ["CHARMS"] * (count - 1),
        "seed": [None, *range(3010, 3009 + count)],
    }
    return pl.DataFrame({**rows, **dict.fromkeys(tools.tables.DRIVING, [0.4] * count), **values})


@pytest.mark.parametrize(
    ("metric", "values", "words", "mean", "worst", "verdicts"),
    [
        # 0.1 % and twice that
        ("crashed_at_fault", [0.0, 0.0005, 0.0025], "main; dens", "0.150 %", "0.250 %", "no no"),
        ("crashed_at_fault", [0.0, 0.0, 0.0018], "main; dens", "0.090 %", "0.180 %", "yes yes"),
        # at least 0.3 m/s more than IDM+MOBIL, and half of that
        ("speed_mean", [27.0, 27.1, 27.6], "speed less", "0.35", "0.10", "yes no"),
        # at most IDM+MOBIL's
        ("lane_changes_undone", [0.02, 0.01, 0.05], "undone", "3.0 %", "5.0 %", "no no"),
        # from 0.1 to 0.75, widened to 0.05 to 1.5
        ("lane_changes_per_km", [0.2, 0.04, 0.3], "lane changes per", "0.17", "0.04", "yes no"),
    ],
)
def test_mean_and_worst_seed_are_held_against_the_limit(
    tools: SimpleNamespace,
    metric: str,
    values: list[float],
    words: str,
    mean: str,
    worst: str,
    verdicts: str,
) -> None:
    frames = {"driving": driving(tools, **{metric: values})}
    text = tools.verdicts.criteria_table(tools.verdicts.judged(frames))
    cells = row_of(text, words)
    assert cells[4].split(" [")[0] == mean
    assert cells[5:] == [worst, *verdicts.split()]


def test_of_several_cells_the_one_furthest_beyond_the_limit_is_shown(
    tools: SimpleNamespace,
) -> None:
    hazards = pl.DataFrame(
        {
            "scenario": ["slow", "slow", "cut-in", "cut-in"],
            "ego": ["CHARMS"] * 4,
            "at_fault": [0.001, 0.0065, 0.004, 0.004],
        }
    )
    frames = {"driving": driving(tools, speed_mean=[27.0, 27.1]), "hazards": hazards}
    text = tools.verdicts.criteria_table(tools.verdicts.judged(frames))
    cells = row_of(text, "hazard (sealed), cut-in")
    assert cells[4] == "0.400 % [0.400, 0.400]"
    assert cells[5:] == ["0.650 %", "no", "no"], "the worst seed is the one of slow vehicles"
    assert cells[1] == "0.3 %", "hazards have the limit of what is sealed, and a row of their own"


def test_what_is_not_driven_has_no_verdict(tools: SimpleNamespace) -> None:
    cells = row_of(tools.verdicts.criteria_table(tools.verdicts.judged({})), "R157")
    assert cells[4:] == ["–", "–", "–", "–"]


def styles(rng: np.random.Generator, **differences: float) -> pl.DataFrame:
    """Eight styles of five seeds; in efficient, competitive and egoistic ones, metrics differ."""
    rows = []
    for seed in range(5):
        for priority in ("efficient", "safe"):
            for svo in ("competitive", "egoistic", "prosocial", "altruistic"):
                more = {
                    "speed_mean": priority == "efficient",
                    "time_headway_mean": priority == "safe",
                    "imposed_braking_mean": svo in ("competitive", "egoistic"),
                    "gaps_taken_per_1000km": svo in ("competitive", "egoistic"),
                }
                row = {
                    name: 10 * seed + differences[name] * is_more + rng.normal(0, 0.3)
                    for name, is_more in more.items()
                }
                rows.append({"style": f"{priority}_{svo}", "seed": seed, **row})
    found = pl.DataFrame(rows)
    return pl.concat(
        found.with_columns(pl.lit(when).alias("fine-tuning")) for when in ("before", "after")
    )


def test_statements_have_paired_t_tests_corrected_by_holm(tools: SimpleNamespace) -> None:
    values = styles(
        np.random.default_rng(4), speed_mean=2.0, time_headway_mean=0.5,
        imposed_braking_mean=0.2, gaps_taken_per_1000km=0.0,
    )  # fmt: skip
    found = tools.styles.statements(values)
    means = (
        values.filter(pl.col("fine-tuning") == "after")
        .group_by("seed", pl.col("style").str.starts_with("efficient").alias("more"))
        .agg(pl.col("speed_mean").mean())
        .sort("seed")
    )
    more, less = (means.filter(more=is_more)["speed_mean"].to_numpy() for is_more in (True, False))
    test = stats.ttest_rel(more, less)
    faster = found.row(4, named=True)
    assert faster["difference"] == pytest.approx((more - less).mean())
    bounds = test.confidence_interval(0.95)
    assert (faster["low"], faster["high"]) == pytest.approx((bounds.low, bounds.high))
    # Before and after are equal here, so of eight p-values, that of the speed is the smallest two.
    assert faster["p"] == pytest.approx(8 * test.pvalue)
    assert found["p"].max() == found["p"][3], "no difference in the gaps"


def test_a_difference_in_the_other_direction_is_no_evidence(tools: SimpleNamespace) -> None:
    values = styles(
        np.random.default_rng(5), speed_mean=-2.0, time_headway_mean=0.5,
        imposed_braking_mean=0.5, gaps_taken_per_1000km=0.5,
    )  # fmt: skip
    text = tools.verdicts.criteria_table(tools.verdicts.judged({"styles": values}))
    cells = row_of(text, "Holm over all")
    assert cells[3:5] == ["efficient styles are faster", "p: 1.000"]
    assert cells[6] == "no"


def test_variances_of_styles_and_seeds_are_those_of_the_simulated_model(
    tools: SimpleNamespace,
) -> None:
    rng = np.random.default_rng(1)
    rows = []
    for style in range(400):
        centre = rng.normal(0, 2.0)
        rows += [
            {"style": f"{style:03}", "seed": seed}
            | dict.fromkeys(
                (metric for metric, *_ in tools.styles.STATEMENTS.values()),
                centre + rng.normal(0, 0.5),
            )
            for seed in range(5)
        ]
    line = tools.styles.style_variances(pl.DataFrame(rows)).splitlines()[2]
    styles, seeds = (float(each) for each in line.strip("| ").split(" | ")[1:])
    assert styles == pytest.approx(2.0, rel=0.15)
    assert seeds == pytest.approx(0.5, rel=0.05)


def test_styles_are_told_apart_as_well_as_their_distributions_allow(
    tools: SimpleNamespace,
) -> None:
    rng = np.random.default_rng(2)
    centres = np.array([[0.0, 0.0], [2.0, 0.0]])  # of two styles, in standard deviations
    draw = rng.standard_normal((5, 2, 4000, 2)) + centres[:, None]
    stretched = draw @ np.array([[3.0, 1.0], [1.0, 2.0]])  # what is known of the best rule stays
    told = tools.styles.told_right(stretched)
    assert told == pytest.approx([stats.norm.cdf(1.0)] * 5, abs=0.03)


def test_styles_of_one_distribution_are_told_by_chance(tools: SimpleNamespace) -> None:
    draw = np.random.default_rng(3).standard_normal((5, 8, 500, 3))
    assert tools.styles.told_right(draw) == pytest.approx([1 / 8] * 5, abs=0.03)


def test_differences_of_pch_are_paired_by_seed(tools: SimpleNamespace) -> None:
    rng = np.random.default_rng(6)
    rows, faster = [], rng.normal(2.0, 0.1, 5)
    for seed in range(5):
        for tau in (0.5, 1.5, 3.0):
            for beta in (0.0, 0.5, 1.0):
                row = dict.fromkeys(tools.styles.PCH, 1.0)
                row["traffic_speed_mean"] = 100.0 * seed + tau + beta * faster[seed]
                label = f"tau {tau:g}, beta {beta:g}"
                rows.append({"traffic": label, "ego": "IDM+MOBIL", "seed": 3010 + seed, **row})
    text = tools.styles.plan_pch(pl.DataFrame(rows))
    bounds = stats.ttest_1samp(faster, 0.0).confidence_interval(0.95)
    cells = row_of(text, "beta 1 less beta 0", "mean over tau")
    assert cells[2] == f"{faster.mean():.2f} [{bounds.low:.2f}, {bounds.high:.2f}]"
    assert row_of(text, "tau 3 less tau 0.5", "beta 0.5")[2] == "2.50 [2.50, 2.50]"


def cell(ego: str, endings: list[str], faults: list[bool | None]) -> SimpleNamespace:
    episodes = pl.DataFrame({"episode": range(4), "ending": endings, "at_fault": faults})
    return SimpleNamespace(agent=ego, traffic="Cut-in", size=4, left_out=1, episodes=episodes)


def test_crashes_count_where_a_rule_survives(tools: SimpleNamespace) -> None:
    cells = [
        cell("Careful until clear", ["rear_end", "time", "time", "rear_end"], [True, *[None] * 3]),
        cell("Careful to standstill", ["time", "time", "time", "rear_end"], [None] * 4),
        cell("IDM+MOBIL", ["side", "side", "time", "side"], [False, False, None, False]),
        cell("CHARMS, seed 3010", ["side", "off_road", "time", "side"], [False, True, None, True]),
    ]
    found = tools.tables.scenarios(SimpleNamespace(cells=lambda: cells)).row(3, named=True)
    assert found["crashed"] == 0.75
    assert found["at_fault"] == 0.5
    assert (found["idm_mobil"], found["careful"], found["any"]) == (0.0, 0.5, 0.5)
    text = tools.tables.plan_scenarios(
        tools.tables.SCENARIOS, tools.tables.scenarios(SimpleNamespace(cells=lambda: cells))
    )
    assert "Cut-in 4 (and 1 left out)" in text


def test_trainings_have_hash_time_and_a_thinned_curve(
    tools: SimpleNamespace, tmp_path: Path
) -> None:
    folder = tmp_path / "seed-3012"
    folder.mkdir()
    for name in ("charms_efficient_egoistic", "charms_safe_egoistic", "dqn"):
        manifest = {"onnx_sha256": "0123456789abcdef" * 4, "cpu_s": 90.0}
        (folder / f"{name}.json").write_text(json.dumps(manifest))
        points = "\n".join(f"{step},{step / 7},0.25" for step in range(100))
        (folder / f"{name}.csv").write_text(f"steps,return_mean,crashed_share\n{points}\n")
    frames = tools.tables.trainings(tmp_path)
    text = tools.tables.plan_trainings(frames)
    cells = row_of(text, "charms_safe_egoistic")
    assert cells[1:] == ["`styles`", "1", "1.5"]
    assert row_of(text, "charms_efficient_egoistic")[1] == "`ego`"
    assert frames["trainings"].select("seed", "onnx_sha256").row(0) == (
        3012,
        manifest["onnx_sha256"],
    )
    thinned = tools.tables.thinned(frames["curves"], 2_000)
    assert len(thinned.write_csv()) <= 2_000
    for _, curve in thinned.group_by("network"):
        assert curve["steps"][-1] == 99
        assert curve["steps"].diff().drop_nulls().n_unique() == 1


def test_a_run_becomes_tables_with_its_metrics_and_what_is_missing_is_named(
    tools: SimpleNamespace, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    egos = [
        {"agent": "idm_mobil", "label": "IDM+MOBIL"},
        {"agent": "human", "label": "CHARMS, seed 3010"},
        {"agent": "stackelberg", "label": "CHARMS, seed 3011"},
    ]
    models = [{"traffic": "idm_mobil", "label": "IDM+MOBIL"}]
    suite = {"suite": "main", "episodes": 6, "seed": 970_000_000, "egos": egos}
    suite |= {"scene": {"profile": "charms", "lanes": 3, "density": 2.0}, "traffic_models": models}
    file = tmp_path / "main.yaml"
    file.write_text(yaml.safe_dump(suite))
    charms_bench.run(file, tmp_path / "main", workers=1)
    tools.tables.write_tables(tmp_path, tmp_path, tmp_path / "out", ["main", "pch", "criteria"])
    stored = stored_tables(tmp_path / "main", RunFolder(tmp_path / "main").suite()).metrics.frame()
    expected = stored.filter(metric="conflicts_by_per_1000km")["value"].to_list()
    values = tools.tables.values_of(tmp_path, "driving", {})
    assert values["conflicts_by_per_1000km"].to_list() == pytest.approx(expected, rel=1e-5)
    assert values["seed"].to_list() == [None, 3010, 3011]
    criteria = (tmp_path / "out" / "plan-criteria.md").read_text(encoding="utf-8")
    mean = np.mean(expected[1:])
    assert f"{mean:.1f}" in row_of(criteria, "conflicts caused")[4]
    printed = capsys.readouterr().out
    assert "pch: left out" in printed
    assert "plan-pch.md: left out" in printed
    assert "density-2" in criteria.splitlines()[-1]


def test_trials_are_ordered_by_limits_met_then_by_crashes_then_by_speed(
    tools: SimpleNamespace,
) -> None:
    within = {  # each of the nine criteria of the main test, within its limits
        "crashed_at_fault": 0.0005, "crashed_episodes": 0.001, "speed_mean": 26.0,
        "lane_changes_per_km": 0.3, "lane_changes_undone": 0.01, "mean_acceleration_std": 0.3,
        "strong_acceleration_rate": 0.01, "acceleration_reversals_per_min": 3.0,
        "centre_headway_below_1s": 0.1, "conflicts_by_per_1000km": 5.0,
    }  # fmt: skip
    egos = {
        "IDM+MOBIL": within | {"speed_mean": 25.0},
        "ppo-slower": within | {"speed_mean": 25.5},
        "ppo-crashes-and-crawls": within | {"crashed_at_fault": 0.05, "speed_mean": 20.0},
        "ppo-best": within,
        "ppo-safer": within | {"crashed_at_fault": 0.0, "lane_changes_per_km": 2.0},
    }
    models = ("Human (I-75)", "IDM+MOBIL")
    rows = [
        {"traffic": m, "ego": e, "seed": None, **its} for m in models for e, its in egos.items()
    ]
    table = tools.verdicts.trials_table(pl.DataFrame(rows)).splitlines()[2:]
    cells = [[cell.strip() for cell in row[1:-1].split("|")][:3] for row in table if row]
    # Conflicts have one limit, the others one in each traffic model.
    assert cells == [
        ["ppo-best", "17", "17"],
        ["ppo-slower", "17", "17"],
        ["ppo-safer", "15", "17"],
        ["ppo-crashes-and-crawls", "13", "17"],
    ]
