"""Input gradient of a perceptron and its backward pass in closed form, without autograd.

For a network N with hidden layers a_l = sigma(z_l), z_l = W_l a_{l-1} + b_l, the gradient is the transposed
pass delta_l = u_l sigma'(z_l), u_{l-1} = delta_l W_l, which starts from u_L, the output weights, and ends
with a matrix E: f = delta_1 E. E = W_1 gives grad N; other matrices include a scaling and rotation.

Since v . grad N is the directional derivative of N along v, the backward pass consists of a forward pass of
tangents and the usual backward pass, coupled by the curvature sigma''
(Pearlmutter 1994, Neural Comp. 6, 147).
"""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor
from torch.nn import functional as F

from ahnn.dynamics.activations import Activation, Kernels


class Layers(NamedTuple):
    """Parameters of a scalar network with H units and F inputs, or gradients with respect to them.

    Attributes:
        weights: weights of the hidden layers, (H, F), then (H, H).
        biases: biases of the hidden layers, (H,).
        last: weights of the output, (H,).
        leave: final matrix E of the gradient, (H, F).
    """

    weights: list[Tensor]
    biases: list[Tensor]
    last: Tensor
    leave: Tensor

    @property
    def tensors(self) -> tuple[Tensor, ...]:
        """All tensors: weights, biases, last and leave."""
        return (*self.weights, *self.biases, self.last, self.leave)

    def zeros(self) -> Layers:
        """Return zero gradients, with matrices transposed to (F, H), as `reverse` accumulates them."""
        weights = [torch.zeros_like(w.T) for w in self.weights]
        biases = [torch.zeros_like(b) for b in self.biases]
        return Layers(weights, biases, torch.zeros_like(self.last), torch.zeros_like(self.leave.T))


class LayerRecord(NamedTuple):
    """Intermediate values of one hidden layer for the backward pass.

    Attributes:
        entered: a_{l-1}, (B, F) or (B, H).
        slope: sigma'(z_l), (B, H).
        delta: delta_l, (B, H).
        bend: u_l sigma''(z_l), (B, H).
    """

    entered: Tensor
    slope: Tensor
    delta: Tensor
    bend: Tensor


def plain_gradient(x: Tensor, layers: Layers, activation: Activation) -> Tensor:
    """Return f, shape (..., F), at the inputs x, shape (..., F), by differentiable operations."""
    slopes = []
    for weight, bias in zip(layers.weights, layers.biases, strict=True):
        x, slope = activation.value_and_slope(F.linear(x, weight, bias))
        slopes.append(slope)
    delta = layers.last * slopes[-1]
    for weight, slope in zip(layers.weights[:0:-1], slopes[-2::-1], strict=True):
        delta = (delta @ weight) * slope
    return delta @ layers.leave


def _upwards(x: Tensor, layers: Layers, kernels: Kernels) -> tuple[list[Tensor], list[Tensor]]:
    """Return a_{l-1} and y_l of each hidden layer, with y as defined by the activation's kernels."""
    entered, seen = [], []
    last = len(layers.weights) - 1
    for k, (weight, bias) in enumerate(zip(layers.weights, layers.biases, strict=True)):
        z = torch.addmm(bias, x, weight.T)
        entered.append(x)
        x = kernels.value(z) if kernels.by_value or k < last else z
        seen.append(x if kernels.by_value else z)
    return entered, seen


def gradient(x: Tensor, layers: Layers, kernels: Kernels) -> Tensor:
    """Return f, shape (B, F), at the inputs x, shape (B, F)."""
    _, seen = _upwards(x, layers, kernels)
    ones = torch.ones_like(seen[-1])
    delta = kernels.pull(ones, seen[-1]).mul_(layers.last)
    for weight, y in zip(layers.weights[:0:-1], seen[-2::-1], strict=True):
        delta = kernels.pull(ones, y).mul_(torch.mm(delta, weight))
    return _narrow(delta, layers.leave)


def recorded_gradient(x: Tensor, layers: Layers, kernels: Kernels) -> tuple[Tensor, list[LayerRecord]]:
    """Return f, shape (B, F), at the inputs x, shape (B, F), and the layer records for `reverse`."""
    entered, seen = _upwards(x, layers, kernels)
    ones = torch.ones_like(seen[-1])
    records: list[LayerRecord] = []
    for k in reversed(range(len(seen))):
        u = torch.mm(records[-1].delta, layers.weights[k + 1]) if records else layers.last
        slope = kernels.pull(ones, seen[k])
        bend = kernels.curvature(seen[k], slope).mul_(u)
        records.append(LayerRecord(entered[k], slope, slope * u, bend))
    return _narrow(records[-1].delta, layers.leave), records[::-1]


def reverse(v: Tensor, records: list[LayerRecord], layers: Layers, sums: Layers) -> Tensor:
    """Return v . df/dx, shape (B, F), and add v . df/dparameters to `sums`, in place.

    Args:
        v: (B, F), gradient of a scalar with respect to f.
        records: result of `recorded_gradient`.
        layers: layers passed to `recorded_gradient`.
        sums: accumulated gradients of the scalar with respect to the parameters, initially `layers.zeros()`.
    """
    sums.leave.addmm_(v.T, records[0].delta)
    along, bends = torch.mm(v, layers.leave.T), []
    for k, record in enumerate(records):
        if k > 0:
            sums.weights[k].addmm_(along.T, record.delta)
            along = torch.mm(along, layers.weights[k].T)
        bends.append(record.bend * along)
        along.mul_(record.slope)
    sums.last.add_(along.sum(0))
    back = bends[-1]
    for k in reversed(range(len(records))):
        sums.weights[k].addmm_(records[k].entered.T, back)
        sums.biases[k].add_(back.sum(0))
        if k > 0:
            back = bends[k - 1].addcmul_(torch.mm(back, layers.weights[k]), records[k - 1].slope)
    return _narrow(back, layers.weights[0])


def _narrow(x: Tensor, matrix: Tensor) -> Tensor:
    """Return x @ matrix in column-major order: for few columns BLAS then takes a third of the time."""
    return torch.mm(matrix.T, x.T).T
