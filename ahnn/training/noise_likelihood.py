"""Noise of residuals: standard deviations and coloured part, by restricted maximum likelihood.

Residuals r of a segment are noise minus the part absorbed by the D components of its initial state. With the
derivatives X of residuals with respect to these and the noise covariance V, twice the negative log likelihood
of the remaining part is

    log det V + log det(X^T V^-1 X) + r^T V^-1 r - b^T (X^T V^-1 X)^-1 b,    b = X^T V^-1 r

(Patterson & Thompson 1971, Biometrika 58, 545-554), so that an initial state that follows slow noise does not
make the noise look small or white.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from ahnn.measurements.coloured_noise import Colour, Whitening
from ahnn.training.student_likelihood import FoundTails

TELLING = 12.0
"""Twice the gain in log likelihood above which noise is coloured; it occurs by chance in 0.25 % of cases."""
MEMORIES = (2.0, 10.0)
"""Initial memories of the searches, in typical intervals."""
SHORTEST, LONGEST = 0.3, 3.0
"""Limits of a memory, in typical intervals and in durations of the longest segment."""
STEEP = 12.0
"""Limit of the logit of the coloured fraction, on either side."""
ENOUGH = 0.05
"""Gain in twice the log likelihood below which the search ends."""
RIDGE = 1e-12
"""Added to the diagonal of the normalised X^T V^-1 X: initial states may be partly unobservable."""


class Residuals(NamedTuple):
    """Residuals of fitted segments, in stated standard deviations, 0 where nothing was measured.

    Attributes:
        rows: residuals, (B, T, M).
        of_start: their derivatives with respect to the initial states, (B, T, M, D).
        times: (B, T).
        there: mask of the measured values, (B, T, M) bool.
    """

    rows: Tensor
    of_start: Tensor
    times: Tensor
    there: Tensor


class FoundNoise(NamedTuple):
    """Noise of M measured components.

    Attributes:
        scales: standard deviations, relative to the stated ones, (M,).
        colour: coloured part; None for white noise.
        tails: Student's noise of each component; None if not estimated.
    """

    scales: Tensor
    colour: Colour | None
    tails: tuple[FoundTails, ...] | None = None

    @property
    def freedom(self) -> Tensor | None:
        """Degrees of freedom (M,), inf where the noise is normal; None if all M components are normal."""
        found = torch.tensor([tail.freedom for tail in self.tails or ()], dtype=torch.float64)
        return None if bool(found.isinf().all()) else found


def restricted(left: Residuals, scales: Tensor, colour: Colour | None) -> Tensor:
    """Return twice the negative log likelihood of given noise, up to a constant."""
    rows = torch.cat((left.rows.unsqueeze(-1), left.of_start), dim=-1)
    volume = 2 * (left.there.sum((0, 1)) * scales.log()).sum()
    if colour is not None:
        whitening = Whitening.of(colour, left.times, left.there)
        rows, volume = whitening(rows), volume + whitening.log_determinant.sum()
    rows = (rows / scales[:, None]).flatten(1, 2)
    r, x = rows[..., :1], rows[..., 1:]
    size = x.square().sum(1, keepdim=True).sqrt().clamp(min=torch.finfo(x.dtype).tiny)
    x = x / size
    lower = torch.linalg.cholesky(x.mT @ x + RIDGE * torch.eye(x.shape[-1]).to(x))
    taken = torch.linalg.solve_triangular(lower, x.mT @ r, upper=False)
    volume = volume + 2 * (lower.diagonal(dim1=-2, dim2=-1).log().sum() + size.log().sum())
    return volume + r.square().sum() - taken.square().sum()


def most_likely(left: Residuals, *, sizes: bool, correlation: bool) -> FoundNoise:
    """Return the most likely noise.

    Args:
        left: residuals of the fit.
        sizes: whether standard deviations are unknown; otherwise they are the stated ones.
        correlation: whether to search for a coloured part.
    """
    count = left.rows.shape[-1]
    stated = torch.ones(count, dtype=left.rows.dtype)
    typical = float(left.times.diff(dim=1).median())
    longest = float((left.times[:, -1] - left.times[:, 0]).max())

    def noise(found: np.ndarray | Tensor, coloured: bool) -> FoundNoise:
        logs = torch.as_tensor(found).view(-1, count)
        scales, more = (logs[0].exp(), logs[1:]) if sizes else (stated, logs)
        return FoundNoise(scales, Colour(more[0].sigmoid(), more[1].exp()) if coloured else None)

    def searched(
        begin: list[float], limits: list[tuple[float, float]], coloured: bool
    ) -> tuple[float, Tensor]:
        from scipy.optimize import minimize  # the import takes a fifth of a second

        def value(found: np.ndarray) -> tuple[float, np.ndarray]:
            at = torch.tensor(found, requires_grad=True)
            with torch.enable_grad():
                cost = restricted(left, *noise(at, coloured)[:2])
                (slope,) = torch.autograd.grad(cost, at)
            return float(cost.detach()), slope.numpy()

        many = [bound for bound in limits for _ in range(count)]
        ends = {"ftol": ENOUGH / left.rows.numel(), "gtol": ENOUGH}
        found = minimize(
            value, np.repeat(begin, count), jac=True, method="L-BFGS-B", bounds=many, options=ends
        )
        return float(found.fun), torch.as_tensor(found.x)

    size = ([0.0], [(-10.0, 10.0)]) if sizes else ([], [])
    white = searched(*size, False) if sizes else (float(restricted(left, stated, None)), stated)
    if not correlation:
        return noise(white[1], False) if sizes else FoundNoise(stated, None)
    limits = [*size[1], (-STEEP, STEEP), (np.log(SHORTEST * typical), np.log(LONGEST * longest))]
    begins = [[*size[0], 0.0, float(np.log(steps * typical))] for steps in MEMORIES]
    best = min((searched(begin, limits, True) for begin in begins), key=lambda one: one[0])
    if white[0] - best[0] < TELLING * count:
        return noise(white[1], False) if sizes else FoundNoise(stated, None)
    return noise(best[1], True)
