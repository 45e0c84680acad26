"""Layered networks with a smooth activation and linear output, and their closed-form input gradient.

The gradient of a scalar network is a transposed pass of ordinary operations. Training a Hamiltonian then
needs a single backward pass, and evaluation needs no autograd and works under `no_grad`, `inference_mode`,
`torch.compile` and `torch.export`, where `autograd.grad` does not.
"""

from __future__ import annotations

import copy
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable
from typing import Any, Protocol, cast

import torch
from torch import Tensor, nn

from ahnn.dynamics import fused_steps
from ahnn.dynamics.activations import Activation
from ahnn.dynamics.gradients import Layers, plain_gradient


class Layer(Protocol):
    """Affine map z -> weight z + bias; weight (H, F) and bias (H,) are parameters or depend on them."""

    @property
    def weight(self) -> Tensor:
        """Weight matrix, shape (H, F)."""
        ...

    @property
    def bias(self) -> Tensor:
        """Bias vector, shape (H,)."""
        ...

    def __call__(self, z: Tensor) -> Tensor:
        """Return weight z + bias, shape (..., H), at z, shape (..., F)."""
        ...


class Network(nn.Module, ABC):
    """Hidden layers, each followed by the activation, and a linear output.

    Subclasses define the layers in their constructor and implement `write_rows` for their parameters.

    Attributes:
        activation: smooth activation.
        hidden: modules that implement `Layer`.
        output: the last layer.
    """

    activation: Activation
    hidden: nn.ModuleList
    output: nn.Linear

    def __deepcopy__(self, memo: dict[int, Any]) -> Network:
        """Return a copy with attributes of parameters, such as units (`energy_levels`), which torch omits."""
        made = memo[id(self)] = type(self).__new__(type(self))
        vars(made).update(copy.deepcopy(vars(self), memo))
        for own, other in zip(self.parameters(), made.parameters(), strict=True):
            vars(other).update(copy.deepcopy(vars(own), memo))
        return made

    def forward(self, z: Tensor) -> Tensor:
        """Return the outputs, shape (..., outputs), at the inputs z, shape (..., inputs)."""
        for layer in self.hidden:
            z = self.activation.value(layer(z))
        return self.output(z)

    def layers(self) -> Layers:
        """Return weights and biases in the form used by the gradient of a single output."""
        hidden = list(cast("Iterable[Layer]", self.hidden))
        weights = [layer.weight for layer in hidden]
        return Layers(weights, [layer.bias for layer in hidden], self.output.weight[0], weights[0])

    def linearised(self, z: Tensor) -> tuple[Tensor, Callable[[Tensor], Tensor]]:
        """Return the outputs, shape (..., outputs), at z, and the pullback of gradients at that point."""
        layers, slopes = [*cast("Iterable[Layer]", self.hidden)], []
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

    @abstractmethod
    def write_rows(
        self, theta: Tensor, z: Tensor, slopes: Tensor, values: Tensor | None, out: Tensor
    ) -> None:
        """Write the parameter derivatives of t . dN/dz + v N to `out`, for a network with one output.

        Args:
            theta: the parameters, (P,).
            z: inputs, (B, F).
            slopes: t, (B, R, F).
            values: v, (B, R), or None for zeros.
            out: (B, R, P).
        """


@torch.no_grad()
def silence(module: nn.Module) -> None:
    """Set the last layers, and so the outputs, of all networks in a module to zero; they then learn first."""
    for network in module.modules():
        if isinstance(network, Network):
            for parameter in network.output.parameters():
                parameter.zero_()
