"""Whether a covariance of parameters holds what forecasts of unseen trajectories miss.

The start of each trajectory is fitted to the first half of its measurements, and its path goes on through the
second. To first order what it misses there is the noise, the error of the start, and the error of the
parameters, of which the fit of the start has taken up a part:

    r_2 = e_2 - O_2 O_1^+ e_1 + (S_2 - O_2 O_1^+ S_1) (theta - theta*),

with O and S the derivatives of the measurements by the start and by the parameters. The covariance is wide
enough if as many numbers lie within two standard deviations as of normal ones. A quantile and no likelihood:
where a network misses, it misses by far more in few places, which would speak for all.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import torch
from torch import Tensor

from ahnn.shooting.paths import sensitivities
from ahnn.shooting.starts import ITERATIONS, followed, linearised, refine
from ahnn.training.shooting import ShootingProblem, freedom

SCALES = torch.logspace(0, 6, 601, dtype=torch.float64)
"""Factors on the covariance that are compared."""
WITHIN, SHARE = 2.0, 0.9545
"""Standard deviations, and the share of normal numbers within them."""
REFUSED, FEWEST = 3.0, 4
"""Standard errors between trajectories by which a share is too small, and trajectories that have such."""
MEDIAN = 0.6745
"""Of |z|, z normal of unit variance."""
OUTLIER = 0.5
"""Robust weight below which a number says nothing."""
TRAJECTORIES = 200
"""Forecasts at most; the first of the held-out trajectories, whose order is random."""
CELLS = 5e7
"""Numbers in the largest tensor of sensitivities; longer batches are cut into parts of trajectories."""


class Forecast(NamedTuple):
    """What forecasts of B trajectories miss, in standard deviations of the noise.

    Attributes:
        missed: (B, N) predicted - measured; NaN where nothing was measured.
        known: (B, N) variance by noise and start, and the square of what parameters are known to be off.
        spread: (B, N) variance by the parameters.
    """

    missed: Tensor
    known: Tensor
    spread: Tensor

    def shares(self, scale: float) -> Tensor:
        """Return the share of the numbers of each trajectory within two deviations, the spread scaled."""
        within = self.missed.abs() <= WITHIN * (self.known + scale * self.spread).sqrt()
        return within.double().where(self.missed.isfinite(), torch.nan).nanmean(1)


def needed_scale(forecast: Forecast) -> float:
    """Return the factor on the spread that holds as much as it should; 1 unless 1 is refused."""
    forecast = Forecast(*(rows[forecast.missed.isfinite().any(1)] for rows in forecast))
    now, count = forecast.shares(1.0), len(forecast.missed)
    if count < FEWEST or float(now.mean() + REFUSED * now.std() / count**0.5) >= SHARE:
        return 1.0
    low, high = 0, len(SCALES) - 1
    while high - low > 1:
        middle = (low + high) // 2
        enough = float(forecast.shares(float(SCALES[middle])).mean()) >= SHARE
        low, high = (low, middle) if enough else (middle, high)
    return float(SCALES[high])


@torch.no_grad()
def forecasts(problem: ShootingProblem, theta: Tensor, factor: Tensor, offset: Tensor) -> Forecast:
    """Return the forecasts of trajectories that were held out.

    Args:
        problem: their measurements, fitted from end to end.
        theta: the parameters, shape (P,).
        factor: L, shape (P, R); L L^T is their covariance.
        offset: (P,) by which they are known to be off.
    """
    columns = torch.cat((factor, offset.unsqueeze(-1)), dim=-1)
    parts = [_forecast(problem, theta, columns, part) for part in _parts(problem, columns.shape[1])]
    none = theta.new_zeros(0, 0)
    return Forecast(*map(torch.cat, zip(*parts, strict=True))) if parts else Forecast(none, none, none)


def _parts(problem: ShootingProblem, columns: int) -> Iterator[slice]:
    count = min(len(problem.starts), TRAJECTORIES)
    cells = (problem.steps.lengths.shape[1] + 1) * problem.starts.shape[-1] * columns
    rows = max(1, int(CELLS // cells))
    return (slice(k, min(k + rows, count)) for k in range(0, count, rows))


def _forecast(problem: ShootingProblem, theta: Tensor, columns: Tensor, part: slice) -> Forecast:
    trial, steps, segment = problem.trial(theta), problem.steps.rows(part), problem.batch.rows(part)
    half = len(steps.ends) // 2
    whole, _ = followed(trial, problem.starts[part], segment, steps)
    of_use = trial.robust.weight(segment.residuals(whole[:, steps.ends])) > OUTLIER
    seen = segment.first(half - 1)
    fitted = refine(trial, problem.starts[part], seen, steps.first(half - 1), ITERATIONS)
    degrees = freedom(seen)
    kept = (degrees > 0) & fitted.sums.isfinite()
    states, _ = followed(trial, fitted.starts, segment, steps)
    now = linearised(trial, states, segment, steps)
    forcing = problem.forcing(theta, states) @ columns.to(torch.float32)
    moved = (now.of_state.float() @ sensitivities(now.jacobians.float(), forcing, steps)).double()
    before, after = (now.of_start[:, :half].flatten(1, 2), now.of_start[:, half:].flatten(1, 2))
    basis, triangle = torch.linalg.qr(before)
    taken = torch.linalg.solve_triangular(triangle, after, upper=True, left=False)  # O_2 R^-1
    left = moved[:, half:].flatten(1, 2) - taken @ (basis.mT @ moved[:, :half].flatten(1, 2))
    plain, there = segment.residuals(states[:, steps.ends]), ~segment.values.isnan() & of_use
    there &= kept[:, None, None] & plain.isfinite()
    spread = left.square()
    known = noise_variance(plain, there) * (1 + taken.square().sum(-1)) + spread[..., -1]
    missed = plain[:, half:].flatten(1).where(there[:, half:].flatten(1) & known.isfinite(), torch.nan)
    return Forecast(missed, known, spread[..., :-1].sum(-1))


def noise_variance(residuals: Tensor, there: Tensor) -> float:
    """Return the variance, at least 1, of what is white in residuals (B, K + 1, M), from neighbours in time.

    What a model misses moves slowly; differences leave the noise (von Neumann 1941, Annals of Mathematical
    Statistics 12, 367-395), and their median no outliers.
    """
    both = there[:, 1:] & there[:, :-1]
    steps = residuals.diff(dim=1)[both]
    return max(1.0, float(steps.abs().median() / MEDIAN) ** 2 / 2) if len(steps) else 1.0
