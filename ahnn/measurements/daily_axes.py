"""Axes of the Earth that precess and nutate, as matrices at regular times with linear interpolation."""

from __future__ import annotations

import math

from torch import Tensor


class DailyAxes:
    """Slow part of the rotation from inertial axes to the Earth's axes.

    The Earth's axes at t follow from it by a rotation about z at the constant rate of the station. Within a
    day it turns by about 1e-6 rad, so that interpolated matrices are orthogonal within 1e-12.

    Args:
        matrices: (N, 3, 3) matrices at the times `first` + k `spacing`, float64.
        first: time of the first matrix in s.
        spacing: time between matrices in s.
    """

    def __init__(self, matrices: Tensor, first: float = 0.0, spacing: float = 86400.0) -> None:
        self.matrices, self.first, self.spacing = matrices, first, spacing
        self.last = len(matrices) - 1

    def at(self, t: float | Tensor, like: Tensor) -> Tensor:
        """Return the matrices (..., 3, 3) at times t (...), in the type of `like`; outside, the nearest."""
        if self.last == 0:
            return self.matrices[0].to(like)
        table = self.matrices.to(like.device)
        if not isinstance(t, Tensor):
            place = (t - self.first) / self.spacing
            place = min(max(place, 0.0), float(self.last))
            row = 0 if math.isnan(place) else min(int(place), self.last - 1)
            return (table[row] + (place - row) * (table[row + 1] - table[row])).to(like)
        places = ((t.to(table) - self.first) / self.spacing).clamp(0.0, float(self.last))
        rows = places.detach().nan_to_num().floor().clamp(max=self.last - 1).long()
        near, far = (table.index_select(0, (rows + k).flatten()).reshape(*rows.shape, 3, 3) for k in range(2))
        return (near + (places - rows)[..., None, None] * (far - near)).to(like)
