"""Least-squares fit of starts and constants to noisy states, from predictions only.

If states are noisy, a prediction begins at the initial state that fits them best. The same fit with the true
equations gives the floor of a task.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import torch
from torch import Tensor

from ahnn.tasks.definition import Predict

STEP = 1e-5
"""Half-width of central differences, relative to the size of a component."""
TRIALS, FACTOR, GAUSS_NEWTON = 40, 4.0, 6
SETTLED, ROUGHLY = 1e-7, 1e-2
"""Minimum relative decrease of the sum of squares for another step, in the last fit and in earlier ones."""


def fitted_start(predict: Predict, observed: Tensor, dt: float, horizons: Sequence[int]) -> Tensor:
    """Fit the start (D,) whose prediction is closest to noisy states (T, D).

    Chaotic motion leads to many optima, so the first samples are fitted before further ones.

    Args:
        predict: model.
        observed: noisy states every dt, in units of equal noise.
        dt: time between samples.
        horizons: numbers of samples used in each fit; the last is T.
    """
    start = observed[0]
    for samples in horizons:

        def residuals(starts: Tensor, samples: int = samples) -> Tensor:
            return (predict(starts, samples - 1, dt) - observed[:samples]).flatten(1)

        settled = SETTLED if samples == horizons[-1] else ROUGHLY
        start = least_squares(residuals, start, STEP * observed.std(0), settled)
    return start


def least_squares(
    residuals: Callable[[Tensor], Tensor], start: Tensor, step: Tensor, settled: float = SETTLED
) -> Tensor:
    """Solve a least-squares problem in P unknowns by the Levenberg-Marquardt method.

    Args:
        residuals: unknowns (B, P) -> residuals (B, R).
        start: initial unknowns, (P,).
        step: half-widths of central differences, (P,).
        settled: minimum relative decrease of the sum of squares for another step.
    """
    here, damping = start, 1e-3
    offsets = torch.diag(step)
    known = residuals(here[None])[0]
    for _ in range(TRIALS):
        moved = residuals(torch.cat((here + offsets, here - offsets)))
        ahead, behind = moved.chunk(2)
        jacobian = ((ahead - behind) / (2 * step[:, None])).T
        normal, pull = jacobian.T @ jacobian, jacobian.T @ known
        for _ in range(TRIALS):
            ridge = damping * torch.diag(normal.diagonal())
            there = here - torch.linalg.solve(normal + ridge, pull)
            tried = residuals(there[None])[0]
            if tried.square().sum() < known.square().sum():
                break
            damping *= FACTOR
        else:
            return here
        gain = 1 - float(tried.square().sum() / known.square().sum())
        here, known, damping = there, tried, damping / FACTOR
        if gain < settled:
            break
    return here


def fitted_constants(
    predict_of: Callable[[Tensor], Predict], observed: Tensor, dt: float, begin: Tensor
) -> Tensor:
    """Fit the constants (P,) of a known form to many noisy trajectories (B, T, D).

    Gauss-Newton steps begin at constants near the optimum. The starts of trajectories are eliminated by
    projection of the rows onto the orthogonal complement of the derivatives by the starts (Golub & Pereyra
    1973, SIAM J. Numer. Anal. 10, 413).

    Args:
        predict_of: constants (P,) -> model.
        observed: noisy states every dt, in units of equal noise.
        dt: time between samples.
        begin: initial constants, (P,).
    """
    samples = observed.shape[1]
    starts, constants = observed[:, 0], begin
    near = STEP * observed.flatten(0, 1).std(0)
    for _ in range(GAUSS_NEWTON):
        predict = predict_of(constants)

        def off(x: Tensor, predict: Predict = predict) -> Tensor:
            return (predict(x, samples - 1, dt) - observed).flatten(1)

        here = off(starts)
        offsets = torch.diag(near)
        of_start = torch.stack(
            [(off(starts + by) - off(starts - by)) / (2 * near[k]) for k, by in enumerate(offsets)], dim=-1
        )
        of_constants = torch.stack(
            [
                (off(starts, predict_of(constants + by)) - off(starts, predict_of(constants - by)))
                / (2 * STEP)
                for by in STEP * torch.eye(len(begin)).to(begin)
            ],
            dim=-1,
        )
        rows = torch.cat((of_constants, here.unsqueeze(-1)), dim=-1)
        orthogonal = torch.linalg.qr(of_start).Q
        left = (rows - orthogonal @ (orthogonal.mT @ rows)).flatten(0, 1)
        step = torch.linalg.lstsq(left[:, :-1], left[:, -1:]).solution[:, 0]
        rest = here - of_constants @ step
        starts = starts - torch.linalg.lstsq(of_start, rest.unsqueeze(-1)).solution.squeeze(-1)
        constants = constants - step
    return constants
