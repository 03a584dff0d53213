"""Backpropagation of the squared error, without autograd.

For layers as narrow as ours, autograd's bookkeeping takes a large part of a gradient step. The
gradients have the same bits as autograd's.
"""

import torch
from torch import Tensor
from torch.nn import Linear, Sequential


@torch.no_grad()
def squared_error(
    network: Sequential, observations: Tensor, actions: Tensor, wanted: Tensor
) -> float:
    """The mean squared error of the values of the actions taken; sets its gradients.

    Args:
        network: Linear layers with ReLUs between them; `grad` of its parameters is overwritten.
        observations: (M, inputs).
        actions: (M, 1) the actions taken.
        wanted: (M,) the values that they should have.
    """
    layers = [layer for layer in network if isinstance(layer, Linear)]
    inputs = [observations]
    for layer in layers[:-1]:
        inputs.append(layer(inputs[-1]).relu_())
    values: Tensor = layers[-1](inputs[-1])
    errors = values.gather(1, actions)[:, 0] - wanted
    slope = torch.zeros_like(values).scatter_(1, actions, errors[:, None] * (2 / len(errors)))
    for layer, seen in zip(reversed(layers), reversed(inputs), strict=True):
        layer.weight.grad, layer.bias.grad = slope.t() @ seen, slope.sum(dim=0)
        if seen is not observations:
            slope = torch.ops.aten.threshold_backward(slope @ layer.weight, seen, 0)
    return float(errors.square().mean())
