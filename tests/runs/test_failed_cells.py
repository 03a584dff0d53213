"""Cells whose agents fail: the others are finished and in the tables."""

from pathlib import Path

import polars as pl
import pytest
import yaml
from command_line import charms_bench
from test_runner import SMALL

EGOS = [{"agent": "outside_raising", "label": "Raising"}, {"agent": "idm_mobil", "label": "IDM"}]
SUITE = {**SMALL, "episodes": 2, "egos": EGOS}


@pytest.mark.parametrize("reference", ["IDM", "Raising"])
def test_the_tables_of_a_run_hold_the_cells_that_are_finished(
    tmp_path: Path, reference: str
) -> None:
    suite = tmp_path / "suite.yaml"
    suite.write_text(yaml.safe_dump({**SUITE, "preventable_by": [reference]}))
    ran = charms_bench("run", suite, "--workers", 1, "--output", tmp_path / "run")
    assert ran.returncode == 2
    said = ran.stderr.splitlines()[-1]
    assert said.startswith("error: Raising in idm_mobil: agent 'outside_raising', episode 0, step")
    assert "; 1 of 2 cells are finished; `charms-bench show " in said
    shown = charms_bench("show", tmp_path / "run")
    assert shown.returncode == 0
    assert "0 of 2 episodes of Raising in idm_mobil" in shown.stderr
    table = pl.read_csv(tmp_path / "run" / "tables" / "small.csv")
    assert set(table["agent"]) == {"IDM"}


def test_a_cell_that_fails_has_no_rows_of_the_agent_of_before(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    suite = tmp_path / "suite.yaml"
    options = ("run", suite, "--workers", 1, "--output", tmp_path / "run")
    good = [{"agent": "stackelberg", "label": "Raising"}, EGOS[1]]
    suite.write_text(yaml.safe_dump({**SUITE, "egos": good}))
    assert charms_bench(*options).returncode == 0

    def decide(*_: object) -> None:
        raise RuntimeError("out of petrol")

    monkeypatch.setattr("charms_baselines.stackelberg.Stackelberg.drive", decide)
    monkeypatch.setattr("charms_bench.runs.shard.code_sha256", lambda module: "changed")
    assert charms_bench(*options).returncode == 2
    compared = charms_bench("compare", tmp_path / "run", "--egos", "Raising", "IDM")
    assert (compared.returncode, compared.stdout) == (2, "")
    shown = charms_bench("show", tmp_path / "run")
    assert "0 of 2 episodes of Raising in idm_mobil" in shown.stderr


def test_rare_events_of_the_other_cells_are_estimated(tmp_path: Path) -> None:
    suite = tmp_path / "suite.yaml"
    suite.write_text(yaml.safe_dump({**SUITE, "scene": {"duration_s": 1, "traffic_vehicles": 5}}))
    options = ("--samples", 100, "--runs", 5, "--workers", 1, "--output", tmp_path / "rare")
    estimated = charms_bench("rare", suite, *options)
    assert estimated.returncode == 2
    assert "error: Raising in idm_mobil: agent 'outside_raising', ep" in estimated.stderr
    table = pl.read_csv(next((tmp_path / "rare" / "tables").glob("*.csv")))
    assert set(table["agent"]) == {"IDM"}
