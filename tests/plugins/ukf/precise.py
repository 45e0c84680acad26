"""Linear measurements, and the Kalman filter in 80 digits that a filter in float64 is held against."""

from __future__ import annotations

import mpmath
from torch import Tensor


class LinearMeasurement:
    """y = H x."""

    def __init__(self, h: Tensor) -> None:
        self.h = h
        self.names = tuple(f"y{i}" for i in range(len(h)))
        self.units = ("1",) * len(h)

    def __call__(self, x: Tensor, t: float) -> Tensor:
        return x @ self.h.mT

    def residual(self, y: Tensor, y_pred: Tensor) -> Tensor:
        return y - y_pred


def kalman(mean, covariance, steps, h, r, rows):
    """Return mean and standard deviations, as mpmath numbers, after rows of linear measurements.

    Args:
        mean: (D,) of the start.
        covariance: (D, D) of the start.
        steps: (D, D) transition before each row.
        h: (M, D), the measurement is h x.
        r: (M, M).
        rows: (K, M).
    """
    with mpmath.workdps(80):
        a, h, r = (mpmath.matrix(part.tolist()) for part in (steps, h, r))
        x, p = mpmath.matrix(mean.tolist()), mpmath.matrix(covariance.tolist())
        for row in rows.tolist():
            x, p = a * x, a * p * a.T
            s = h * p * h.T + r
            gain = p * h.T * mpmath.inverse(s)
            x = x + gain * (mpmath.matrix(row) - h * x)
            rest = mpmath.eye(len(x)) - gain * h
            p = rest * p * rest.T + gain * r * gain.T
        return list(x), [mpmath.sqrt(p[i, i]) for i in range(len(x))]
