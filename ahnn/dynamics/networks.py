"""Multilayer perceptrons with a closed-form input gradient.

The gradient of a scalar network is its transposed pass, written with ordinary operations. Training a
Hamiltonian then needs a single backward pass, and evaluation needs no autograd: it works under `no_grad`,
`inference_mode`, `torch.compile` and `torch.export`, where `autograd.grad` does not.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from typing import Any, Literal, NamedTuple, cast

import torch
from torch import Tensor, nn
from torch.nn import functional as F

from ahnn.arguments import Count, check_arguments, checked
from ahnn.memory import require_memory

ActivationName = Literal["gelu", "tanh", "silu", "sine"]


class Activation(NamedTuple):
    """A smooth activation as one function z -> (value, derivative)."""

    value: Callable[[Tensor], Tensor]
    value_and_slope: Callable[[Tensor], tuple[Tensor, Tensor]]


def _tanh(z: Tensor) -> tuple[Tensor, Tensor]:
    a = torch.tanh(z)
    return a, 1 - a * a


def _gelu(z: Tensor) -> tuple[Tensor, Tensor]:
    # x Phi(x) with the normal distribution Phi (Hendrycks & Gimpel 2016); its slope is Phi + x phi.
    cumulative = torch.special.ndtr(z)
    return z * cumulative, cumulative + z * torch.exp(-0.5 * z * z) * (1 / math.sqrt(2 * math.pi))


def _silu(z: Tensor) -> tuple[Tensor, Tensor]:
    s = torch.sigmoid(z)
    a = z * s
    return a, s + a * (1 - s)


def _sine(z: Tensor) -> tuple[Tensor, Tensor]:
    return torch.sin(z), torch.cos(z)


ACTIVATIONS: dict[str, Activation] = {
    "gelu": Activation(F.gelu, _gelu),
    "tanh": Activation(torch.tanh, _tanh),
    "silu": Activation(F.silu, _silu),
    "sine": Activation(torch.sin, _sine),
}


@checked
class Perceptron(nn.Module):
    """Fully connected network with smooth activations.

    Args:
        inputs, outputs: sizes of the first and last layer.
        width: units of each hidden layer.
        depth: number of hidden layers.
        activation: gelu, tanh, silu or sine.
    """

    def __init__(
        self, inputs: int, outputs: int, *, width: Count, depth: Count, activation: ActivationName = "gelu"
    ) -> None:
        super().__init__()
        require_memory("network: width and depth", "weights", 8.0 * width * (inputs + width * (depth - 1)))
        self.activation = ACTIVATIONS[activation]
        self.hidden = nn.ModuleList(nn.Linear(inputs if i == 0 else width, width) for i in range(depth))
        self.output = nn.Linear(width, outputs)
        for layer in self.hidden:
            assert isinstance(layer, nn.Linear)
            nn.init.normal_(layer.weight, std=layer.in_features**-0.5)
            nn.init.uniform_(layer.bias, -1, 1)  # spread over the inputs: smooth units differ from the start
        nn.init.normal_(self.output.weight, std=0.1 * width**-0.5)
        nn.init.zeros_(self.output.bias)

    def forward(self, z: Tensor) -> Tensor:
        """Return the outputs, shape (..., outputs), at the inputs z, shape (..., inputs)."""
        for layer in self.hidden:
            z = self.activation.value(layer(z))
        return self.output(z)

    def gradient(self, z: Tensor) -> Tensor:
        """Return the gradient of the single output with respect to z, shape (..., inputs)."""
        slopes = []
        layers = cast(Iterable[nn.Linear], self.hidden)
        parts = [(layer.weight, layer.bias) for layer in layers]
        for weight, bias in parts:
            z, slope = self.activation.value_and_slope(F.linear(z, weight, bias))
            slopes.append(slope)
        g = self.output.weight[0] * slopes[-1]
        for (weight, _), slope in zip(parts[:0:-1], slopes[-2::-1], strict=True):
            g = (g @ weight) * slope
        return g @ parts[0][0]


def make_network(inputs: int, outputs: int, options: dict[str, Any]) -> Perceptron:
    """Return a perceptron from the options width, depth and activation; raises UserError for any other."""
    check_arguments("model.network", Perceptron, options, ("inputs", "outputs"))
    return Perceptron(inputs, outputs, **options)
