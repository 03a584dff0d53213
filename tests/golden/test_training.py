"""Stages of the training suites make the networks, to the last bit, that were recorded."""

import json
from pathlib import Path

import pytest
from rows.history import missing
from rows.training import CASES

pytest.importorskip("torch", reason="needs the extra 'train'")
pytest.importorskip("onnx", reason="needs the extra 'train'")

if why := missing():
    pytest.skip(why, allow_module_level=True)

RECORDED = json.loads((Path(__file__).parent / "rows" / "data" / "training.json").read_text())
FAST = ("train: efficient_competitive", "train-baselines: imitation")


@pytest.mark.parametrize(
    "stage",
    [name if name in FAST else pytest.param(name, marks=pytest.mark.slow) for name in RECORDED],
)
def test_a_stage_makes_its_network(stage: str, tmp_path: Path) -> None:
    assert CASES[stage](tmp_path) == RECORDED[stage]
