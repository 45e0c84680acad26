"""Observations of trajectories: measured values at times, distinct from states."""

from __future__ import annotations

from typing import NamedTuple

from torch import Tensor


class Observations(NamedTuple):
    """Measurements of B trajectories, padded to a common number of rows.

    Attributes:
        values: (B, T, M) float64; NaN where missing; single components may be missing.
        times: (B, T) float64, increasing in each row; NaN beyond the end of a shorter one.
    """

    values: Tensor
    times: Tensor

    def part(self, rows: slice) -> Observations:
        """Return the observations of selected trajectories."""
        return Observations(self.values[rows], self.times[rows])
