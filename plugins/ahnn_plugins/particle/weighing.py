"""Weighting of particles by a measurement, in one step or in stages that keep enough effective particles."""

from __future__ import annotations

import math
from typing import NamedTuple

import torch
from torch import Tensor

from ahnn.estimation.estimator import SensorModel
from ahnn.estimation.linalg import tria
from ahnn.estimation.samples import effective_size, normalised
from ahnn.measurements import residual

HALVINGS, LEAST = 16, 1e-12
"""Number of bisection steps for an exponent, and smallest exponent relative to the largest."""
STAGE_SIZE, STAGE_BANDWIDTH = 0.8, 0.6
"""Effective fraction of particles left by a stage, and kernel bandwidth between stages.

Particles must be able to reach unoccupied regions. For 1,000 particles of N(0, 1) and a measurement 10
standard deviations away with unit noise, the final error of the mean is 0.6 standard deviations; with 0.5
and Silverman's bandwidth, it is 3.9.
"""
LOG_TWO_PI = math.log(2.0 * math.pi)


class WeighingRow(NamedTuple):
    """Measurement row with its noise.

    Attributes:
        y: (B, M), NaN where a component is missing.
        sensor: measurement model.
        chol_r: (B, M, M) factor of R, with ones for missing components.
    """

    y: Tensor
    sensor: SensorModel
    chol_r: Tensor

    @classmethod
    def of(cls, y: Tensor, sensor: SensorModel, noise: Tensor) -> WeighingRow:
        """Build a row from its noise (B, 2 M, M), see `present_noise`."""
        return cls(y, sensor, tria(noise))

    def log_density(self, images: Tensor) -> Tensor:
        """Return log densities (B, N) of y for images (B, N, M) of particles; -inf for non-finite images."""
        y, present = self.y.unsqueeze(1), ~torch.isnan(self.y)
        finite = images.isfinite().all(-1)
        # Missing components are filled in, since a residual may mix components.
        filled = torch.where(present.unsqueeze(1), y, images)
        off = torch.where(present.unsqueeze(1), residual(self.sensor.measurement, filled, images), 0.0)
        white = torch.linalg.solve_triangular(self.chol_r, off.mT, upper=False)
        scale = self.chol_r.diagonal(dim1=-2, dim2=-1).log().sum(-1)
        scale = scale + 0.5 * LOG_TWO_PI * present.sum(-1).to(scale)
        return torch.where(finite, -0.5 * white.square().sum(1) - scale.unsqueeze(-1), -torch.inf)


def exponent(log_weights: Tensor, densities: Tensor, most: Tensor, last: float, each: float) -> Tensor:
    """Return the largest exponents (B,) of the densities that keep enough effective particles.

    Uses bisection on the logarithm (Oudjane & Musso 2000, section 4, with the effective sample size instead
    of the ratio of weights).

    Args:
        log_weights: (B, N) normalised log weights.
        densities: (B, N) log densities.
        most: (B,) largest exponents, > 0.
        last: sufficient effective sample size at the largest exponent.
        each: sufficient effective sample size otherwise.
    """

    def size(power: Tensor, rows: Tensor) -> Tensor:
        return effective_size(normalised(log_weights[rows] + power.unsqueeze(-1) * densities[rows]))

    rows = torch.arange(len(most), device=most.device)
    rows = rows[~(size(most, rows) >= last)]
    if len(rows) == 0:
        return most
    high = most[rows].log()
    low = high + math.log(LEAST)
    for _ in range(HALVINGS):
        middle = 0.5 * (low + high)
        fits = size(middle.exp(), rows) >= each
        low, high = torch.where(fits, middle, low), torch.where(fits, high, middle)
    return most.index_put((rows,), low.exp())
