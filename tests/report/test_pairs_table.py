"""How far egos are apart: planted differences are found, and nothing else is."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl
import pytest
from command_line import charms_bench
from handmade_cells import cell_of

from charms_bench.errors import SuiteError
from charms_bench.recording.columns import DRIVER_SCHEMA
from charms_bench.report.pairs_table import COMPARED, guess_summary, guessed, pairs_table
from charms_bench.report.run_files import measure, write_run
from charms_bench.runs.cells import CellRows
from charms_bench.runs.suite import Suite, load_suite

STYLES = Suite.model_validate(
    {
        "suite": "styles",
        "episodes": 60,
        "egos": [{"agent": name} for name in ("one", "other", "fast")],
        "traffic_models": [{"traffic": "idm"}],
        "pairs": True,
    }
)
EPISODES = 60
STEPS = 15
DIFFICULTY = np.random.default_rng(0).normal(0.0, 2.0, EPISODES)
"""What an episode adds to everybody's speed."""


def cell(agent: str, faster: float = 0.0, closer: float = 0.0, noise: int = 0) -> CellRows:
    """An ego at about 25 m/s and 30 m behind its leader, in episodes that all egos share."""
    rng = np.random.default_rng(noise)
    steps = [
        {
            "episode": e,
            "step": k + 1,
            "x": 8.0 * k,
            "speed": 25.0 + DIFFICULTY[e] + faster + rng.normal(0.0, 0.2),
            "acceleration": rng.normal(0.0, 0.5),
            "lane": 0,
            "leader_distance": 30.0 - closer + rng.normal(0.0, 2.0),
            "leader_speed": 25.0,
            **dict.fromkeys(("length", "leader_length"), 5.0),
        }
        for e in range(EPISODES)
        for k in range(STEPS)
    ]
    head = {"ending": "time", "steps": STEPS, "duration_s": STEPS / 3, "distance_m": 120.0}
    heads = [{"episode": e, **head} for e in range(EPISODES)]
    nothing = dict.fromkeys(DRIVER_SCHEMA, 0) | {"agent": agent, "is_ego": True, "vehicles": 1}
    drivers = [nothing | {"episode": e} for e in range(EPISODES)]
    of_drivers = [(pl.DataFrame(drivers, schema=DRIVER_SCHEMA),)]
    return cell_of(agent, heads, steps, drivers=of_drivers)


def by_metric(one: CellRows, other: CellRows) -> dict[object, dict[str, Any]]:
    return {row["metric"]: row for row in pairs_table(STYLES, [one, other]).frame().to_dicts()}


def test_a_planted_difference_is_found_with_its_sign_and_size() -> None:
    found = by_metric(cell("slow", noise=1), cell("fast", faster=0.5, noise=2))
    assert found["speed_mean"]["difference"] == pytest.approx(-0.5, abs=0.1)
    assert found["speed_mean"]["low"] < -0.5 < found["speed_mean"]["high"]
    assert found["speed_mean"]["separated"]
    assert not found["dhw_mean"]["separated"]


def test_what_episodes_have_in_common_does_not_blur_a_difference() -> None:
    # Speeds vary by 2 m/s from episode to episode: unpaired, 0.2 m/s would be lost among
    # 60 episodes, whose means differ by 2 * sqrt(2 / 60) = 0.37 m/s.
    found = by_metric(cell("slow", noise=1), cell("fast", faster=0.2, noise=2))
    assert found["speed_mean"]["separated"]


def test_egos_that_drive_alike_are_not_apart() -> None:
    found = by_metric(cell("one", noise=1), cell("other", noise=2))
    assert not any(row["separated"] for row in found.values())
    assert found["lane_changes_per_km"]["difference"] == 0.0
    assert found["lane_changes_per_km"]["p"] == 1.0


def test_every_pair_is_compared_by_every_metric() -> None:
    cells = [cell(name, noise=k) for k, name in enumerate("abcd")]
    rows = pairs_table(STYLES, cells).frame().to_dicts()
    assert len(rows) == 6 * len(COMPARED)
    assert {(row["first"], row["second"]) for row in rows} == {
        ("a", "b"), ("a", "c"), ("a", "d"), ("b", "c"), ("b", "d"), ("c", "d")
    }  # fmt: skip


def test_from_a_single_episode_nobody_is_guessed() -> None:
    cells = [replace(cell(name), size=1) for name in "ab"]
    assert guess_summary(STYLES, cells) == ""


def test_who_drives_differently_is_guessed_and_who_drives_alike_is_not() -> None:
    apart = [cell("slow", noise=1), cell("close", closer=15.0, noise=2)]
    right, asked = guessed(STYLES, apart)
    assert asked == 2 * EPISODES
    assert right / asked > 0.95
    right, asked = guessed(STYLES, [cell("one", noise=1), cell("other", noise=2)])
    assert 0.3 < right / asked < 0.7


def test_the_tables_say_how_many_pairs_are_apart(tmp_path: Path) -> None:
    cells = [cell("one", noise=1), cell("other", noise=2), cell("fast", faster=3.0, noise=3)]
    renamed = [replace(each, agent=f"{each.agent}|") for each in cells]
    write_run(STYLES, tmp_path, [measure(STYLES, each) for each in renamed], [], [])
    path = tmp_path / "tables" / f"{STYLES.suite}-pairs.md"
    text = path.read_text()
    assert text.startswith("2 of 3 pairs differ in at least one metric.")
    assert "by chance it would be 33.3 %" in text
    assert "| one\\| | other\\| |" in text
    assert pl.read_csv(path.with_suffix(".csv")).height == 3 * len(COMPARED)


SUITE = """\
suite: small
episodes: 12
scene: {duration_s: 3.0, traffic_vehicles: 5}
egos: [{agent: idm_mobil}, {agent: stackelberg}]
traffic_models: [{traffic: idm_mobil}]
pairs: true
"""


def test_a_suite_asks_for_pairs(tmp_path: Path) -> None:
    (tmp_path / "suite.yaml").write_text(SUITE)
    done = charms_bench("run", "suite.yaml", "--workers", "1", cwd=tmp_path)
    assert "In how many of 4 metrics each two egos differ" in done.stdout
    assert "1 pairs differ" in (tmp_path / "runs/small/tables/small-pairs.md").read_text()


def test_pairs_need_two_egos_in_one_traffic(tmp_path: Path) -> None:
    (tmp_path / "suite.yaml").write_text(SUITE.replace(", {agent: stackelberg}", ""))
    with pytest.raises(SuiteError, match="pairs needs two or more egos and one traffic"):
        load_suite(tmp_path / "suite.yaml")
