"""Interpolation of a table in time by polynomials of a given order."""

from __future__ import annotations

import math

import torch
from torch import Tensor

TOLERANCE = 1e-9
"""Relative tolerance for equal times, which are sums of steps with rounding errors."""


def lagrange(times: Tensor, values: Tensor, t: float, order: int) -> Tensor:
    """Interpolate a table at time t by the polynomial through the nearest order + 1 rows.

    At a row time the result is exactly that row. Between rows with spacing h the error is at most

        max |f^(n+1)| |(t - t_0) ... (t - t_n)| / (n+1)!,    n = order,

    (Stoer & Bulirsch 2002, theorem 2.1.4.1). It is smallest in the middle of the table. For a circular orbit
    of radius r and angular rate w, |f^(n+1)| = r w^(n+1). A GPS orbit (26,560 km, 12 h) tabulated every 15
    min is interpolated with order 8 to 0.2 mm in the middle and to 5 mm next to the ends of the table.

    Args:
        times: (T,) increasing, T > order.
        values: (T, ...).
        t: time, from the first to the last of `times`.
        order: degree of the polynomial, at least 1.

    Raises:
        ValueError: t is outside the table.
    """
    distance = (times - t).abs()
    nearest = int(distance.argmin())
    if math.isfinite(t) and float(distance[nearest]) <= TOLERANCE * max(1.0, abs(t)):
        return values[nearest]
    if not float(times[0]) < t < float(times[-1]):
        message = f"expected a time within the table, {times[0]:g} to {times[-1]:g}; received {t:g}"
        raise ValueError(message)
    # The window is centred on the interval (even number of rows) or on the nearest row (odd number).
    after = int(torch.searchsorted(times, t))
    first = after - (order + 1) // 2 if order % 2 else nearest - order // 2
    first = min(max(first, 0), len(times) - order - 1)
    nodes = times[first : first + order + 1]
    factors = (t - nodes) / (nodes[:, None] - nodes)
    weights = factors.fill_diagonal_(1.0).prod(1)
    return torch.tensordot(weights, values[first : first + order + 1], dims=1)
