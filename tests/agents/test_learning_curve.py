"""Learning curves: what a point says, and the table that they are written to."""

import csv
from pathlib import Path
from typing import Any

from charms_agents.training.curve import Point, point_of, write_csv

from charms_bench.engine.endings import OFF_ROAD, REAR_END, SIDE, TIME


def episodes(*endings: int) -> list[dict[str, Any]]:
    return [
        {"episode_return": float(k), "steps": 10 * k, "ending": ending, "seed": k}
        for k, ending in enumerate(endings)
    ]


def test_a_point_averages_the_episodes_that_ended_since_the_last() -> None:
    point = point_of(episodes(TIME, REAR_END, SIDE, OFF_ROAD), 100, loss=0.25, exploration=0.5)
    assert (point.episodes, point.return_mean, point.length_mean) == (4, 1.5, 15.0)
    assert (point.crashed_share, point.off_road_share) == (0.5, 0.25)
    later = point_of([], 200, loss=float("nan"), exploration=0.5)
    assert (later.episodes, later.return_mean, later.loss) == (0, None, None)


def test_a_curve_is_written_as_a_table(tmp_path: Path) -> None:
    ended = [episodes(TIME, REAR_END), []]
    points = [point_of(each, 100 * (k + 1), 0.5, 1.0) for k, each in enumerate(ended)]
    write_csv(tmp_path / "curve.csv", Point, points)
    with (tmp_path / "curve.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert [row["steps"] for row in rows] == ["100", "200"]
    assert [row["crashed_share"] for row in rows] == ["0.5", ""]
