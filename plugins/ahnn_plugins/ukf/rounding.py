"""What float64 leaves of an estimate: where rounding may show, a member gets a status and stops.

The sigma points lie r = alpha sqrt(D + kappa) standard deviations from the mean. The mean of their images y
is formed from differences, each of which is rounded to eps |y|, with weights that sum to D / r², its
crowding: it is off by about

    (1 + D / r²) eps |y|.

An update forms the innovation from numbers of the size of y, and triangularises deviations s of y: both are
off by eps (|y| + s). The gain K brings that into the mean, and since K R Kᵀ is a part of the covariance after
the update, in standard deviations it is no more than what R makes of it: L_R⁻¹ eps (|y| + s).

A form that squares, which forms covariances, loses twice as many digits: of P it keeps eps P, of which a
subtraction may leave nothing, and of the innovation covariance eps s sᵀ.

What a flow or a measurement model rounds by itself, in float32 say, comes on top and is not known here.
"""

from __future__ import annotations

import torch
from torch import Tensor

from ahnn.estimation.belief import Belief
from ahnn.estimation.consistency import deviations
from ahnn.estimation.linalg import EPS
from ahnn_plugins.ukf.types import Updated, Weights

LIMIT = 1e-3
"""Fraction of a standard deviation that rounding may cost in a step of either kind; members.c has it too."""


def lost_in_prediction(before: Belief, after: Belief, weights: Weights, *, squares: bool) -> Tensor:
    """Return for which members rounding in a prediction exceeds the limit, (B,) bool.

    Args:
        before: belief.
        after: belief that was predicted.
        weights: of the points.
        squares: whether the form forms covariances.
    """
    loss = torch.zeros_like(after.mean[:, 0])
    if weights.crowding is not None:
        means = torch.maximum(*(_coarseness(belief) for belief in (before, after)))
        loss = EPS * weights.crowding.flatten() * means
    if squares:
        loss = torch.maximum(loss, _lost_digits(after.chol.detach(), deviations(after.chol.detach())))
    return ~(loss <= LIMIT)


def lost_in_update(
    prior: Belief, updated: Updated, y: Tensor, chol_r: Tensor, weights: Weights, *, squares: bool
) -> Tensor:
    """Return for which members rounding in an update exceeds the limit, (B,) bool.

    Args:
        prior: belief before it.
        updated: its result.
        y: (B, M), NaN where missing.
        chol_r: (B, M, M) factor of R.
        weights: of the points.
        squares: whether the form forms covariances.
    """
    present = ~y.isnan()
    spread = torch.where(present, updated.deviation.detach(), 0.0)
    sizes = y.detach().nan_to_num().abs() + updated.innovation.detach().abs() + spread
    exact = present & (torch.diagonal(chol_r.detach(), dim1=-2, dim2=-1) == 0.0)
    # The row of what is missing becomes that of a number without correlation; what is measured exactly is as
    # uncertain as it is predicted to be, and leaves a mean that has no deviation to be compared with.
    noisy = (present & ~exact).unsqueeze(-1)
    noise = torch.where(noisy, chol_r.detach(), torch.diag_embed(torch.where(exact, spread, 1.0)))
    loss = _whitened(noise, torch.where(present, sizes, 0.0))
    if squares:
        loss = loss + _whitened(noise, spread).square() * (1.0 + updated.nis.detach().sqrt())
    coarse = torch.where(exact.any(-1), 0.0, _coarseness(updated.belief))
    loss = EPS * torch.maximum(loss, coarse)
    if weights.crowding is not None:
        crowding = weights.crowding.flatten()
        loss = torch.maximum((1.0 + crowding) * loss, EPS * crowding * _coarseness(prior))
    if squares:
        before = deviations(prior.chol.detach())
        loss = torch.maximum(loss, _lost_digits(updated.belief.chol.detach(), before))
    return ~(loss <= LIMIT)


def _coarseness(belief: Belief) -> Tensor:
    """Return the largest mean in standard deviations, (B,)."""
    return (belief.mean.detach().abs() / deviations(belief.chol.detach())).amax(-1)


def _lost_digits(chol: Tensor, formed: Tensor) -> Tensor:
    """Return the error, (B,), of a variance in any direction, as a fraction of it.

    Args:
        chol: (B, D, D) factor of the covariance.
        formed: (B, D) deviations of the covariances that it is the sum or the difference of.
    """
    return EPS * _whitened(chol, formed).square()


def _whitened(chol: Tensor, sizes: Tensor) -> Tensor:
    """Return how many standard deviations errors of sizes (B, N) are, (B,); inf of a singular factor."""
    off = torch.linalg.solve_triangular(chol, torch.diag_embed(sizes), upper=False)
    return off.square().sum((-2, -1)).sqrt()
