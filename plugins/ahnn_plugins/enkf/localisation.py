"""Localisation: suppression of spurious ensemble correlations between distant coordinates."""

from __future__ import annotations

from dataclasses import dataclass
from typing import final

import torch
from torch import Tensor

from ahnn.arguments import Count, Positive, checked
from ahnn.errors import UserError


@final
@checked
@dataclass(frozen=True)
class Localisation:
    """Taper of covariances by the distance between coordinates along a chain.

    Component k of a state belongs to coordinate k mod `coordinates`: q_i, p_i and the force error of
    coordinate i share a position.

    Attributes:
        radius: distance, in coordinates, beyond which correlations are zero.
        coordinates: number n of coordinates of the chain.
        ring: whether the last coordinate is adjacent to the first.
    """

    radius: Positive
    coordinates: Count
    ring: bool = False

    def __post_init__(self) -> None:
        """Raise UserError for a taper that wraps around a ring, which may not be positive definite."""
        if self.ring and 2 * self.radius > self.coordinates:
            most = f"{self.coordinates / 2:g}, half the ring"
            message = f"localisation.radius: expected at most {most}; received {self.radius:g}"
            raise UserError(message)

    def taper(self, size: int) -> Tensor:
        """Return the factors (D, D) on the covariances of states of D components.

        Raises:
            UserError: components outside the chain, such as biases or learned parameters.
        """
        if size % self.coordinates:
            message = (
                f"localisation: expected states with a multiple of {self.coordinates} components, the "
                f"number of coordinates in the chain; received {size}, some of them not on the chain"
            )
            raise UserError(message)
        place = torch.arange(size) % self.coordinates
        apart = (place - place.unsqueeze(-1)).abs()
        if self.ring:
            apart = torch.minimum(apart, self.coordinates - apart)
        return gaspari_cohn(apart.double() / (0.5 * self.radius))


def gaspari_cohn(z: Tensor) -> Tensor:
    """Return the correlation at distances z >= 0 in half radii: 1 at 0, 0 beyond 2, twice differentiable.

    Gaspari & Cohn 1999, eq. 4.10: piecewise rational, positive definite in up to three dimensions.
    """
    near = (((-0.25 * z + 0.5) * z + 0.625) * z - 5.0 / 3.0) * z**2 + 1.0
    far = (
        ((((z / 12.0 - 0.5) * z + 0.625) * z + 5.0 / 3.0) * z - 5.0) * z
        + 4.0
        - 2.0 / (3.0 * z.clamp(min=1.0))
    )
    return torch.where(z <= 1.0, near, torch.where(z < 2.0, far, 0.0)).clamp(min=0.0)
