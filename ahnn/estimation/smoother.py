"""Rauch-Tung-Striebel smoother in factored form.

A filter stores, for each step, the backward law: the distribution of the state before the step given the
state after it. The smoother composes these laws backwards in time: no covariance is subtracted, so none can
become indefinite.
"""

from __future__ import annotations

import torch
from torch import Tensor

from ahnn.estimation.belief import Belief, Status, choose
from ahnn.estimation.linalg import tria
from ahnn.estimation.results import Backward, FilterResult, SmootherResult

RANK = 1e-12
"""Relative size below which a singular value of a factor with unit rows is treated as zero."""


def backward_law(joint: Tensor) -> tuple[Backward, Tensor | None]:
    """Return the distribution of the state before a step given the state after it, (B, D, D).

    The gain is G = C P⁻¹, where C is the cross-covariance of the states before and after, and P the
    predicted covariance (Särkkä 2008, eq. 14); the factor is that of the conditional covariance
    P_k - G P Gᵀ. Where P is singular, G = C P⁺ with the pseudo-inverse of P scaled to unit variances.

    Args:
        joint: (B, 2 D, 2 D) lower factor of the covariance of the states after and before, in this order.

    Returns:
        The distribution, and a (B,) bool mask of the members whose P is singular; the mask is None if there
        are none.
    """
    size = joint.shape[-1] // 2
    chol_next, cross, chol_given = joint[:, :size, :size], joint[:, size:, :size], joint[:, size:, size:]
    gain = torch.linalg.solve_triangular(chol_next, cross, upper=False, left=False)
    singular = _singular(chol_next)
    if not bool(singular.any()):
        return Backward(gain, chol_given), None
    laws = _singular_law(chol_next[singular], cross[singular], chol_given[singular])
    gain = gain.index_put((singular,), laws[0])
    return Backward(gain, chol_given.index_put((singular,), laws[1])), singular


def _singular(chol: Tensor) -> Tensor:
    """Return whether finite lower factors (B, D, D) are numerically singular, (B,) bool."""
    diagonal = torch.diagonal(chol, dim1=-2, dim2=-1)
    deviation = chol.norm(dim=-1)
    # The smallest diagonal element bounds the smallest singular value from above, so it only selects
    # candidates.
    suspect = (diagonal <= 100.0 * RANK * deviation).any(-1) & deviation.isfinite().all(-1)
    if bool(suspect.any()):
        values = torch.linalg.svdvals(_scaled(chol[suspect])[0])
        suspect[suspect.clone()] = values[:, -1] <= RANK * values[:, 0]
    return suspect


def _singular_law(chol_next: Tensor, cross: Tensor, chol_given: Tensor) -> tuple[Tensor, Tensor]:
    """Return gains and conditional factors (B, D, D) for singular predicted covariances."""
    scaled, deviation = _scaled(chol_next)
    gain = cross @ (torch.linalg.pinv(scaled, rtol=RANK) / deviation.mT)
    # The part of the state that does not affect the image stays uncertain.
    rest = cross - gain @ chol_next
    return gain, tria(torch.cat((chol_given.mT, rest.mT), dim=1))


def _scaled(chol: Tensor) -> tuple[Tensor, Tensor]:
    """Return the factor of the correlation matrix, and the deviations (B, D, 1); zero rows are kept."""
    deviation = chol.norm(dim=-1, keepdim=True)
    deviation = torch.where(deviation > 0.0, deviation, 1.0)
    return chol / deviation, deviation


@torch.no_grad()
def smoother(result: FilterResult) -> SmootherResult:
    """Compute the beliefs given all measurements, from a filter run with `smoothing=True`.

    A member that failed at step k is smoothed over its steps before k, and NaN after them.

    Raises:
        ValueError: the filter was run without smoothing.
    """
    if result.backward is None:
        message = "smoother: expected backward kernels; received None; run the filter with smoothing=True"
        raise ValueError(message)
    steps = result.means.shape[1]
    smoothed = [Belief(result.means[:, -1], result.chols[:, -1])]
    for k in range(steps - 1, -1, -1):
        before = Belief(result.means[:, k - 1], result.chols[:, k - 1]) if k else result.initial
        smoothed.append(_step_back(result, result.backward, before, smoothed[-1], k))
    initial = smoothed.pop()
    smoothed.reverse()
    means = torch.stack([belief.mean for belief in smoothed], dim=1)
    chols = torch.stack([belief.chol for belief in smoothed], dim=1)
    return SmootherResult(initial, means, chols, result.status, result.repairs)


def _step_back(result: FilterResult, kernels: Backward, before: Belief, after: Belief, k: int) -> Belief:
    """Return the smoothed belief before step k, given the filtered one there and the smoothed one after."""
    law = Backward(kernels.gain[:, k], kernels.chol[:, k])
    found = stepped_back(before.mean, result.predicted_means[:, k], law, after)
    # The step at which a member failed contains no information about earlier times.
    holds = (result.status == Status.OK) | (k < result.failed_step)
    return choose(holds, found, before)


def stepped_back(before: Tensor, predicted: Tensor, law: Backward, after: Belief) -> Belief:
    """Return the smoothed belief before a step.

    Args:
        before: (B, D) filtered mean before the step.
        predicted: (B, D) predicted mean after it.
        law: backward law of the step, (B, D, D).
        after: smoothed belief after the step.
    """
    correction = law.gain @ (after.mean - predicted).unsqueeze(-1)
    chol = tria(torch.cat((law.chol.mT, (law.gain @ after.chol).mT), dim=1))
    return Belief(before + correction.squeeze(-1), chol)
