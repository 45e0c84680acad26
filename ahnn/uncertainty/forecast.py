"""How far off forecasts are that begin with a fit: through what was measured, and through the parameters.

A start is fitted to the measurements of a while, the dynamics held fixed. With A the derivative of these, in
standard deviations of their noise, with respect to the start, and V that with respect to parameters that are
off by eta ~ N(0, I), the start is off by A^+ (noise - V eta): parameters move a forecast by themselves, and
through the start that they let fit best (consider covariance; Tapley, Schutz & Born 2004, chapter 6).
"""

from __future__ import annotations

import torch
from torch import Tensor

from ahnn.dynamics import Dynamics
from ahnn.shooting.paths import Steps, transitions
from ahnn.shooting.starts import Linearised
from ahnn.uncertainty.bands import rollout_sensitivities


@torch.no_grad()
def forecast_variances(
    dynamics: Dynamics, starts: Tensor, steps: Steps, here: Linearised, fitted: Tensor, factor: Tensor
) -> tuple[Tensor, Tensor]:
    """Return variances of the states, (B, K + 1, D), and of what is measured of them, (B, K + 1, M).

    The latter are in squared standard deviations of the noise, without the noise itself, and 0 where nothing
    was measured.

    Args:
        dynamics: with a field, float64.
        starts: (B, D) that fit best.
        steps: between the times of the measurements.
        here: the paths from there, and the derivatives of measurements along them.
        fitted: (B, K + 1) bool, the times whose measurements the starts were fitted to.
        factor: L, shape (P, R); L L^T is the covariance of the parameters.
    """
    later = ~fitted[..., None, None]
    orthogonal, root = torch.linalg.qr(here.of_start.masked_fill(later, 0.0).flatten(1, 2))
    pulls = here.of_state.masked_fill(later, 0.0).mT @ orthogonal.unflatten(1, here.of_state.shape[1:3])
    carried = transitions(here.jacobians.to(starts))[:, steps.ends]
    noise = torch.linalg.solve_triangular(root.unsqueeze(1), carried, upper=True, left=False)
    covariances, first = [], 0
    for part in rollout_sensitivities(dynamics, starts, steps.lengths, factor):
        rows, first = slice(first, first + len(part)), first + len(part)
        moved = part[:, steps.ends].to(starts)
        # Where nothing was fitted paths may be lost: zeros in their place, since 0 times NaN is none.
        taken = torch.einsum("bkde,bkdr->ber", pulls[rows], moved.masked_fill(later[rows], 0.0))
        own = noise[rows]
        total = moved - own @ taken.unsqueeze(1)
        covariances.append(own @ own.mT + total @ total.mT)
    covariance = torch.cat(covariances)
    of_values = ((here.of_state @ covariance) * here.of_state).sum(-1)
    return covariance.diagonal(dim1=-2, dim2=-1), of_values
