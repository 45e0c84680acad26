"""Solid Earth tides raised by Sun and Moon, degree 2 (IERS Conventions 2010, 6.2.1)."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from ahnn.tracking.accelerations.contract import Acceleration, Array, inner, known, outer

LOVE = 0.30190
"""Love number k_20 of the elastic Earth (IERS Conventions 2010, table 6.3)."""
RADIUS = 6378.1366
"""Reference radius of the Love number, km."""


class EarthTide:
    """Attraction by the tide that a body raises; the permanent part is included: use a tide-free field.

    The potential is k2 mu / d^3 R^5 / r^3 (3 cos^2 z - 1) / 2, where z is the angle from satellite to body.

    Args:
        mu: gravitational parameter of the body, km^3/s^2.
        position: t -> (3,) geocentric position, km.
    """

    parameters: tuple[str, ...] = ()

    def __init__(self, mu: float, position: Callable[[float], Array]) -> None:
        self.mu, self.position = mu, position

    def __call__(self, t: float, r: Array, v: Array, p: Array) -> Acceleration:
        """Return the attraction at a state; see `AccelerationTerm`."""
        body = self.position(t)
        away = np.linalg.norm(body)
        e, square = body / away, inner(r, r)
        s = inner(r, e)
        factor = 0.5 * LOVE * self.mu * RADIUS**5 / away**3
        # Potential factor (3 s^2 / r^5 - 1 / r^3), its gradient and Hessian.
        r5 = square**2.5
        c, b = (3.0 - 15.0 * s**2 / square) / r5, 6.0 * s / r5
        value = factor * (c * r + b * e)
        c_slope = -5.0 * c * r / square + (-30.0 * s / square * e + 30.0 * s**2 / square**2 * r) / r5
        b_slope = 6.0 / r5 * (e - 5.0 * s / square * r)
        tensor = factor * (c[..., None] * np.eye(3) + outer(r, c_slope) + outer(e, b_slope))
        return known(value, tensor)
