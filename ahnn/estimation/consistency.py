"""Consistency tests of filters: NEES, NIS, coverage and their acceptance bands.

Definitions and bands: Bar-Shalom, Li & Kirubarajan 2001, section 5.4. Innovations of a consistent filter
are white: the NIS of all members and times are independent. Estimation errors are correlated in time: the
NEES of one member at N times count as fewer than N independent values.
"""

from __future__ import annotations

import torch
from torch import Tensor

from ahnn.numbers import chi_square_quantile

GAUSSIAN = {1: 0.6826894921370859, 2: 0.9544997361036416, 3: 0.9973002039367398}
"""Probability of an error within 1, 2 and 3 standard deviations, erf(k / sqrt 2)."""


def nees(error: Tensor, chol: Tensor) -> Tensor:
    """Return the normalised estimation errors squared eᵀ P⁻¹ e, shape (B, T).

    Args:
        error: (B, T, D) estimate minus truth, NaN where either is missing.
        chol: (B, T, D, D) lower factors of P.
    """
    white = torch.linalg.solve_triangular(chol, error.unsqueeze(-1), upper=False).squeeze(-1)
    return white.square().sum(-1)


def band(degrees: float, count: float, probability: float = 0.95) -> tuple[float, float]:
    """Return the central band of the mean of `count` independent chi-square variables.

    The sum of N variables with m degrees of freedom each is chi-square with N m (Bar-Shalom, Li &
    Kirubarajan 2001, section 5.4.2).

    Args:
        degrees: degrees of freedom of each variable: D for NEES, M for NIS; the mean if they differ.
        count: number N of values: members for the mean over members at one time; for means over members and
            times, all rows for an NIS and `independent_count` for a NEES.
        probability: probability of the band, with equal tails.
    """
    count = max(count, 1)
    tail = (1 - probability) / 2
    low, high = (chi_square_quantile(p, count * degrees) / count for p in (tail, 1 - tail))
    return low, high


def independent_count(values: Tensor) -> float:
    """Return the effective number of independent values among (B, T), for the variance of their mean.

    The effective number of N values is N divided by their `correlation_time` (Bayley & Hammersley 1946), at
    most N and at least one per member.

    Args:
        values: (B, T), NaN where missing; each row contains all values correlated with one another.
    """
    there = values.isfinite()
    count = float(there.sum())
    members = float(there.any(-1).sum())
    time = correlation_time(values)
    return members if time is None else min(max(count / max(time, 1.0), members), count)


def correlation_time(values: Tensor) -> float | None:
    """Return 1 + 2 sum_k (1 - k/T) rho_k of values (B, T), in samples; None for constant values.

    The autocorrelations rho_k are estimated from all members, and summed up to the first pair of lags with a
    non-positive sum, beyond which estimates are noise (Geyer 1992, section 3.3). A first-order Gauss-Markov
    process with lag-one correlation a has the result (1 + a) / (1 - a) for large T.

    Args:
        values: (B, T), NaN where missing.
    """
    there = values.isfinite()
    steps = values.shape[1]
    if not bool(there.any()) or steps < 2:
        return None
    centred = torch.where(there, values - values[there].mean(), 0.0)
    products, pairs = (_lagged_sums(part) for part in (centred, there.to(values.dtype)))
    # Lags without any pair of values contribute nothing.
    covariance = torch.where(pairs > 0.5, products / pairs.clamp(min=1.0), 0.0)
    if not float(covariance[0]) > 0.0:
        return None
    weight = 1.0 - torch.arange(steps, dtype=values.dtype) / steps
    rho = (covariance / covariance[0] * weight)[: steps // 2 * 2]
    sums = rho.reshape(-1, 2).sum(-1)
    positive = (sums > 0.0).to(values.dtype).cumprod(0)
    return 2.0 * float((sums * positive).sum()) - 1.0


def _lagged_sums(values: Tensor) -> Tensor:
    """Return the sums over members and times of v_t v_{t+k}, (T,), for the lags k = 0, 1, ..., T - 1."""
    steps = values.shape[1]
    spectrum = torch.fft.rfft(values, n=2 * steps).abs().square().sum(0)
    return torch.fft.irfft(spectrum, n=2 * steps)[:steps]


def coverage(error: Tensor, deviation: Tensor) -> dict[int, float]:
    """Return the fraction of component errors, (B, T, D), within 1, 2 and 3 of their standard deviations."""
    ratio = (error / deviation).abs()
    ratio = ratio[ratio.isfinite()]
    return {k: float((ratio <= k).double().mean()) for k in GAUSSIAN}


def share_within(series: Tensor, limits: tuple[float, float]) -> float:
    """Return the fraction of finite values of a series, (T,), within limits."""
    values = series[series.isfinite()]
    return float(((values >= limits[0]) & (values <= limits[1])).double().mean())


def deviations(chol: Tensor) -> Tensor:
    """Return the standard deviations (..., D) of lower factors (..., D, D)."""
    return chol.square().sum(-1).sqrt()
