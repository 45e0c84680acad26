"""Unscented proposal of particles: an unscented update of each particle, with importance weights.

The prediction is represented by a mixture of kernels about its particles, as used after resampling. Each
kernel N(c_i, C Cᵀ) is updated by the measurement with 2 D cubature points, and a particle is drawn from the
result q_i (van der Merwe, Doucet, de Freitas & Wan 2000 use the process noise of a step instead of the
kernel, which fails without process noise). Its weight,

    w_i p(y | x) N(x; c_i, C Cᵀ) / q_i(x),

makes the draws exact for the posterior of the mixture, however inaccurate the linearisation is. For linear
measurements it is w_i N(y; H c_i, H C Cᵀ Hᵀ + R): a sensor more precise than the kernel width leaves as many
effective particles as one of that width.
"""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor
from torch.nn.functional import pad

from ahnn.estimation.belief import Belief
from ahnn.estimation.conditioning import conditioned
from ahnn.estimation.kernel import measured
from ahnn.estimation.linalg import tria
from ahnn.estimation.sample_filter import image_deviations
from ahnn_plugins.particle.weighing import WeighingRow


class Proposed(NamedTuple):
    """Particles (B, N, D), and log weights (B, N), whose exponentials sum to the density of the row."""

    points: Tensor
    log_weights: Tensor


def unscented_proposal(
    chol: Tensor, centres: Tensor, log_weights: Tensor, row: WeighingRow, z: Tensor, time: float
) -> Proposed:
    """Draw particles from the updated kernels.

    Args:
        chol: (B, D, D) factor C, common to all kernels of a member.
        centres: (B, N, D) kernel centres.
        log_weights: (B, N) normalised log weights of the kernels.
        row: measurement row.
        z: (B, N, D) standard normal numbers.
        time: time of the row.
    """
    batch, count, size = centres.shape
    spread = size**0.5 * chol.mT
    points = centres.unsqueeze(2) + torch.cat((spread, -spread), dim=1).unsqueeze(1)
    images = measured(row.sensor.measurement, points.flatten(1, 2), time)
    images = images.unflatten(1, (count, 2 * size)).flatten(0, 1)
    y = row.y.repeat_interleave(count, 0)
    deviations, innovation = image_deviations(images, 1.0 / (2 * size), y, row.sensor)
    own = (points - centres.unsqueeze(2)).flatten(0, 1)
    rows = torch.cat((deviations, own), -1) / (2 * size) ** 0.5
    noise = pad(row.chol_r.mT, (0, size)).repeat_interleave(count, 0)
    prior = Belief(centres.flatten(0, 1), chol.repeat_interleave(count, 0))
    after = conditioned(prior, tria(torch.cat((rows, noise), dim=1)), innovation, y).belief
    moved = (after.chol @ z.flatten(0, 1).unsqueeze(-1)).squeeze(-1)
    drawn = (after.mean + moved).unflatten(0, (batch, count))
    white = torch.linalg.solve_triangular(chol, (drawn - centres).mT, upper=False)
    ratio = 0.5 * (z.square().sum(-1) - white.square().sum(1)) + (
        after.chol.diagonal(dim1=-2, dim2=-1).log().sum(-1).unflatten(0, (batch, count))
        - chol.diagonal(dim1=-2, dim2=-1).log().sum(-1, keepdim=True)
    )
    finite = drawn.isfinite().all(-1) & ratio.isfinite()
    drawn = torch.where(finite.unsqueeze(-1), drawn, centres)
    densities = row.log_density(measured(row.sensor.measurement, drawn, time))
    return Proposed(drawn, torch.where(finite, log_weights + densities + ratio, -torch.inf))
