"""The gradient of a perceptron and its reverse, both written out: no autograd between input and parameters.

For a network N with hidden layers a_l = sigma(z_l), z_l = W_l a_{l-1} + b_l, the gradient is the transposed
pass delta_l = u_l sigma'(z_l), u_{l-1} = delta_l W_l, that begins with u_L, the weights of the output, and
leaves by a matrix E: f = delta_1 E. With E = W_1 it is grad N; other matrices scale and turn it on the way.

The reverse follows from v . grad N being the derivative of N along v: a pass of tangents upwards, then the
usual one downwards, with the curvature sigma'' where both meet (Pearlmutter 1994, Neural Comp. 6, 147).
"""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor
from torch.nn import functional as F

from ahnn.dynamics.activations import Activation, Kernels


class Layers(NamedTuple):
    """Parameters of a scalar network as its gradient uses them, or their gradients; H units, F inputs.

    Attributes:
        weights: of the hidden layers, (H, F), then (H, H).
        biases: of the hidden layers, (H,).
        last: of the output, (H,).
        leave: E, (H, F), by which the gradient leaves.
    """

    weights: list[Tensor]
    biases: list[Tensor]
    last: Tensor
    leave: Tensor

    def zeros(self) -> Layers:
        """Return zeros of the same shapes, matrices stored by columns as `_add` wants them."""
        weights = [torch.zeros_like(w.T).T for w in self.weights]
        biases = [torch.zeros_like(b) for b in self.biases]
        return Layers(weights, biases, torch.zeros_like(self.last), torch.zeros_like(self.leave.T).T)


class Record(NamedTuple):
    """What the reverse needs of one hidden layer.

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
    """Return f, shape (..., F), at the inputs x, shape (..., F), by operations that autograd follows."""
    slopes = []
    for weight, bias in zip(layers.weights, layers.biases, strict=True):
        x, slope = activation.value_and_slope(F.linear(x, weight, bias))
        slopes.append(slope)
    delta = layers.last * slopes[-1]
    for weight, slope in zip(layers.weights[:0:-1], slopes[-2::-1], strict=True):
        delta = (delta @ weight) * slope
    return delta @ layers.leave


def gradient(x: Tensor, layers: Layers, kernels: Kernels) -> Tensor:
    """Return f, shape (B, F), at the inputs x, shape (B, F)."""
    slopes, a = [], x
    for weight, bias in zip(layers.weights[:-1], layers.biases[:-1], strict=True):
        a, slope = kernels.value_and_slope(torch.addmm(bias, a, weight.T))
        slopes.append(slope)
    z = torch.addmm(layers.biases[-1], a, layers.weights[-1].T)
    delta = kernels.slope(z).mul_(layers.last)
    for weight, slope in zip(layers.weights[:0:-1], reversed(slopes), strict=True):
        delta = torch.mm(delta, weight).mul_(slope)
    return _narrow(delta, layers.leave)


def recorded_gradient(x: Tensor, layers: Layers, kernels: Kernels) -> tuple[Tensor, list[Record]]:
    """Return f, shape (B, F), at the inputs x, shape (B, F), and what `reverse` needs of each layer."""
    passed, a = [], x
    for weight, bias in zip(layers.weights[:-1], layers.biases[:-1], strict=True):
        z = torch.addmm(bias, a, weight.T)
        value, slope = kernels.value_and_slope(z)
        passed.append((a, z, slope))
        a = value
    z = torch.addmm(layers.biases[-1], a, layers.weights[-1].T)
    passed.append((a, z, kernels.slope(z)))
    records, u = [], layers.last
    for weight, (a, z, slope) in zip(reversed(layers.weights), reversed(passed), strict=True):
        delta = u * slope
        records.append(Record(a, slope, delta, kernels.curvature(z, slope).mul_(u)))
        if a is not x:
            u = torch.mm(delta, weight)
    return _narrow(records[-1].delta, layers.leave), records[::-1]


def reverse(
    v: Tensor, records: list[Record], layers: Layers, sums: Layers, inwards: bool = True
) -> Tensor | None:
    """Return v . df/dx, shape (B, F), and add v . df/dparameters to `sums`, in place.

    Args:
        v: (B, F), gradient of a scalar with respect to f.
        records: of `recorded_gradient`.
        layers: what it was given.
        sums: gradients of the same scalar with respect to the parameters.
        inwards: whether v . df/dx is wanted; None is returned where it is not.
    """
    _add(sums.leave, records[0].delta, v)
    along, bends = torch.mm(v, layers.leave.T), []
    for k, record in enumerate(records):
        if k > 0:
            _add(sums.weights[k], record.delta, along)
            along = torch.mm(along, layers.weights[k].T)
        bends.append(record.bend * along)
        along.mul_(record.slope)
    sums.last.add_(along.sum(0))
    back = bends[-1]
    for k in reversed(range(len(records))):
        _add(sums.weights[k], back, records[k].entered)
        sums.biases[k].add_(back.sum(0))
        if k > 0:
            back = bends[k - 1].addcmul_(torch.mm(back, layers.weights[k]), records[k - 1].slope)
    return _narrow(back, layers.weights[0]) if inwards else None


def _narrow(x: Tensor, matrix: Tensor) -> Tensor:
    """Return x @ matrix, by columns: where the result has few of them, BLAS takes a third of the time."""
    return torch.mm(matrix.T, x.T).T


def _add(total: Tensor, left: Tensor, right: Tensor) -> None:
    """Add left^T right, the right factor perhaps narrow, to a matrix stored by columns."""
    total.T.addmm_(right.T, left)
