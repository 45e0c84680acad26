"""Multilayer perceptrons, and the factory of networks from options."""

from __future__ import annotations

from typing import Any, final

import torch
from torch import Tensor, nn

from ahnn.arguments import Count, check_arguments, checked
from ahnn.dynamics.activations import ACTIVATIONS, ActivationName
from ahnn.dynamics.gaussian_process import GaussianProcess
from ahnn.dynamics.gradients import recorded_gradient
from ahnn.dynamics.layered import Network
from ahnn.dynamics.parameter_jacobians import layers_at, reversed_rows, with_value, write_rows
from ahnn.memory import require_memory


@final
@checked
class Perceptron(Network):
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
            nn.init.uniform_(layer.bias, -1, 1)  # spreads the units over the inputs
        nn.init.normal_(self.output.weight, std=0.1 * width**-0.5)
        nn.init.zeros_(self.output.bias)

    def write_rows(
        self, theta: Tensor, z: Tensor, slopes: Tensor, values: Tensor | None, out: Tensor
    ) -> None:
        """Write the parameter derivatives of t . dN/dz + v N; see `Network`."""
        layers, kernels = layers_at(self, theta), self.activation.kernels
        assert kernels is not None
        _, records = recorded_gradient(z.T.contiguous().T, layers, kernels)
        stage, _ = reversed_rows(slopes, records, layers.weights)
        if values is None:
            write_rows([stage], out)
            return
        last = torch.addmm(layers.biases[-1], records[-1].entered, layers.weights[-1].T)
        write_rows([with_value(stage, values, kernels.value(last))], out)
        out[..., -1] = values


def make_network(inputs: int, outputs: int, options: dict[str, Any]) -> Network:
    """Build a network from the options width, depth and activation; raises UserError for others.

    The activation `fourier` gives a Gaussian process, any other a perceptron.
    """
    kind = GaussianProcess if options.get("activation") == "fourier" else Perceptron
    check_arguments("model.network", kind, options, ("inputs", "outputs"))
    return kind(inputs, outputs, **options)
