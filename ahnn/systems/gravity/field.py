"""Gravity field: coefficients, potential and attraction."""

from __future__ import annotations

import dataclasses
import hashlib
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import numpy as np
import torch
from torch import Tensor

from ahnn.errors import UserError
from ahnn.systems.gravity.harmonics import Coefficients, gradient, in_a_row, solid_harmonics

Tide = Literal["zero_tide", "tide_free", "mean_tide", "unknown"]
"""Tide systems: treatment of the permanent tide in C_20 (IERS Conventions 2010, section 1.1)."""
HIGHEST = 1900
"""Degree above which double precision loses harmonics near the poles (Holmes & Featherstone 2002)."""


@dataclass(frozen=True, eq=False)
class GravityField:
    """Static gravity field as a spherical harmonic series in body-fixed axes.

    Attributes:
        name: name of the model.
        mu: gravitational parameter in km^3/s^2.
        radius: reference radius in km.
        cosines, sines: fully normalised coefficients (N + 1, M + 1), row n and column m.
        tide: the tide system of C_20.
    """

    name: str
    mu: float
    radius: float
    cosines: Coefficients
    sines: Coefficients
    tide: Tide

    @classmethod
    def of_rows(
        cls, name: str, mu: float, radius: float, rows: Sequence[tuple[int, int, float, float]], tide: Tide
    ) -> GravityField:
        """Build the field from fully normalised rows n, m, C_nm, S_nm; others are 0, except C_00 = 1."""
        size = 1 + max(row[0] for row in rows)
        cosines, sines = np.zeros((2, size, size))
        cosines[0, 0] = 1.0
        for n, m, c, s in rows:
            cosines[n, m], sines[n, m] = c, s
        return cls(name, mu, radius, cosines, sines, tide)

    @property
    def degree(self) -> int:
        """Maximum degree N."""
        return len(self.cosines) - 1

    @property
    def order(self) -> int:
        """Maximum order M."""
        return self.cosines.shape[1] - 1

    def cut(self, degree: int, order: int) -> GravityField:
        """Truncate the field to a lower degree and order.

        Raises:
            UserError: the degree or order is not available, or the order exceeds the degree.
        """
        highest = min(self.degree, HIGHEST)
        for name, received, most in (("degree", degree, highest), ("order", order, min(degree, self.order))):
            if not 0 <= received <= most:
                message = f"{name}: expected 0 to {most} for {self.name}; received {received}"
                raise UserError(message)
        parts = (part[: degree + 1, : order + 1].copy() for part in (self.cosines, self.sines))
        return dataclasses.replace(self, **dict(zip(("cosines", "sines"), parts, strict=True)))

    @cached_property
    def checksum(self) -> str:
        """SHA-256 of all data that determine the attraction."""
        digest = hashlib.sha256(repr((self.mu, self.radius, self.cosines.shape)).encode())
        digest.update(self.cosines.tobytes() + self.sines.tobytes())
        return digest.hexdigest()

    def potential(self, q: Tensor) -> Tensor:
        """Return the potential energy of 1 kg in km^2/s^2, shape (...), at the positions q, (..., 3)."""
        harmonics = solid_harmonics(q, self.radius, self.degree, self.order)
        return -self.mu / self.radius * (torch.view_as_real(harmonics).flatten(-2) @ self._series.to(q))

    def attraction(self, q: Tensor) -> Tensor:
        """Return the acceleration in km/s^2, shape (..., 3), at the positions q, shape (..., 3), in km."""
        highest = self.degree + 1
        harmonics = solid_harmonics(q, self.radius, highest, min(self.order + 1, highest))
        return self.mu / self.radius**2 * (torch.view_as_real(harmonics).flatten(-2) @ self._gradient.to(q))

    @cached_property
    def _series(self) -> Tensor:
        """Coefficients of the potential, (2 K,)."""
        return in_a_row(self.cosines, self.sines)

    @cached_property
    def _gradient(self) -> Tensor:
        """Coefficients of its three derivatives, (2 K, 3)."""
        parts = gradient(self.cosines, self.sines)
        return torch.stack([in_a_row(*part) for part in parts], dim=-1)
