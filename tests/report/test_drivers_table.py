"""The table of drivers, from driver rows written by hand."""

from pathlib import Path
from typing import Any

import polars as pl
import pytest
from command_line import charms_bench
from ego_table import SUITE
from handmade_rows import driver

from charms_bench import open_run
from charms_bench.metrics.conduct import OF_DRIVERS
from charms_bench.recording.columns import DRIVER_SCHEMA
from charms_bench.report.drivers_table import from_frame, part_of
from charms_bench.runs.cells import CellRows

PARTS = [
    [driver(0, "a", True), driver(0, "a", vehicles=3, crashed=1), driver(1, "a", True)],
    [driver(2, "a", True, gaps_lost=2), driver(2, "a"), driver(2, "b", conflicts_by=1)],
]
"""Episodes 0 and 1, and episode 2; not every driver has vehicles in each."""


def table() -> dict[tuple[str, str], dict[str, Any]]:
    drivers = [(pl.DataFrame(part, schema=DRIVER_SCHEMA, strict=False),) for part in PARTS]
    cell = CellRows("ego agent", "mixed", size=3, parts=[], drivers=drivers)
    rows = from_frame(part_of(SUITE, cell), SUITE).frame().iter_rows(named=True)
    return {(row["driver"], row["metric"]): row for row in rows}


def test_each_agent_has_a_row_and_the_ego_comes_first() -> None:
    rows = table()
    assert list(dict.fromkeys(name for name, _ in rows)) == ["ego", "a", "b"]
    assert len(rows) == 3 * len(OF_DRIVERS)


@pytest.mark.parametrize(
    ("driver", "metric", "value", "n"),
    [
        ("ego", "gaps_lost_per_1000km", 1333.33, 3),  # 2 in 1.5 km
        ("ego", "speed_mean", 25.0, 3),
        ("a", "crashed", 0.25, 4),
        ("a", "gaps_lost_per_1000km", 0.0, 4),
        ("b", "conflicts_by_per_1000km", 2000.0, 1),
    ],
)
def test_values_are_those_of_the_drivers_own_rows(
    driver: str, metric: str, value: float, n: int
) -> None:
    row = table()[driver, metric]
    assert row["value"] == pytest.approx(value)
    assert row["n"] == n


def test_a_run_has_the_table_and_opens_it_again(tmp_path: Path) -> None:
    (tmp_path / "suite.yaml").write_text(
        "suite: small\nepisodes: 4\nscene: {duration_s: 3.0, traffic_vehicles: 5}\n"
        "egos: [{agent: idm_mobil}]\n"
        "traffic_models: [{traffic: {mixture: {idm_mobil: 0.5, stackelberg: 0.5}}}]\n"
    )
    charms_bench("run", "suite.yaml", "--workers", "1", cwd=tmp_path)
    stored = open_run(tmp_path / "runs" / "small").tables["small-drivers"]
    assert [row.labels[-1] for row in stored.rows] == ["ego", "idm_mobil", "stackelberg"]
    assert stored.columns[0].definition.startswith(
        "proportion of the driver's vehicles that collide"
    )
