"""What float64 leaves of an estimate: where rounding may show, a member gets a status and stops.

A mean that a kernel forms of images y is rounded to eps |y|. Sigma points r standard deviations away form it
from differences, each rounded so, with weights that sum to D / r², its crowding: it is off by about

    (1 + D / r²) eps |y|.

An update forms the innovation from numbers of the size of y, and triangularises deviations s of y: both are
off by eps (|y| + s). The gain K brings that into the mean, and since K R Kᵀ is a part of the covariance after
the update, in standard deviations it is no more than what R makes of it: L_R⁻¹ eps (|y| + s).

A kernel that squares, which forms covariances, loses twice as many digits: of P it keeps eps P, of which a
subtraction may leave nothing, and of the innovation covariance eps s sᵀ.

What a flow or a measurement model rounds by itself, in float32 say, comes on top and is not known here.
"""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from ahnn.estimation.belief import Belief
from ahnn.estimation.consistency import deviations
from ahnn.estimation.linalg import EPS
from ahnn.estimation.results import Updated

LIMIT = 1e-3
"""Fraction of a standard deviation that rounding may cost in a step of either kind; members.c has it too."""


class Rounding(NamedTuple):
    """What a kernel amplifies of rounding.

    Attributes:
        crowding: (B or 1, ...) by which its means amplify rounding, of members for whom it matters, 0 of the
            others; None if it matters for no member.
        squares: whether it forms covariances, which costs digits and needs a definite measurement noise.
        subtracts: whether negative weights may leave what has to be mended: such a repair is no loss.
    """

    crowding: Tensor | None = None
    squares: bool = False
    subtracts: bool = False


def lost_in_prediction(
    before: Belief, after: Belief, repaired: Tensor | None, rounding: Rounding
) -> Tensor | None:
    """Return for which members rounding in a prediction exceeds the limit, (B,) bool.

    Args:
        before: belief.
        after: belief that was predicted.
        repaired: (B,) bool, or None for nobody.
        rounding: of the kernel.

    Returns:
        None where nothing is amplified.
    """
    if rounding.crowding is None and not rounding.squares:
        return None
    loss = torch.zeros_like(after.mean[:, 0])
    if rounding.crowding is not None:
        means = torch.maximum(*(_coarseness(belief) for belief in (before, after)))
        loss = EPS * rounding.crowding.flatten() * means
    if rounding.squares:
        loss = torch.maximum(loss, _lost_digits(after.chol.detach(), deviations(after.chol.detach())))
    return _not_mended(~(loss <= LIMIT), repaired, rounding)


def lost_in_update(prior: Belief, updated: Updated, y: Tensor, chol_r: Tensor, rounding: Rounding) -> Tensor:
    """Return for which members rounding in an update exceeds the limit, (B,) bool.

    Args:
        prior: belief before it.
        updated: its result.
        y: (B, M), NaN where missing.
        chol_r: (B, M, M) factor of R.
        rounding: of the kernel.
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
    if rounding.squares:
        loss = loss + _whitened(noise, spread).square() * (1.0 + updated.nis.detach().sqrt())
    coarse = torch.where(exact.any(-1), 0.0, _coarseness(updated.belief))
    loss = EPS * torch.maximum(loss, coarse)
    if rounding.crowding is not None:
        crowding = rounding.crowding.flatten()
        loss = torch.maximum((1.0 + crowding) * loss, EPS * crowding * _coarseness(prior))
    if rounding.squares:
        before = deviations(prior.chol.detach())
        loss = torch.maximum(loss, _lost_digits(updated.belief.chol.detach(), before))
    return _not_mended(~(loss <= LIMIT), updated.repairs, rounding)


def _not_mended(lost: Tensor, repairs: Tensor | None, rounding: Rounding) -> Tensor:
    """Return who lost digits, and not by negative weights: their repairs are counted and are no loss."""
    return lost if repairs is None or not rounding.subtracts else lost & (repairs == 0)


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
