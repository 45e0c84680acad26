"""How far off forecasts are that begin with a fit: through what was measured, and through the parameters.

A start is fitted to the measurements of a while, the dynamics held fixed. With A the derivative of these, in
standard deviations of their noise, with respect to the start, and V that with respect to parameters that are
off by eta ~ N(0, I), the start is off by A^+ (noise - V eta): parameters move a forecast by themselves, and
through the start that they let fit best (consider covariance; Tapley, Schutz & Born 2004, chapter 6). The two
all but cancel, so that both are in float64, along steps short enough for the rule of their integrals.
"""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from ahnn.dynamics import Dynamics
from ahnn.shooting.paths import Steps, transitions
from ahnn.shooting.starts import Linearised
from ahnn.uncertainty.bands import path_sensitivities


class ForecastVariances(NamedTuple):
    """Variances of a forecast.

    Attributes:
        states: (B, K + 1, D).
        parameters: what the parameters have of that, by themselves and through the start.
        values: of what is measured, (B, K + 1, M), in squared standard deviations of the noise and without
            the noise itself; 0 where nothing was measured.
    """

    states: Tensor
    parameters: Tensor
    values: Tensor


@torch.no_grad()
def forecast_variances(
    dynamics: Dynamics, states: Tensor, steps: Steps, here: Linearised, fitted: Tensor, factor: Tensor
) -> ForecastVariances:
    """Return the variances of forecasts at the times of measurements.

    Args:
        dynamics: with a field, float64.
        states: (B, N + 1, D), the paths from the starts that fit best.
        steps: between the times, quartered where `ahnn.shooting.quadrature` asks for it.
        here: derivatives of steps and measurements along the paths.
        fitted: (B, K + 1) bool, the times whose measurements the starts were fitted to.
        factor: L, shape (P, R); L L^T is the covariance of the parameters.
    """
    later, jacobians = ~fitted[..., None, None], here.jacobians.to(states)
    orthogonal, root = torch.linalg.qr(here.of_start.masked_fill(later, 0.0).flatten(1, 2))
    pulls = here.of_state.masked_fill(later, 0.0).mT @ orthogonal.unflatten(1, here.of_state.shape[1:3])
    carried = transitions(jacobians)[:, steps.ends]
    noise = torch.linalg.solve_triangular(root.unsqueeze(1), carried, upper=True, left=False)
    covariances, shares, first = [], [], 0
    for moved in path_sensitivities(dynamics, states, jacobians, steps, factor):
        rows, first = slice(first, first + len(moved)), first + len(moved)
        # Where nothing was fitted paths may be lost: zeros in their place, since 0 times NaN is none.
        taken = torch.einsum("bkde,bkdr->ber", pulls[rows], moved.masked_fill(later[rows], 0.0))
        own = noise[rows]
        total = moved - own @ taken.unsqueeze(1)
        covariances.append(own @ own.mT + total @ total.mT)
        shares.append(total.square().sum(-1))
    covariance = torch.cat(covariances)
    values = ((here.of_state @ covariance) * here.of_state).sum(-1)
    return ForecastVariances(covariance.diagonal(dim1=-2, dim2=-1), torch.cat(shares), values)
