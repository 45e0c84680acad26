"""Uncertainty of forecasts from fitted initial states, due to measurement noise and parameters.

An initial state is fitted to measurements with fixed dynamics. Let A be the derivative of the normalised
measurements with respect to the initial state, and V that with respect to parameters with errors eta ~ N(0,
I). The initial error is A^+ (noise - V eta): parameters affect a forecast directly and through the fitted
initial state (consider covariance; Tapley, Schutz & Born 2004, chapter 6). The two effects nearly cancel, so
both are computed in float64, with steps short enough for the quadrature.
"""

from __future__ import annotations

from collections.abc import Iterator

import torch
from torch import Tensor

from ahnn.dynamics import Dynamics
from ahnn.measurements.coloured_noise import Whitening
from ahnn.shooting.initial_states import Linearised
from ahnn.shooting.path_sensitivities import Steps, transitions
from ahnn.uncertainty.bands import path_sensitivities


@torch.no_grad()
def forecast_columns(
    dynamics: Dynamics,
    states: Tensor,
    steps: Steps,
    here: Linearised,
    fitted: Tensor,
    factor: Tensor,
    whitening: Whitening | None = None,
) -> Iterator[tuple[Tensor, Tensor]]:
    """Yield the effects C of one standard deviation of each cause on forecasts, in batches.

    Causes are the noise of the fitted measurements, with columns (b, K + 1, D, D) at the times of
    measurements, and the parameters, (b, K + 1, D, R). The covariance of a state is the sum of C C^T of both.

    Args:
        dynamics: float64 dynamics with a field.
        states: (B, N + 1, D) paths from the fitted initial states.
        steps: steps between the times, quartered if required by `ahnn.shooting.quadrature`.
        here: derivatives of steps and measurements along the paths.
        fitted: (B, K + 1) bool, times of the fitted measurements.
        factor: L, shape (P, R); L L^T is the covariance of the parameters.
        whitening: whitening of the residuals, if their noise is coloured.
    """
    later, jacobians = ~fitted[..., None, None], here.jacobians.to(states)
    orthogonal, root = torch.linalg.qr(here.of_start.masked_fill(later, 0.0).flatten(1, 2))
    rows = orthogonal.unflatten(1, here.of_state.shape[1:3])
    rows = rows if whitening is None else whitening.transposed(rows)
    pulls = here.of_state.masked_fill(later, 0.0).mT @ rows
    carried = transitions(jacobians)[:, steps.ends]
    noise = torch.linalg.solve_triangular(root.unsqueeze(1), carried, upper=True, left=False)
    first = 0
    for moved in path_sensitivities(dynamics, states, jacobians, steps, factor):
        rows, first = slice(first, first + len(moved)), first + len(moved)
        # Paths that diverge after the fitted part are replaced by zeros, since 0 times NaN is NaN.
        taken = torch.einsum("bkde,bkdr->ber", pulls[rows], moved.masked_fill(later[rows], 0.0))
        yield noise[rows], moved - noise[rows] @ taken.unsqueeze(1)
