"""What a sensor saw of trajectories: values at times, never to be taken for states."""

from __future__ import annotations

from typing import NamedTuple

from torch import Tensor


class Observations(NamedTuple):
    """Measurements of B trajectories on a common number of rows.

    Attributes:
        values: (B, T, M) float64; NaN where nothing was measured, single components too.
        times: (B, T) float64, increasing in each row; NaN beyond the end of a shorter one.
    """

    values: Tensor
    times: Tensor

    def part(self, rows: slice) -> Observations:
        """Return those of some of the trajectories."""
        return Observations(self.values[rows], self.times[rows])
