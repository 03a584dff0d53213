"""Two agents side by side: what is tested, corrected and shown."""

import json
from typing import Any

import numpy as np
import pytest
from handmade_cells import cell_of, lines

from charms_bench.errors import InputError
from charms_bench.metrics import METRIC_SETS, PAPER
from charms_bench.report.comparison import by_pair, compare, to_dicts
from charms_bench.report.table import Table
from charms_bench.report.terminal import grid
from charms_bench.runs.cells import CellRows
from charms_bench.statistics.paired import holm
from charms_bench.world.scene import SceneSettings

SCENE = SceneSettings()
EPISODES = 80


def cell(agent: str, speed: float, crashes: int = 0, traffic: str = "idm") -> CellRows:
    """Episodes of 15 steps at about that speed, without a leader; the first ones end in a crash."""
    rng = np.random.default_rng(len(agent))
    heads = [
        {
            "episode": e,
            "ending": "side" if e < crashes else "time",
            "steps": 15,
            "duration_s": 5.0,
            "distance_m": 40.0,
        }
        for e in range(EPISODES)
    ]
    steps = [
        {"episode": e, "step": k, "speed": speed + rng.normal(), "acceleration": 0.0, "lane": 0}
        for e in range(EPISODES)
        for k in range(1, 16)
    ]
    return cell_of(agent, heads, steps, traffic)


def compared(*pairs: tuple[CellRows, CellRows], only: tuple[str, ...] = ()) -> Table:
    return compare(pairs, METRIC_SETS, SCENE, seed=0, only=only)


SAFE, WILD = cell("safe", 25.0), cell("wilder", 28.0, crashes=12)


def by_metric(table: Table) -> dict[str, dict[str, Any]]:
    return {row["metric"]: row for row in to_dicts(table) if row["metric_set"] != PAPER.label}


def test_a_row_has_both_values_and_their_difference() -> None:
    rows = by_metric(compared((SAFE, WILD)))
    crashed = rows["crashed_episodes"]
    assert (crashed["first_value"], crashed["second_value"]) == (0.0, 12 / 80)
    assert crashed["difference"] == pytest.approx(-0.15)
    assert crashed["p"] == pytest.approx(2 / 2**12)  # all of 12 in one direction
    assert rows["speed_mean"]["difference"] == pytest.approx(-3.0, abs=0.2)
    assert rows["speed_mean"]["separated"]
    assert not rows["acc_std"]["separated"]


def test_holms_correction_is_over_all_pairs_and_metrics() -> None:
    busy = cell("safe", 25.0, traffic="busy"), cell("wilder", 25.1, crashes=3, traffic="busy")
    rows = to_dicts(compared((SAFE, WILD), busy))
    assert len(rows) == 2 * sum(len(metric_set.metrics) for metric_set in METRIC_SETS)
    expected = holm(np.array([row["p"] for row in rows]))
    assert [row["corrected_p"] for row in rows] == expected.tolist()
    assert {row["traffic"] for row in rows} == {"idm", "busy"}


def test_fewer_metrics_cost_less_correction() -> None:
    (alone,) = to_dicts(compared((SAFE, WILD), only=("crashed_episodes",)))
    among_all = by_metric(compared((SAFE, WILD)))["crashed_episodes"]
    assert alone["corrected_p"] == alone["p"] < among_all["corrected_p"]


def test_of_a_metric_that_there_is_not_the_nearest_are_named() -> None:
    with pytest.raises(InputError, match=r"no metric named 'crashed'\. .*Did you mean") as error:
        compared((SAFE, WILD), only=("crashed",))
    said = str(error.value)
    assert "crashed_at_fault" in said
    assert "ttc_min" not in said
    assert "docs/metrics.md" in said


def test_intervals_without_0_are_explained_if_p_is_not_below_0_05() -> None:
    table = compared((SAFE, cell("slower", 25.0, crashes=6)))
    alone = [row for row in to_dicts(table) if not row["separated"]]
    count = sum((row["low"] or 0) > 0 or (row["high"] or 0) < 0 for row in alone)
    assert count > 0
    assert f"although the interval is without 0: {count}." in table.note
    assert "--metric" in table.note
    (crashed,) = to_dicts(one := compared((SAFE, WILD), only=("crashed_episodes",)))
    assert crashed["separated"]
    assert "without 0" not in one.note


def test_json_has_null_for_what_is_not_defined() -> None:
    row = by_metric(compared((SAFE, WILD)))["ttc_min"]
    assert row["difference"] is row["low"] is row["first_value"] is None
    assert (row["corrected_p"], row["separated"]) == (1.0, False)
    assert "NaN" not in json.dumps(to_dicts(compared((SAFE, WILD))))


def test_the_terminal_marks_what_is_separated_and_says_what_that_means() -> None:
    parts = by_pair(compared((SAFE, WILD)))
    shown = [line for part in parts for line in lines(grid(part, 100, stacked=False), 100)]
    assert shown[0].startswith("safe minus wilder, in idm: Metrics of the paper")
    assert max(map(len, shown)) <= 100
    (speed,) = (
        line for line in shown if line.lstrip().startswith("Mean speed (m/s)") and "* " in line
    )
    assert "<0.001" in speed
    text = " ".join(" ".join(shown).split())
    assert "Episodes: 80." in text
    assert "is below 0.05" in text
    assert "…" not in text
