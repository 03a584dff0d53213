"""Traffics: shares are probabilities, and names come out as often as they should."""

import numpy as np
import pytest
from scipy import stats

from charms_bench.errors import InputError
from charms_bench.plugins.traffic import Mixture, OneAgent


def test_one_agent_drives_everybody() -> None:
    assert (OneAgent("x").assign(np.random.default_rng(0), 2, 3) == "x").all()


def test_a_mixture_follows_its_shares() -> None:
    shares = {"a": 0.5, "b": 0.3, "c": 0.2}
    names = Mixture(shares).assign(np.random.default_rng(0), 500, 20)
    counts = [(names == name).sum() for name in shares]
    expected = [share * 10_000 for share in shares.values()]
    assert stats.chisquare(counts, expected).pvalue > 0.01


@pytest.mark.parametrize("shares", [{}, {"a": 0.5}, {"a": 1.5, "b": -0.5}])
def test_shares_that_are_no_distribution_are_rejected(shares: dict[str, float]) -> None:
    with pytest.raises(InputError, match="must be non-negative and sum to 1"):
        Mixture(shares)
