"""Smooth activations and their slopes, as autograd formulas and as fused kernels without autograd."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, Literal, NamedTuple

import torch
from torch import Tensor
from torch.nn import functional as F

ActivationName = Literal["gelu", "tanh", "silu", "sine"]

_DENSITY = 1 / math.sqrt(2 * math.pi)


class Kernels(NamedTuple):
    """Fused kernels of an activation and its derivatives; results are new tensors that callers may overwrite.

    The derivatives are functions of y, which is sigma(z) or z itself.

    Attributes:
        value: z -> sigma(z).
        by_value: whether y = sigma(z).
        pull: (u, y) -> u sigma'(z).
        curvature: (y, sigma'(z)) -> sigma''(z).
    """

    value: Callable[[Tensor], Tensor]
    by_value: bool
    pull: Callable[[Tensor, Tensor], Tensor]
    curvature: Callable[[Tensor, Tensor], Tensor]


class Activation(NamedTuple):
    """Smooth activation as differentiable functions z -> value and z -> (value, derivative).

    Attributes:
        kernels: functions without autograd, or None.
    """

    value: Callable[[Tensor], Tensor]
    value_and_slope: Callable[[Tensor], tuple[Tensor, Tensor]]
    kernels: Kernels | None = None

    def __reduce__(self) -> tuple[Callable[..., Activation], tuple[Any, ...]]:
        """Copy and pickle named activations by name, since torch kernels cannot be pickled."""
        names = [name for name, known in ACTIVATIONS.items() if known is self]
        return (named, (names[0],)) if names else (Activation, tuple(self))


def named(name: str) -> Activation:
    """Return the activation with a given name."""
    return ACTIVATIONS[name]


def _tanh(z: Tensor) -> tuple[Tensor, Tensor]:
    a = torch.tanh(z)
    return a, 1 - a * a


def _fast_tanh(z: Tensor) -> Tensor:
    # 2 / (1 + exp(-2z)) - 1: the logistic kernel takes a fifth of the time of torch.tanh on CPUs.
    return (z + z).sigmoid_().mul_(2).sub_(1)


def _tanh_curvature(a: Tensor, slope: Tensor) -> Tensor:
    return torch.mul(a, slope).mul_(-2)


def _gelu(z: Tensor) -> tuple[Tensor, Tensor]:
    # x Phi(x) with the normal CDF Phi (Hendrycks & Gimpel 2016); its slope is Phi + x phi.
    cumulative = torch.special.ndtr(z)
    return z * cumulative, cumulative + z * torch.exp(-0.5 * z * z) * _DENSITY


_LOG_PEAK = torch.tensor(math.log(2 * _DENSITY), dtype=torch.float64)


def _gelu_curvature(z: Tensor, slope: Tensor) -> Tensor:
    del slope
    square = z * z
    e = torch.add(_LOG_PEAK, square, alpha=-0.5).exp_()  # 2 phi
    return e.addcmul_(e, square, value=-0.5)  # phi (2 - z^2)


def _silu(z: Tensor) -> tuple[Tensor, Tensor]:
    s = torch.sigmoid(z)
    a = z * s
    return a, s + a * (1 - s)


def _silu_curvature(z: Tensor, slope: Tensor) -> Tensor:
    s = torch.sigmoid(z)
    left = (1 - s).mul_(s)  # s' of the logistic function s; sigma' = s + z s'
    return (slope - s).mul_((s + s).neg_().add_(1)).add_(left, alpha=2)


def _sine(z: Tensor) -> tuple[Tensor, Tensor]:
    return torch.sin(z), torch.cos(z)


def _sine_curvature(z: Tensor, slope: Tensor) -> Tensor:
    del slope
    return torch.sin(z).neg_()


_aten = torch.ops.aten

ACTIVATIONS: dict[str, Activation] = {
    "gelu": Activation(F.gelu, _gelu, Kernels(F.gelu, False, _aten.gelu_backward, _gelu_curvature)),
    "tanh": Activation(torch.tanh, _tanh, Kernels(_fast_tanh, True, _aten.tanh_backward, _tanh_curvature)),
    "silu": Activation(F.silu, _silu, Kernels(F.silu, False, _aten.silu_backward, _silu_curvature)),
    "sine": Activation(
        torch.sin, _sine, Kernels(torch.sin, False, lambda u, z: torch.cos(z).mul_(u), _sine_curvature)
    ),
}
