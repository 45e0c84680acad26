"""Standard form: explicit covariances, as in the textbook (Wan & van der Merwe 2000, algorithm 3.1).

This form is for reference and teaching. A covariance that is no longer positive definite is repaired, and the
repair is reported for its member. A variance that is not positive cannot be repaired: the member collapses.
"""

from __future__ import annotations

import math

import torch
from torch import Tensor

from ahnn.estimation.belief import Belief
from ahnn.estimation.linalg import cholesky_repaired
from ahnn.estimation.results import Predicted, Updated
from ahnn_plugins.ukf.parameters import Form, Residual, SigmaWeights


def predict(propagated: Tensor, weights: SigmaWeights, chol_q: Tensor) -> Predicted:
    """Return the belief with the moments of the propagated sigma points, plus Q.

    Args:
        propagated: (B, S, D) sigma points after the flow.
        weights: sigma point weights.
        chol_q: (B, D, D) lower factor of the process noise.
    """
    outer = propagated[:, 1:] - propagated[:, :1]
    mean, deviations = _centred(outer, propagated[:, 0], weights)
    covariance = _second_moment(deviations, deviations, weights) + chol_q @ chol_q.mT
    chol, repaired = cholesky_repaired(_symmetric(covariance))
    return Predicted(Belief(mean, chol), repaired)


def update(
    prior: Belief, images: Tensor, y: Tensor, residual: Residual, weights: SigmaWeights, chol_r: Tensor
) -> Updated:
    """Return the posterior given the components of y that are not NaN; arguments as in `square_root`."""
    present = ~torch.isnan(y)
    outer = torch.where(present.unsqueeze(1), residual(images[:, 1:], images[:, :1]), 0.0)
    y_pred, deviations = _centred(outer, images[:, 0], weights)
    # Missing components are filled in: a residual may mix components, and NaN would invalidate its gradient.
    innovation = torch.where(present, residual(torch.where(present, y, y_pred), y_pred), 0.0)
    pairs = present.unsqueeze(-1) & present.unsqueeze(-2)
    noise = torch.where(pairs, chol_r @ chol_r.mT, torch.diag_embed((~present).to(y.dtype)))
    chol_y, repaired_y = cholesky_repaired(
        _symmetric(_second_moment(deviations, deviations, weights) + noise)
    )
    spread = weights.radius * prior.chol.mT
    state = torch.cat((torch.zeros_like(spread[:, :1]), spread, -spread), dim=1)
    cross = _second_moment(state, deviations, weights)
    # whitened = gain chol_y, so that gain P_yy gainᵀ = whitened whitenedᵀ.
    whitened = torch.linalg.solve_triangular(chol_y.mT, cross, upper=True, left=False)
    white = torch.linalg.solve_triangular(chol_y, innovation.unsqueeze(-1), upper=False)
    mean = prior.mean + (whitened @ white).squeeze(-1)
    chol, repaired_x = cholesky_repaired(_symmetric(prior.covariance - whitened @ whitened.mT))
    nis = white.square().sum((-2, -1))
    diagonal = torch.diagonal(chol_y, dim1=-2, dim2=-1)
    # An integer tensor times a float would become float32.
    count = present.sum(-1).to(nis.dtype)
    log_likelihood = -0.5 * (nis + count * math.log(2.0 * math.pi)) - diagonal.log().sum(-1)
    # The factor of a covariance with a variance <= 0 is set to zero.
    lost = (torch.diagonal(chol, dim1=-2, dim2=-1) == 0.0).any(-1)
    singular = (diagonal == 0.0).any(-1) | lost
    repairs = repaired_x.to(torch.int64) + repaired_y
    deviation = torch.linalg.vector_norm(chol_y, dim=-1)
    return Updated(Belief(mean, chol), innovation, deviation, nis, log_likelihood, singular, repairs)


def _centred(outer: Tensor, centre: Tensor, weights: SigmaWeights) -> tuple[Tensor, Tensor]:
    """Return the weighted mean (B, N), and the deviations (B, S, N) of all points from it.

    The mean is centre + W sum e_i, which equals the weighted sum because the weights add up to one, and
    avoids cancellation for large negative centre weights.
    """
    shift = weights.outer * outer.sum(1, keepdim=True)
    return centre + shift[:, 0], torch.cat((-shift, outer - shift), dim=1)


def _second_moment(left: Tensor, right: Tensor, weights: SigmaWeights) -> Tensor:
    """Return sum_i Wc_i left_i right_iᵀ, shape (B, N, K)."""
    outer = weights.outer * (left[:, 1:].mT @ right[:, 1:])
    return outer + weights.covariance_centre * (left[:, :1].mT @ right[:, :1])


def _symmetric(matrix: Tensor) -> Tensor:
    return 0.5 * (matrix + matrix.mT)


STANDARD = Form("standard", predict, update, squares=True)
