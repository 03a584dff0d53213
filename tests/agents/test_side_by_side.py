"""Two networks side by side, and networks that also observe commands."""

import numpy as np
import pytest
import torch
from charms_agents.training.network import side_by_side, untrained
from charms_agents.training.standardisation import folded, standardise, unfolded
from hypothesis import given, settings
from hypothesis import strategies as st

WIDTH = st.integers(1, 12)


def observations(seed: int, inputs: int) -> torch.Tensor:
    rng = np.random.default_rng(seed)
    return torch.from_numpy(rng.normal(size=(30, inputs)).astype(np.float32))


@settings(derandomize=True, deadline=None, max_examples=60)
@given(
    layers=st.lists(st.tuples(WIDTH, WIDTH), max_size=3),
    factor=st.floats(-10.0, 10.0),
    inputs=st.sampled_from([1, 35, 40]),
    seed=st.integers(0, 10_000),
)
def test_side_by_side_values_are_the_weighted_values_plus_the_logits(
    layers: list[tuple[int, int]], factor: float, inputs: int, seed: int
) -> None:
    first, second = (tuple(each[k] for each in layers) for k in (0, 1))
    network, prior = untrained(first, seed, inputs), untrained(second, seed + 1, inputs)
    seen = observations(seed, inputs)
    with torch.no_grad():
        found = side_by_side(network, factor, prior)(seen).numpy()
        expected = (factor * network(seen).double() + prior(seen).double()).numpy()
    np.testing.assert_allclose(found, expected, rtol=1e-4, atol=1e-4)


@pytest.mark.parametrize("inputs", [35, 40, 14 * 8])  # the last are those of `interaction`
def test_a_folded_network_takes_plain_observations(inputs: int) -> None:
    network, seen = untrained((16, 8), 3, inputs), observations(0, inputs)
    with torch.no_grad():
        expected = network(standardise(seen)).numpy()
        np.testing.assert_allclose(folded(network)(seen).numpy(), expected, rtol=1e-3, atol=1e-4)
        again = folded(unfolded(folded(network)))(seen).numpy()
    np.testing.assert_allclose(again, expected, rtol=1e-3, atol=1e-4)
