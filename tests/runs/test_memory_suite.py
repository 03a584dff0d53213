"""A recurrent network, a stochastic one and a planner: rows that depend on their inputs alone."""

from pathlib import Path

import polars as pl
import pytest
from command_line import charms_bench
from rows.history import earlier_networks, missing

SUITE = """\
suite: small
episodes: 8
scene: {{duration_s: 6.0, traffic_vehicles: 8}}
egos: [{egos}]
traffic_models: [{{traffic: idm_mobil}}]
"""


def rows(folder: Path, workers: int, agents: tuple[str, ...]) -> pl.DataFrame:
    """The ego's rows of a run."""
    folder.mkdir()
    egos = ", ".join(f"{{agent: {agent}, label: {agent[-14:-6]}}}" for agent in agents)
    (folder / "suite.yaml").write_text(SUITE.format(egos=egos))
    run = charms_bench("run", "suite.yaml", "--workers", workers, cwd=folder)
    assert run.returncode == 0, run.stderr
    found = pl.concat(pl.read_parquet(path) for path in folder.rglob("steps/*.parquet"))
    return found.sort(found.columns)


def test_neither_the_workers_nor_the_order_of_the_egos_change_a_row(tmp_path: Path) -> None:
    if why := missing():
        pytest.skip(why)
    folder = earlier_networks(tmp_path) / "memory"
    networks = (f"{{onnx: {folder}/{name}.onnx}}" for name in ("recurrent", "stochastic"))
    agents = (*networks, "mpc")
    expected = rows(tmp_path / "one", 1, agents)
    assert rows(tmp_path / "two", 2, agents).equals(expected)
    assert rows(tmp_path / "reversed", 1, agents[::-1]).equals(expected)
