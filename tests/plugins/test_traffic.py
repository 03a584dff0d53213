"""Traffics: proportions are probabilities, and names come out as often as they should."""

import numpy as np
import pytest
from scipy import stats

from charms_bench.errors import InputError
from charms_bench.plugins.traffic import Mixture, OneAgent


def test_one_agent_drives_everybody() -> None:
    assert (OneAgent("x").assign(np.random.default_rng(0), 2, 3) == "x").all()


def test_a_mixture_follows_its_composition() -> None:
    composition = {"a": 0.5, "b": 0.3, "c": 0.2}
    names = Mixture(composition).assign(np.random.default_rng(0), 500, 20)
    counts = [(names == name).sum() for name in composition]
    expected = [each * 10_000 for each in composition.values()]
    assert stats.chisquare(counts, expected).pvalue > 0.01


@pytest.mark.parametrize("composition", [{}, {"a": 0.5}, {"a": 1.5, "b": -0.5}])
def test_proportions_that_are_no_distribution_are_rejected(composition: dict[str, float]) -> None:
    with pytest.raises(InputError, match="must be non-negative and sum to 1"):
        Mixture(composition)
