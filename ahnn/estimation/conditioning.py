"""Conditioning of a Gaussian belief on a measurement, from the joint triangular factor."""

from __future__ import annotations

import math

import torch
from torch import Tensor

from ahnn.estimation.belief import Belief
from ahnn.estimation.linalg import EPS
from ahnn.estimation.results import Updated
from ahnn.estimation.rounding import LIMIT


def present_noise(chol_r: Tensor, present: Tensor) -> Tensor:
    """Return noise rows (B, 2 M, M); a missing component has variance one and no correlation."""
    noise = chol_r.mT
    if not bool(present.all()):
        noise = torch.where(present.unsqueeze(1), noise, 0.0)
    return torch.cat((noise, torch.diag_embed((~present).to(noise.dtype))), dim=1)


def conditioned(
    prior: Belief, joint: Tensor, innovation: Tensor, y: Tensor, repaired: Tensor | None = None
) -> Updated:
    """Return the posterior (Kailath, Sayed & Hassibi 2000, chapter 12).

    Args:
        prior: belief before the measurement; only its mean is used.
        joint: (B, M + D, M + D) lower factor of the covariance of measurement (with noise) and state:
            [[chol_y, 0], [cross, chol]]. A missing component has variance one and no correlation.
        innovation: (B, M), zero where the component is missing.
        y: (B, M), NaN where missing.
        repaired: (B,) bool, whether the factor was repaired; None: no repairs.
    """
    size, present = y.shape[-1], ~torch.isnan(y)
    chol_y, cross, chol = joint[:, :size, :size], joint[:, size:, :size], joint[:, size:, size:]
    diagonal = torch.diagonal(chol_y, dim1=-2, dim2=-1)
    # Standard deviations below the rounding errors of the numbers subtracted count as zero.
    sizes = chol_y.norm(dim=-1) + y.nan_to_num().abs() + innovation.abs()
    singular = (diagonal <= EPS / LIMIT * sizes.detach()).any(-1)
    white = torch.linalg.solve_triangular(chol_y, innovation.unsqueeze(-1), upper=False)
    mean = prior.mean + (cross * white.mT).sum(-1)
    nis = white.square().sum((-2, -1))
    # An integer tensor times a float would become float32.
    count = present.sum(-1).to(nis.dtype)
    log_likelihood = -0.5 * (nis + count * math.log(2.0 * math.pi)) - diagonal.log().sum(-1)
    repairs = None if repaired is None else repaired.to(torch.int64)
    deviation = torch.linalg.vector_norm(chol_y, dim=-1)
    return Updated(Belief(mean, chol), innovation, deviation, nis, log_likelihood, singular, repairs)
