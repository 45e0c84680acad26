"""Axes of the Earth that precess and nutate, and its pole, at regular times with linear interpolation."""

from __future__ import annotations

import math

import torch
from torch import Tensor


class DailyAxes:
    """Slow part of the rotation from inertial axes to the Earth's axes.

    The Earth's axes at t follow from it by a rotation about z at the constant rate of the station, and by
    polar motion. Within a day it turns by about 1e-6 rad, so that interpolated matrices are orthogonal within
    1e-12.

    Args:
        matrices: (N, 3, 3) matrices at the times `first` + k `spacing`, float64.
        first: time of the first matrix in s.
        spacing: time between matrices in s.
        pole: (N, 2) coordinates x and y of the pole in rad; None for 0.
    """

    def __init__(
        self, matrices: Tensor, first: float = 0.0, spacing: float = 86400.0, pole: Tensor | None = None
    ) -> None:
        self.matrices, self.first, self.spacing, self.pole = matrices, first, spacing, pole
        self.last = len(matrices) - 1

    def at(self, t: float | Tensor, like: Tensor) -> Tensor:
        """Return the matrices (..., 3, 3) at times t (...), in the type of `like`; outside, the nearest."""
        return self._interpolated(self.matrices, t, like)

    def tilt(self, angle: Tensor, t: float | Tensor, like: Tensor) -> Tensor:
        """Return the rotation vector of polar motion, (..., 3), in axes that precede the Earth's by `angle`.

        The pole has the coordinates x and y in the Earth's axes (IERS Conventions 2010, eq. 5.3).
        """
        if self.pole is None:
            return like.new_zeros(3)
        x, y = self._interpolated(self.pole, t, like).unbind(-1)
        cosine, sine = angle.cos(), angle.sin()
        return torch.stack((x * sine - y * cosine, -y * sine - x * cosine, torch.zeros_like(x * sine)), -1)

    def _interpolated(self, values: Tensor, t: float | Tensor, like: Tensor) -> Tensor:
        """Return values (N, ...) at times."""
        if self.last == 0:
            return values[0].to(like)
        table = values.to(like.device)
        if not isinstance(t, Tensor):
            place = (t - self.first) / self.spacing
            place = min(max(place, 0.0), float(self.last))
            row = 0 if math.isnan(place) else min(int(place), self.last - 1)
            return (table[row] + (place - row) * (table[row + 1] - table[row])).to(like)
        places = ((t.to(table) - self.first) / self.spacing).clamp(0.0, float(self.last))
        rows = places.detach().nan_to_num().floor().clamp(max=self.last - 1).long()
        shape = rows.shape + table.shape[1:]
        near, far = (table.index_select(0, (rows + k).flatten()).reshape(shape) for k in range(2))
        part = (places - rows).reshape(*rows.shape, *[1] * (table.ndim - 1))
        return (near + part * (far - near)).to(like)
