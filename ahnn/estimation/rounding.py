"""Bounds on float64 rounding of estimates; members beyond the limit fail with a status.

A mean computed from images y has rounding error eps |y|. With sigma points at r standard deviations, it is
computed from differences, each with this error; their weights sum to D / r², the crowding. The total error
is about

    (1 + D / r²) eps |y|.

An update computes the innovation from numbers of size y, and triangularises deviations s of y: both have
errors of eps (|y| + s). The gain K propagates these to the mean, and since the posterior covariance includes
K R Kᵀ, the error in standard deviations is at most L_R⁻¹ eps (|y| + s).

A kernel that squares, i.e. computes covariances, loses twice as many digits: the error of P is eps P, which
may exceed the result of a subtraction, and the error of the innovation covariance is eps s sᵀ.

Rounding inside a flow or measurement model, for example in float32, is additional and not included.
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
"""Largest rounding error per step, as a fraction of a standard deviation; also defined in members.c."""


class Rounding(NamedTuple):
    """Amplification of rounding errors by a kernel.

    Attributes:
        crowding: (B or 1, ...) amplification of rounding in means, 0 for members where it is negligible; None
            if negligible for all.
        squares: whether covariances are computed, which costs digits and requires definite measurement noise.
        subtracts: whether negative weights may require repairs, which then do not indicate a loss of digits.
    """

    crowding: Tensor | None = None
    squares: bool = False
    subtracts: bool = False


def lost_in_prediction(
    before: Belief, after: Belief, repaired: Tensor | None, rounding: Rounding
) -> Tensor | None:
    """Return whether rounding in a prediction exceeds the limit, (B,) bool.

    Args:
        before: belief before the prediction.
        after: predicted belief.
        repaired: (B,) bool, or None for no repairs.
        rounding: rounding properties of the kernel.

    Returns:
        None if nothing is amplified.
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
    """Return whether rounding in an update exceeds the limit, (B,) bool.

    Args:
        prior: belief before the update.
        updated: result of the update.
        y: (B, M), NaN where missing.
        chol_r: (B, M, M) factor of R.
        rounding: rounding properties of the kernel.
    """
    present = ~y.isnan()
    spread = torch.where(present, updated.deviation.detach(), 0.0)
    sizes = y.detach().nan_to_num().abs() + updated.innovation.detach().abs() + spread
    exact = present & (torch.diagonal(chol_r.detach(), dim1=-2, dim2=-1) == 0.0)
    # A missing component is treated as uncorrelated. An exactly measured component uses its predicted
    # uncertainty; its posterior has no standard deviation with which its mean can be compared.
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
    """Return members that lost digits; losses due to negative weights are counted as repairs instead."""
    return lost if repairs is None or not rounding.subtracts else lost & (repairs == 0)


def _coarseness(belief: Belief) -> Tensor:
    """Return the largest ratio of |mean| to standard deviation, (B,)."""
    return (belief.mean.detach().abs() / deviations(belief.chol.detach())).amax(-1)


def _lost_digits(chol: Tensor, formed: Tensor) -> Tensor:
    """Return the largest relative error, (B,), of a variance in any direction.

    Args:
        chol: (B, D, D) factor of the covariance.
        formed: (B, D) deviations of the covariances from whose sum or difference it was computed.
    """
    return EPS * _whitened(chol, formed).square()


def _whitened(chol: Tensor, sizes: Tensor) -> Tensor:
    """Return errors of sizes (B, N) in standard deviations, (B,); inf for a singular factor."""
    off = torch.linalg.solve_triangular(chol, torch.diag_embed(sizes), upper=False)
    return off.square().sum((-2, -1)).sqrt()
