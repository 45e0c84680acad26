"""Robust losses of normalised residuals, by iterative reweighting.

A loss rho(e) with the weight w = rho'(e) / e has the gradient of w e^2 / 2 with w fixed, and that parabola
bounds it from above: a Gauss-Newton step on weighted residuals decreases it (iteratively reweighted least
squares; Huber 1981, section 7.8).
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


ROBUST: dict[str, Robust] = {
    "none": Robust(torch.square, torch.ones_like, torch.ones_like),
    "huber": Robust(
        _huber, lambda e: HUBER / e.abs().clamp(min=HUBER), lambda e: (e.abs() <= HUBER).to(e.dtype)
    ),
    "student": Robust(
        lambda e: (FREEDOM + 1) * torch.log1p(e * e / FREEDOM),
        lambda e: (FREEDOM + 1) / (FREEDOM + e * e),
        lambda e: (FREEDOM + 1) * (FREEDOM - e * e) / (FREEDOM + e * e) ** 2,
        approach="huber",
    ),
}


def variance(robust: Robust, e: Tensor) -> float:
    """Return the factor that makes (J^T W J)^-1 a covariance, in units of the mean cost.

    W is the matrix of weights. A fit by rho has the covariance E rho'^2 / (E rho'')^2 (J^T J)^-1 (Huber 1981,
    section
    7.6); for squares it is (J^T J)^-1 times their mean, and the factor is 1.

    Args:
        robust: robust loss rho.
        e: residuals in standard deviations; 0 for missing ones.
    """
    e = e[e != 0]
    weight = robust.weight(e)
    spread = (weight * e).square().mean() * weight.mean() / robust.slope(e).mean().square()
    return float(spread / robust.cost(e).mean())
