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

    The latter are in squared standard deviations of the noise, and without the noise itself.

    Args:
        dynamics: with a field, float64.
        starts: (B, D) that fit best.
        steps: between the times of the measurements.
        here: the paths from there, and the derivatives of measurements along them.
        fitted: (B, K + 1) bool, the times whose measurements the starts were fitted to.
        factor: L, shape (P, R); L L^T is the covariance of the parameters.
    """
    of_start = here.of_start.masked_fill(~fitted[..., None, None], 0.0)
    orthogonal, root = torch.linalg.qr(of_start.flatten(1, 2))
    carried = transitions(here.jacobians.to(starts))[:, steps.ends]
    noise = torch.linalg.solve_triangular(root.unsqueeze(1), carried, upper=True, left=False)
    of_states, of_values, first = [], [], 0
    for part in rollout_sensitivities(dynamics, starts, steps.lengths, factor):
        rows, first = slice(first, first + len(part)), first + len(part)
        of_state, of_noise, moved = here.of_state[rows].to(part), noise[rows].to(part), part[:, steps.ends]
        seen = (of_state @ moved).flatten(1, 2)
        taken = (orthogonal[rows].mT.to(part) @ seen).unsqueeze(1)  # rows of what was not fitted are zero
        total = torch.cat((of_noise, moved - of_noise @ taken), dim=-1)
        of_states.append(total.square().sum(-1))
        of_values.append((of_state @ total).square().sum(-1))
    return torch.cat(of_states).to(starts), torch.cat(of_values).to(starts)
