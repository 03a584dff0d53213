"""The temperature of a network's distribution, by hand."""

import math

import numpy as np
import pytest
from charms_agents.training.supervised import HOTTEST, fitted_temperature, log_likelihood
from hypothesis import given
from hypothesis import strategies as st

THIRD = math.log(3)
"""Its softmax beside four zeros is 3/7, and theirs 1/7."""
VALUES = np.array([[THIRD, 0.0, 0.0, 0.0, 0.0]], dtype=np.float32)


def test_the_likelihood_is_that_of_the_labels() -> None:
    labels = np.array([[0.25, 0.75, 0.0, 0.0, 0.0]], dtype=np.float32)
    expected = 0.25 * math.log(3 / 7) + 0.75 * math.log(1 / 7)
    assert log_likelihood(VALUES, labels, 1.0) == pytest.approx(expected, rel=1e-6)
    assert log_likelihood(7 * VALUES, labels, 7.0) == pytest.approx(expected, rel=1e-6)


@given(st.floats(0.05, 50.0))
def test_the_temperature_at_which_labels_were_drawn_is_found(temperature: float) -> None:
    labels = np.array([[3, 1, 1, 1, 1]], dtype=np.float32) / 7
    found = fitted_temperature(VALUES * temperature, labels)
    assert found == pytest.approx(temperature, rel=1e-3)


def test_a_network_that_prefers_what_people_never_do_is_made_uniform() -> None:
    labels = np.array([[0.0, 0.25, 0.25, 0.25, 0.25]], dtype=np.float32)
    assert fitted_temperature(VALUES, labels) == pytest.approx(HOTTEST, rel=1e-4)
    assert log_likelihood(VALUES, labels, HOTTEST) == pytest.approx(-math.log(5), abs=1e-3)
