"""Backpropagation by hand against torch's autograd."""

import pytest

torch = pytest.importorskip("torch", reason="needs the extra 'train'")

from charms_agents.training.network import squared_error, untrained  # noqa: E402


@pytest.mark.parametrize("layers", [(), (16,), (256, 256), (32, 16, 8)])
@pytest.mark.parametrize("rows", [1, 32, 128])
def test_gradients_have_the_bits_of_autograd(layers: tuple[int, ...], rows: int) -> None:
    generator = torch.Generator().manual_seed(rows)
    network, same = untrained(layers, 0), untrained(layers, 0)
    observations = torch.randn(rows, 35, generator=generator)
    actions = torch.randint(5, (rows, 1), generator=generator)
    wanted = torch.randn(rows, generator=generator)
    loss = squared_error(network, observations, actions, wanted)
    values = same(observations).gather(1, actions)[:, 0]
    expected = torch.nn.functional.mse_loss(values, wanted)
    expected.backward()
    assert loss == pytest.approx(float(expected.detach()), rel=1e-6)
    for parameter, other in zip(network.parameters(), same.parameters(), strict=True):
        assert torch.equal(parameter.grad, other.grad)
