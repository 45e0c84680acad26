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
TRIALS, FACTOR = 40, 4.0
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
