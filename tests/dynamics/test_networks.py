"""Fresh networks have units of order one that differ, and a small output."""

from __future__ import annotations

import pytest
import torch

from ahnn.dynamics.networks import Perceptron


@pytest.mark.parametrize("inputs", [4, 100])
def test_fresh_weights_have_the_size_that_keeps_units_of_order_one(inputs):
    torch.manual_seed(0)
    width = 400
    network = Perceptron(inputs, 3, width=width, depth=3, activation="tanh")
    first, *others = network.hidden
    assert float(first.weight.detach().std()) == pytest.approx(inputs**-0.5, rel=0.1)
    for layer in others:
        assert float(layer.weight.detach().std()) == pytest.approx(width**-0.5, rel=0.02)
    for layer in network.hidden:
        bias = layer.bias.detach()
        assert -1 <= float(bias.min()) < -0.95
        assert 0.95 < float(bias.max()) <= 1
        assert abs(float(bias.mean())) < 0.12
    assert float(network.output.weight.detach().std()) == pytest.approx(0.1 * width**-0.5, rel=0.1)
    assert not bool(network.output.bias.any())


def test_the_smallest_network_has_one_unit():
    network = Perceptron(2, 1, width=1, depth=1, activation="sine").double()
    z = torch.tensor([[0.3, -0.2]], dtype=torch.float64)
    weight, bias = network.hidden[0].weight, network.hidden[0].bias
    angle = (z @ weight.T + bias).sum()
    expected = network.output.weight * torch.sin(angle) + network.output.bias
    assert torch.allclose(network(z), expected, rtol=1e-14)
    assert torch.allclose(network.gradient(z), network.output.weight * angle.cos() * weight, rtol=1e-14)
