"""Starts and constants that meet noisy states best, by least squares on predictions alone.

What a prediction is compared with begins somewhere: where only noisy states are known, at the start that fits
these best. The same fit with the true equations is the floor of a task.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import torch
from torch import Tensor

from ahnn.tasks.definition import Predict

STEP = 1e-5
"""Half width of central differences, of the size of a component."""
TRIALS, FACTOR, GAUSS_NEWTON = 40, 4.0, 6
SETTLED, ROUGHLY = 1e-7, 1e-2
"""Fractions by which squares must fall for another step, of the last fit and of those before it."""


def fitted_start(predict: Predict, observed: Tensor, dt: float, horizons: Sequence[int]) -> Tensor:
    """Return the start (D,) whose prediction meets noisy states (T, D) best.

    Chaotic motion has many optima, so that it is fitted to the first samples, then to more.

    Args:
        predict: the model.
        observed: every dt, in units in which their noise is alike.
        dt: between samples.
        horizons: samples of each fit, the last one all that count.
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
    """Return the unknowns (P,) of least squares by Levenberg's and Marquardt's method.

    Args:
        residuals: unknowns (B, P) -> residuals (B, R).
        start: where to begin, (P,).
        step: half widths of central differences, (P,).
        settled: fraction by which squares must fall for another step.
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
    """Return the constants (P,) of a known form that meet many noisy trajectories (B, T, D) best.

    Each trajectory has a start of its own, which is eliminated: Gauss-Newton steps from constants near the
    optimum, whose rows are projected on what no start can explain (Golub & Pereyra 1973, SIAM J. Numer. Anal.
    10, 413).

    Args:
        predict_of: constants (P,) -> a model.
        observed: every dt, in units in which their noise is alike.
        dt: between samples.
        begin: constants to begin at, (P,).
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
