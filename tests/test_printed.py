"""Whatever the Python interface returns prints as a few lines."""

import re
from collections.abc import Callable

import pytest

import charms_bench
from charms_bench.api import Run
from charms_bench.envs.ego_env import EgoEnv

SUITE = """
suite: printed
episodes: 3
egos: [{agent: level_0, label: A}, {agent: idm_mobil, label: B}]
traffic_models: [{traffic: level_0, label: C}]
"""
LINES, CHARACTERS = 26, 3000


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Run:
    folder = tmp_path_factory.mktemp("printed")
    (folder / "suite.yaml").write_text(SUITE)
    return charms_bench.run(folder / "suite.yaml", folder / "run", workers=1)


RESULTS: dict[str, Callable[[Run], object]] = {
    "run": lambda run: run,
    "suite": lambda run: run.suite,
    "cells": lambda run: run.cells,
    "table": lambda run: run.table,
    "tables": lambda run: run.tables,
    "comparison": lambda run: run.compare(egos=("A", "B")),
    "edge cases": lambda run: run.edge_cases(),
    "replay": lambda run: run.replay(0, "A"),
    "what if": lambda run: run.what_if(0, 2, "idm_mobil", ego="A"),
    "audit": lambda run: run.audit(shards=1, workers=1),
    "references": lambda run: charms_bench.references(),
    "a reference": lambda run: charms_bench.references()["us101"],
    "mixture": lambda run: charms_bench.Mixture({"level_0": 0.5, "idm_mobil": 0.5}),
}


@pytest.mark.parametrize("name", RESULTS)
def test_it_prints_as_a_few_lines(name: str, run: Run) -> None:
    result = RESULTS[name](run)
    for text in (str(result), repr(result)):
        assert len(text.splitlines()) <= LINES
        assert len(text) <= CHARACTERS
        assert " object at 0x" not in text


def test_a_state_and_a_scene_print_as_one_line() -> None:
    env = EgoEnv(traffic="level_0")
    env.reset(seed=0)
    assert repr(env.get_state()) == "<SceneState: 1 scenes x 21 vehicles, after decisions 0>"
    assert repr(env.simulation.scene) == "<Scene: 1 scenes x 21 vehicles, 3 lanes>"


def test_a_table_says_what_it_leaves_out(run: Run) -> None:
    text = str(run.table).splitlines()
    assert "traffic C" in text[0]
    columns = len(run.table.columns)
    assert text[-1].endswith("more columns: .select(...) chooses columns, .frame() has all numbers")
    assert 0 < int(text[-1].split()[0]) < columns
    assert "more" not in str(run.table.select("speed_mean"))


def test_notebooks_show_bars_and_players(run: Run) -> None:
    shown = run.table.select("speed_mean")._repr_html_()
    assert shown.count("<em ") == 2 * 2  # a bar: two egos, two metric sets
    for result in (run.replay(0, "A"), run.what_if(0, 2, "idm_mobil", ego="A")):
        assert re.findall(r"<(\w+)", result._repr_html_()) == ["iframe"]


def test_the_packaged_references_say_what_they_are() -> None:
    found = charms_bench.references()
    assert list(found) == ["i24", "i75", "us101", "us101_corrected"]
    assert "997 vehicles" in repr(found["us101"])
    assert found["us101"].counts("speed").sum() == 15_542
