"""Learning curves: what a point says, and that they survive being stored."""

import csv
import json
from pathlib import Path

from charms_agents.training.curve import LearningCurve, Point, write_csv

from charms_bench.engine.simulation import OFF_ROAD, REAR_END, SIDE, TIME


def curve_of(*endings: int) -> LearningCurve:
    curve = LearningCurve()
    for k, ending in enumerate(endings):
        curve.add({"episode_return": float(k), "steps": 10 * k, "ending": ending, "seed": k})
    return curve


def test_a_point_averages_the_episodes_that_ended_since_the_last() -> None:
    curve = curve_of(TIME, REAR_END, SIDE, OFF_ROAD)
    curve.close(100, loss=0.25, exploration=0.5)
    (point,) = curve.points
    assert (point.episodes, point.return_mean, point.length_mean) == (4, 1.5, 15.0)
    assert (point.crashed_share, point.off_road_share) == (0.5, 0.25)
    curve.close(200, loss=float("nan"), exploration=0.5)
    later = curve.points[1]
    assert (later.episodes, later.return_mean, later.loss) == (0, None, None)


def test_a_stored_curve_goes_on_where_it_was() -> None:
    curve = curve_of(TIME, TIME)
    curve.close(100, loss=0.5, exploration=1.0)
    curve.add({"episode_return": 3.0, "steps": 7, "ending": TIME, "seed": 2})
    again = LearningCurve()
    again.restore(json.loads(json.dumps(curve.state())))
    for each in (again, curve):
        each.close(200, 0.5, 0.5)
    assert again.points == curve.points


def test_a_curve_is_written_as_a_table(tmp_path: Path) -> None:
    curve = curve_of(TIME, REAR_END)
    curve.close(100, loss=0.5, exploration=1.0)
    curve.close(200, loss=0.5, exploration=1.0)
    write_csv(tmp_path / "curve.csv", Point, curve.points)
    with (tmp_path / "curve.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert [row["steps"] for row in rows] == ["100", "200"]
    assert [row["crashed_share"] for row in rows] == ["0.5", ""]
