"""Figures of many cells at once: that every cell is in them, whatever it is called."""

from pathlib import Path

import polars as pl
import pytest

from charms_bench.errors import InputError
from charms_bench.report.matrix import write_matrices
from charms_bench.report.tables import LONG_SCHEMA
from charms_bench.report.tradeoff import OF_TRAFFICS, write_tradeoff


def table(*rows: tuple[str, str, str, float | None]) -> pl.DataFrame:
    made = [
        {
            "agent": agent,
            "traffic": traffic,
            "metric_set": "standard-1",
            "metric": metric,
            "value": value,
            "low": None if value is None else 0.9 * value,
            "high": None if value is None else 1.1 * value,
            "n": 10,
            "paper": None,
        }
        for agent, traffic, metric, value in rows
    ]
    return pl.DataFrame(made, schema=LONG_SCHEMA)


def cells(*names: tuple[str, str]) -> pl.DataFrame:
    rows = []
    for k, (agent, traffic) in enumerate(names):
        rows += [
            (agent, traffic, "speed_mean", 25.0 + k),
            (agent, traffic, "crashed_episodes", 0.01 * k),
            (agent, traffic, "traffic_crashed", None if k == 0 else 0.02),
        ]
    return table(*rows)


def test_every_cell_is_named_in_the_tradeoff(tmp_path: Path) -> None:
    write_tradeoff(tmp_path / "t.svg", cells(("A & B", "calm"), ("C", "calm"), ("C", "<busy>")))
    svg = (tmp_path / "t.svg").read_text()
    for name in ("A &amp; B", "C", "&lt;busy&gt;"):
        assert f" {name} -->" in svg


def test_traffics_of_one_ego_are_named_themselves(tmp_path: Path) -> None:
    rows = [
        ("IDM", traffic, metric, value)
        for traffic, density in (("calm", 1.9), ("busy", 2.6))
        for metric, value in (("interaction_density", density), ("traffic_crashed", 0.1))
    ]
    write_tradeoff(tmp_path / "t.svg", table(*rows), OF_TRAFFICS)
    svg = (tmp_path / "t.svg").read_text()
    assert "<!-- calm -->" in svg
    assert "<!-- busy -->" in svg


def test_drivers_at_the_same_place_keep_their_names_apart(tmp_path: Path) -> None:
    same = [(name, "calm", m, 0.01) for name in "AB" for m in ("speed_mean", "crashed_episodes")]
    write_tradeoff(tmp_path / "t.svg", table(*same))
    assert (tmp_path / "t.svg").exists()


def test_a_matrix_has_egos_down_and_traffics_across(tmp_path: Path) -> None:
    pairs = [(ego, traffic) for ego in ("A", "B|C") for traffic in ("calm", "busy")]
    write_matrices(tmp_path / "m.md", tmp_path / "m.svg", cells(*pairs))
    text = (tmp_path / "m.md").read_text()
    assert "| ego \\ traffic | calm | busy |" in text
    assert "| A | 0.0 [0.0, 0.0] | 1.0 [0.9, 1.1] |" in text
    assert "| B\\|C | 2.0 [1.8, 2.2] | 3.0 [2.7, 3.3] |" in text
    assert "| A | 25.0 [22.5, 27.5] | 26.0 [23.4, 28.6] |" in text
    assert "| A | – | 2.0 [1.8, 2.2] |" in text  # nothing is known of the traffic's crashes


def test_a_figure_of_an_unknown_kind_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"expected a name that ends in \.pdf, \.png, \.svg"):
        write_tradeoff(tmp_path / "t.jpeg", cells(("A", "calm")))
