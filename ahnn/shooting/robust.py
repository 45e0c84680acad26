"""Robust losses of normalised residuals, by iterative reweighting.

A loss rho(e) with weight w = rho'(e) / e has the same gradient as the parabola w e^2 / 2 with fixed w, which
bounds it from above: a Gauss-Newton step on weighted residuals decreases the loss (iteratively reweighted
least squares; Huber 1981, section 7.8).
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Literal, NamedTuple

import torch
from torch import Tensor

RobustName = Literal["none", "huber", "student"]
HUBER = 1.345
"""Residual from which Huber's loss is linear; efficiency 95 % on normal noise (Huber 1981)."""
FREEDOM = 4.0
"""Degrees of freedom of Student's distribution (Lange, Little & Taylor 1989)."""
NORMAL_FREEDOM = 1e12
"""Finite substitute for infinite degrees of freedom: the loss equals that of squares to all digits."""


class Robust(NamedTuple):
    """Robust loss of residuals e.

    Attributes:
        cost: e -> 2 rho(e), e^2 for squares.
        weight: e -> rho'(e) / e.
        slope: e -> rho''(e).
        approach: name of a convex loss for initial iterations, if this one has several minima.
    """

    cost: Callable[[Tensor], Tensor]
    weight: Callable[[Tensor], Tensor]
    slope: Callable[[Tensor], Tensor]
    approach: RobustName | None = None


def _huber(e: Tensor) -> Tensor:
    size = e.abs()
    return torch.where(size <= HUBER, e * e, 2 * HUBER * size - HUBER**2)


def student(freedom: float | Tensor) -> Robust:
    """Return the loss of Student's distribution: minus twice its log density, up to a constant.

    Args:
        freedom: degrees of freedom, one number or (M,) for M components; inf for normal noise.
    """
    nu = torch.as_tensor(freedom, dtype=torch.float64).clamp(max=NORMAL_FREEDOM)
    return Robust(
        lambda e: (nu + 1) * torch.log1p(e * e / nu),
        lambda e: (nu + 1) / (nu + e * e),
        lambda e: (nu + 1) * (nu - e * e) / (nu + e * e) ** 2,
        approach="huber",
    )


ROBUST: dict[str, Robust] = {
    "none": Robust(torch.square, torch.ones_like, torch.ones_like),
    "huber": Robust(
        _huber, lambda e: HUBER / e.abs().clamp(min=HUBER), lambda e: (e.abs() <= HUBER).to(e.dtype)
    ),
    "student": student(FREEDOM),
}


def loss_of(name: RobustName, freedom: Tensor | None) -> Robust:
    """Return the loss of Student's noise with degrees of freedom (M,), or the named loss if None."""
    return ROBUST[name] if freedom is None else student(freedom)


def informative(freedom: Tensor | None) -> Robust:
    """Return squares weighted by the Fisher information of a residual, (nu + 1) / (nu + 3).

    The weight is 1 for normal noise. The covariance of an initial state fitted by `loss_of` follows from
    these squares.
    """
    if freedom is None:
        return ROBUST["none"]
    weight = information(freedom)
    return Robust(lambda e: weight * e * e, lambda e: weight.expand_as(e), lambda e: weight.expand_as(e))


def information(freedom: Tensor) -> Tensor:
    """Return the Fisher information of a residual about its mean, in inverse squared scales, (M,)."""
    return torch.where(freedom.isinf(), 1.0, (freedom + 1) / (freedom + 3))


def variance(robust: Robust, e: Tensor) -> float:
    """Return the factor that makes (J^T W J)^-1 a covariance, in units of the mean cost.

    W is the matrix of weights. A fit by rho has the covariance E rho'^2 / (E rho'')^2 (J^T J)^-1 (Huber 1981,
    section 7.6); for squares it is (J^T J)^-1 times their mean, and the factor is 1.

    Args:
        robust: robust loss rho.
        e: residuals in standard deviations, (..., M); 0 for missing ones.
    """
    there = e != 0
    weight, slope, cost = (part(e)[there] for part in (robust.weight, robust.slope, robust.cost))
    spread = (weight * e[there]).square().mean() * weight.mean() / slope.mean().square()
    return float(spread / cost.mean())
