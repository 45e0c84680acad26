"""Multilayer perceptrons with a closed-form input gradient.

The gradient of a scalar network is its transposed pass, written with ordinary operations. Training a
Hamiltonian then needs a single backward pass, and evaluation needs no autograd: it works under `no_grad`,
`inference_mode`, `torch.compile` and `torch.export`, where `autograd.grad` does not.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any, cast

from torch import Tensor, nn

from ahnn.arguments import Count, check_arguments, checked
from ahnn.dynamics import fused_steps
from ahnn.dynamics.activations import ACTIVATIONS, ActivationName
from ahnn.dynamics.gradients import Layers, plain_gradient
from ahnn.memory import require_memory


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

    def layers(self) -> Layers:
        """Return the parameters as the gradient of a single output uses them."""
        hidden = list(cast(Iterable[nn.Linear], self.hidden))
        weights = [layer.weight for layer in hidden]
        return Layers(weights, [layer.bias for layer in hidden], self.output.weight[0], weights[0])

    def linearised(self, z: Tensor) -> tuple[Tensor, Callable[[Tensor], Tensor]]:
        """Return the outputs, shape (..., outputs), at z, and the way back of gradients from there."""
        layers, slopes = [*cast("Iterable[nn.Linear]", self.hidden)], []
        for layer in layers:
            z, slope = self.activation.value_and_slope(layer(z))
            slopes.append(slope)

        def back(gradient: Tensor) -> Tensor:
            found = gradient @ self.output.weight
            for layer, slope in zip(layers[::-1], slopes[::-1], strict=True):
                found = (found * slope) @ layer.weight
            return found

        return self.output(z), back

    def gradient(self, z: Tensor) -> Tensor:
        """Return the gradient of the single output with respect to z, shape (..., inputs)."""
        if fused_steps.applies(self.activation, z):
            return fused_steps.network_gradient(z, self.layers(), self.activation)
        return plain_gradient(z, self.layers(), self.activation)


def make_network(inputs: int, outputs: int, options: dict[str, Any]) -> Perceptron:
    """Return a perceptron from the options width, depth and activation; raises UserError for any other."""
    check_arguments("model.network", Perceptron, options, ("inputs", "outputs"))
    return Perceptron(inputs, outputs, **options)
