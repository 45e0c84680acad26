"""Smooth activations with their slopes, once as formulas of autograd and once as few kernels without it."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Literal, NamedTuple

import torch
from torch import Tensor
from torch.nn import functional as F

ActivationName = Literal["gelu", "tanh", "silu", "sine"]

_DENSITY = 1 / math.sqrt(2 * math.pi)


class Kernels(NamedTuple):
    """Derivatives of an activation in few passes; results are new tensors, which a caller may overwrite.

    Attributes:
        value_and_slope: z -> (sigma, sigma').
        slope: z -> sigma'.
        curvature: (z, sigma') -> sigma''.
    """

    value_and_slope: Callable[[Tensor], tuple[Tensor, Tensor]]
    slope: Callable[[Tensor], Tensor]
    curvature: Callable[[Tensor, Tensor], Tensor]


class Activation(NamedTuple):
    """A smooth activation as functions z -> value and z -> (value, derivative), which autograd follows.

    Attributes:
        kernels: the same without autograd; None where there are none.
    """

    value: Callable[[Tensor], Tensor]
    value_and_slope: Callable[[Tensor], tuple[Tensor, Tensor]]
    kernels: Kernels | None = None


def _tanh(z: Tensor) -> tuple[Tensor, Tensor]:
    a = torch.tanh(z)
    return a, 1 - a * a


def _fast_tanh(z: Tensor) -> Tensor:
    # 2 / (1 + exp(-2z)) - 1: the logistic kernel takes a fifth of the time of torch.tanh on CPUs.
    return (z + z).sigmoid_().mul_(2).sub_(1)


def _tanh_slope(z: Tensor) -> Tensor:
    a = _fast_tanh(z)
    return a.mul_(a).neg_().add_(1)


def _tanh_both(z: Tensor) -> tuple[Tensor, Tensor]:
    a = _fast_tanh(z)
    return a, (a * a).neg_().add_(1)


def _tanh_curvature(z: Tensor, slope: Tensor) -> Tensor:
    return _fast_tanh(z).mul_(slope).mul_(-2)


def _gelu(z: Tensor) -> tuple[Tensor, Tensor]:
    # x Phi(x) with the normal distribution Phi (Hendrycks & Gimpel 2016); its slope is Phi + x phi.
    cumulative = torch.special.ndtr(z)
    return z * cumulative, cumulative + z * torch.exp(-0.5 * z * z) * _DENSITY


def _gelu_slope(z: Tensor) -> Tensor:
    return torch.ops.aten.gelu_backward(torch.ones_like(z), z)


def _gelu_curvature(z: Tensor, slope: Tensor) -> Tensor:
    del slope
    t = (z * z).mul_(-0.5)
    e = torch.exp(t)
    return e.addcmul_(e, t).mul_(2 * _DENSITY)  # phi (2 - z^2)


def _silu(z: Tensor) -> tuple[Tensor, Tensor]:
    s = torch.sigmoid(z)
    a = z * s
    return a, s + a * (1 - s)


def _silu_slope(z: Tensor) -> Tensor:
    return torch.ops.aten.silu_backward(torch.ones_like(z), z)


def _silu_curvature(z: Tensor, slope: Tensor) -> Tensor:
    s = torch.sigmoid(z)
    left = (1 - s).mul_(s)  # s' of the logistic function s; sigma' = s + z s'
    return (slope - s).mul_((s + s).neg_().add_(1)).add_(left, alpha=2)


def _sine(z: Tensor) -> tuple[Tensor, Tensor]:
    return torch.sin(z), torch.cos(z)


def _sine_curvature(z: Tensor, slope: Tensor) -> Tensor:
    del slope
    return torch.sin(z).neg_()


ACTIVATIONS: dict[str, Activation] = {
    "gelu": Activation(
        F.gelu, _gelu, Kernels(lambda z: (F.gelu(z), _gelu_slope(z)), _gelu_slope, _gelu_curvature)
    ),
    "tanh": Activation(torch.tanh, _tanh, Kernels(_tanh_both, _tanh_slope, _tanh_curvature)),
    "silu": Activation(
        F.silu, _silu, Kernels(lambda z: (F.silu(z), _silu_slope(z)), _silu_slope, _silu_curvature)
    ),
    "sine": Activation(torch.sin, _sine, Kernels(_sine, torch.cos, _sine_curvature)),
}
