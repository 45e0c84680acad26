"""Does a filter know how wrong it is? NEES, NIS, coverage, and the bands in which they should lie.

Definitions and bands: Bar-Shalom, Li & Kirubarajan 2001, section 5.4.
"""

from __future__ import annotations

import torch
from scipy.stats import chi2
from torch import Tensor

GAUSSIAN = {1: 0.6826894921370859, 2: 0.9544997361036416, 3: 0.9973002039367398}
"""Probability of an error within so many standard deviations, erf(k / sqrt 2)."""


def nees(error: Tensor, chol: Tensor) -> Tensor:
    """Return the normalised estimation errors squared eᵀ P⁻¹ e, shape (B, T).

    Args:
        error: (B, T, D) estimate less truth, NaN where either is missing.
        chol: (B, T, D, D) lower factors of P.
    """
    white = torch.linalg.solve_triangular(chol, error.unsqueeze(-1), upper=False).squeeze(-1)
    return white.square().sum(-1)


def band(size: int, members: int, probability: float = 0.95) -> tuple[float, float]:
    """Return where the mean over members of a chi-square variable with `size` degrees of freedom lies."""
    members = max(members, 1)
    tail = (1 - probability) / 2
    low, high = (float(chi2.ppf(p, members * size)) / members for p in (tail, 1 - tail))
    return low, high


def coverage(error: Tensor, deviation: Tensor) -> dict[int, float]:
    """Return the share of component errors, (B, T, D), within 1, 2 and 3 of their standard deviations."""
    ratio = (error / deviation).abs()
    ratio = ratio[ratio.isfinite()]
    return {k: float((ratio <= k).double().mean()) for k in GAUSSIAN}


def share_within(series: Tensor, limits: tuple[float, float]) -> float:
    """Return the share of the finite values of a series, (T,), that lie within limits."""
    values = series[series.isfinite()]
    return float(((values >= limits[0]) & (values <= limits[1])).double().mean())


def deviations(chol: Tensor) -> Tensor:
    """Return the standard deviations (..., D) that belong to lower factors (..., D, D)."""
    return chol.square().sum(-1).sqrt()
