"""Closed-form propagation of the two-body problem by Kepler's equation."""

from __future__ import annotations

import torch
from torch import Tensor

ITERATIONS = 50
"""Maximum number of Newton steps; seven are enough for eccentricities up to 0.9."""


def kepler(x: Tensor, t: Tensor, mu: Tensor | float) -> Tensor:
    """Propagate states (..., 6) by elliptic two-body motion over the times t, shape (...).

    Uses Lagrange's f and g with the difference of eccentric anomalies E (Battin, An Introduction to the
    Mathematics and Methods of Astrodynamics, section 4.3): with sigma = q.v / sqrt(mu), n t = E - (1 - r/a)
    sin E + sigma / sqrt(a) (1 - cos E).

    Args:
        x: (..., 6) positions and velocities, bound to the centre.
        t: elapsed times, in the time unit of the velocities.
        mu: gravitational parameter, common or per state.
    """
    q, v = x.chunk(2, dim=-1)
    mu = torch.as_tensor(mu, dtype=x.dtype)
    r, sigma = q.norm(dim=-1), (q * v).sum(-1) / mu.sqrt()
    a = 1 / (2 / r - (v * v).sum(-1) / mu)
    n, c, s = (mu / a**3).sqrt(), 1 - r / a, sigma / a.sqrt()
    mean = n * t
    e = mean + s  # close enough, since Kepler's equation is monotonic
    for _ in range(ITERATIONS):
        move = (e - c * e.sin() + s * (1 - e.cos()) - mean) / (1 - c * e.cos() + s * e.sin())
        e = e - move
        if bool((move.abs() <= 1e-14 * (1 + e.abs())).all()):
            break
    cos, sin = e.cos(), e.sin()
    now = a * (1 - c * cos + s * sin)
    f, g = 1 - a / r * (1 - cos), t - (e - sin) / n
    df, dg = -(mu * a).sqrt() / (now * r) * sin, 1 - a / now * (1 - cos)
    f, g, df, dg = (part.unsqueeze(-1) for part in (f, g, df, dg))
    return torch.cat((f * q + g * v, df * q + dg * v), dim=-1)
