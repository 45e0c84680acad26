"""Solid spherical harmonics, fully normalised, in Cartesian coordinates without singularity at the poles.

    V_nm + i W_nm = (R / r)^(n + 1) P_nm(sin latitude) exp(i m longitude),    P_nm normalised to 4 pi

Cunningham's recursion (Celest. Mech. 2, 207-216, 1970; Montenbruck & Gill, Satellite Orbits, section 3.2.4)
multiplies by x + i y from one order to the next and by z from one degree to the next, here with normalised
factors, so that values stay near 1 up to degree 1900 or so. The derivative of a harmonic is a harmonic
of the next degree: a gradient is a series like the potential, with other coefficients.
"""

from __future__ import annotations

from functools import cache
from typing import NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.nn.functional import pad

Coefficients = NDArray[np.float64]
"""C_nm or S_nm for degrees to N and orders to M <= N, shape (N + 1, M + 1); those with m > n are unused."""


class Factors(NamedTuple):
    """Factors of the recursion up to a degree.

    Attributes:
        along: (columns,) factors of z times the harmonics of the previous degree.
        before: (columns,) factors of R^2 / r^2 times those two degrees before.
        across: factors of x + i y times the last harmonic of the previous degree.
    """

    along: Tensor
    before: Tensor
    across: float


def solid_harmonics(q: Tensor, radius: float, degree: int, order: int) -> Tensor:
    """Return complex V_nm + i W_nm for all degrees up to `degree` and orders up to `order`, (..., K).

    Sorted by degree, then by order, as in `in_a_row`.

    Args:
        q: positions, (..., 3), from the centre.
        radius: reference radius R, in the same unit.
        degree: maximum degree.
        order: maximum order, at most the degree.
    """
    inverse = (q * q).sum(-1, keepdim=True).reciprocal()
    x, y, z = (radius * inverse * q).split(1, dim=-1)
    across, square = torch.complex(x, y), radius**2 * inverse
    first = square.sqrt()
    rows = [torch.complex(first, torch.zeros_like(first))]
    for n in range(1, degree + 1):
        factors, last = _factors(n, order), rows[-1]
        row = factors.along.to(q) * z * last
        if n > 1:
            older = pad(rows[-2], (0, row.shape[-1] - rows[-2].shape[-1]))
            row = row - factors.before.to(q) * square * older
        if n <= order:
            row = torch.cat((row, factors.across * across * last[..., -1:]), dim=-1)
        rows.append(row)
    return torch.cat(rows, dim=-1)


@cache
def _factors(n: int, order: int) -> Factors:
    m = torch.arange(min(n - 1, order) + 1, dtype=torch.float64)
    both = (n - m) * (n + m)
    along = ((2 * n - 1) * (2 * n + 1) / both).sqrt()
    before = ((2 * n + 1) * (n + m - 1) * (n - m - 1) / (both * abs(2 * n - 3))).clamp(min=0.0).sqrt()
    return Factors(along, before, 3**0.5 if n == 1 else ((2 * n + 1) / (2 * n)) ** 0.5)


def in_a_row(cosines: Coefficients, sines: Coefficients) -> Tensor:
    """Return coefficients in the order of `solid_harmonics`, C and S alternating, shape (2 K,)."""
    pairs = np.stack((cosines, sines), axis=-1)
    return torch.from_numpy(np.concatenate([row[: n + 1].ravel() for n, row in enumerate(pairs)]))


def gradient(cosines: Coefficients, sines: Coefficients) -> list[tuple[Coefficients, Coefficients]]:
    """Return the coefficients of R d/dx, R d/dy, R d/dz of a series, each one degree and order higher.

    With c = C - i S and Z = V + i W the series is the sum of Re(c Z), and without normalisation
    R (d/dx + i d/dy) Z_nm = -Z_(n+1)(m+1), R (d/dx - i d/dy) Z_nm = (n - m + 1)(n - m + 2) Z_(n+1)(m-1),
    R d/dz Z_nm = -(n - m + 1) Z_(n+1)m (Cunningham 1970).
    """
    degrees, orders = cosines.shape
    n, m = np.indices(cosines.shape, dtype=np.float64)
    below = m <= n
    c = np.where(below, cosines - 1j * np.where(m == 0, 0.0, sines), 0)  # W_n0 is 0 for any S_n0
    scale = np.where(below, (2 * n + 1) / (2 * n + 3), 0.0)
    falling = np.where(below, n - m + 1, 0.0)
    up, down, along = np.zeros((3, degrees + 1, orders + 1), dtype=np.complex128)
    # Half of each neighbour, but all of it for order 0, whose two neighbours are complex conjugates.
    up[1:, 1:] = -c * np.sqrt(scale * (n + m + 1) * (n + m + 2)) * np.where(m == 0, 0.5**0.5, 0.5)
    lower = 0.5 * c.conj() * np.sqrt(scale * falling * (falling + 1)) * np.where(m == 1, 2**0.5, 1)
    down[1:, : orders - 1] = lower[:, 1:]
    along[1:, :orders] = -c * np.sqrt(scale * (n + m + 1) * falling)
    # up Z + down conj(Z), with its real part along x and its imaginary part along y.
    x = (up + down).real, (down - up).imag
    y = (up + down).imag, (up - down).real
    return [x, y, (along.real, -along.imag)]
