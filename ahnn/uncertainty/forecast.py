"""How far off forecasts are that begin with a fit: through what was measured, and through the parameters.

A start is fitted to the measurements of a while, the dynamics held fixed. With A the derivative of these, in
standard deviations of their noise, with respect to the start, and V that with respect to parameters that are
off by eta ~ N(0, I), the start is off by A^+ (noise - V eta): parameters move a forecast by themselves, and
through the start that they let fit best (consider covariance; Tapley, Schutz & Born 2004, chapter 6). The two
all but cancel, so that both are in float64, along steps short enough for the rule of their integrals.
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
    """Yield how far one standard deviation of each cause moves forecasts, for some of them at a time.

    Causes are the noise of what was fitted, columns (b, K + 1, D, D) at the times of measurements, and the
    parameters, (b, K + 1, D, R). The covariance of a state is the sum of C C^T of both.

    Args:
        dynamics: with a field, float64.
        states: (B, N + 1, D), the paths from the starts that fit best.
        steps: between the times, quartered where `ahnn.shooting.quadrature` asks for it.
        here: derivatives of steps and measurements along the paths.
        fitted: (B, K + 1) bool, the times whose measurements the starts were fitted to.
        factor: L, shape (P, R); L L^T is the covariance of the parameters.
        whitening: of the residuals, where their noise is coloured.
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
        # Where nothing was fitted paths may be lost: zeros in their place, since 0 times NaN is none.
        taken = torch.einsum("bkde,bkdr->ber", pulls[rows], moved.masked_fill(later[rows], 0.0))
        yield noise[rows], moved - noise[rows] @ taken.unsqueeze(1)
