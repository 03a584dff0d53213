"""Episodes have the bits that highway-env's own vehicles had when they were recorded."""

from pathlib import Path

import numpy as np
import pytest
from rows.reference import QUANTITIES, cases, hashes

from charms_bench.testing.straight_parity import StraightCase

with np.load(Path(__file__).parent / "rows" / "data" / "reference.npz", allow_pickle=False) as data:
    RECORDED = dict(data)


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> dict[str, StraightCase]:
    return cases(tmp_path_factory.mktemp("recording"))


@pytest.mark.parametrize("name", RECORDED)
def test_an_episode_has_the_bits_of_highway_env(name: str, made: dict[str, StraightCase]) -> None:
    differing = np.argwhere(hashes(made[name]) != RECORDED[name])
    assert [(e, d, QUANTITIES[q]) for e, d, q in differing] == []
