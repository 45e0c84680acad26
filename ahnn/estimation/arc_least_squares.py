"""Residuals of a batch of arcs and their derivatives with respect to initial states, for least squares."""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from ahnn.dynamics.flow_at_time import at
from ahnn.estimation.belief import Belief
from ahnn.estimation.consistency import deviations
from ahnn.estimation.estimator import SensorModel
from ahnn.estimation.step_noise import StepGrid
from ahnn.jacobians import pointwise_jacobian
from ahnn.measurements import residual
from ahnn.types import Flow

DIFFERENCE = 1e-3
"""Half-width of central differences, in prior standard deviations."""


class Arc(NamedTuple):
    """Measurements of B members, with process model and prior.

    Attributes:
        flow: process model, assumed exact.
        grid: the T time steps.
        rows: (B, T, M) measurements, NaN where missing.
        measured: increasing indices of steps that end with a measurement.
        sensor: measurement model of the rows.
        prior: prior of the initial state.
    """

    flow: Flow
    grid: StepGrid
    rows: Tensor
    measured: list[int]
    sensor: SensorModel
    prior: Belief

    def first(self, count: int) -> Arc:
        """Return the arc truncated after its first `count` measured steps."""
        return self._replace(measured=self.measured[:count])


class Fit(NamedTuple):
    """Paths from initial states, with residuals of measurements and prior.

    Attributes:
        states: (B, N + 1, D) states up to the last measurement of the arc.
        moved: (B, N + 1, D, D) their derivatives with respect to the initial state.
        residuals: (B, R) residuals of measurements and prior, in standard deviations.
        design: (B, R, D) derivatives of the residuals with respect to the initial state.
        sums: (B,) sums of squared residuals; inf for a diverged path.
    """

    states: Tensor
    moved: Tensor
    residuals: Tensor
    design: Tensor
    sums: Tensor


def followed(arc: Arc, start: Tensor) -> Fit:
    """Propagate initial states (B, D) and evaluate their residuals.

    Derivatives are central differences over a small fraction of the prior standard deviations: any flow is
    supported, and all paths are propagated in one batch.
    """
    steps = arc.measured[-1] + 1 if arc.measured else 0
    half = DIFFERENCE * deviations(arc.prior.chol)
    offsets = torch.diag_embed(half)
    points = torch.cat(
        (start.unsqueeze(1), start.unsqueeze(1) + offsets, start.unsqueeze(1) - offsets), dim=1
    )
    along = [points]
    for k, length in enumerate(arc.grid.lengths[:steps]):
        flow = at(arc.flow, float(arc.grid.times[k]) - length)
        along.append(flow(along[-1].flatten(0, 1), length).to(start).reshape(points.shape))
    path = torch.stack(along, dim=1)
    plus, minus = path[:, :, 1:].chunk(2, dim=2)
    moved = ((plus - minus) / (2 * half[:, None, :, None])).mT
    states = path[:, :, 0]
    parts = [_row(arc, k, states[:, k + 1], moved[:, k + 1]) for k in arc.measured]
    root = torch.linalg.solve_triangular(arc.prior.chol, torch.eye(start.shape[1]).to(start), upper=False)
    prior = (root @ (start - arc.prior.mean).unsqueeze(-1)).squeeze(-1)
    residuals, design = (torch.cat(rows, dim=1) for rows in zip(*parts, (prior, root), strict=True))
    sums = residuals.square().sum(-1).nan_to_num(nan=torch.inf, posinf=torch.inf)
    return Fit(states, moved, residuals, design, sums)


def _row(arc: Arc, k: int, x: Tensor, moved: Tensor) -> tuple[Tensor, Tensor]:
    """Return the residuals (B, M) at the end of step k, and their derivatives (B, M, D)."""
    off, slope = _residual(arc, k, x), pointwise_jacobian(lambda z: _residual(arc, k, z), x) @ moved
    white = _whitened(arc, k, torch.cat((off.unsqueeze(-1), slope), dim=-1))
    return white[..., 0], white[..., 1:]


def _residual(arc: Arc, k: int, x: Tensor) -> Tensor:
    """Return predicted - measured (B, M) at the end of step k, 0 for missing components."""
    model, y = arc.sensor.measurement, arc.rows[:, k]
    difference = -residual(model, y.nan_to_num(), model(x, float(arc.grid.times[k])))
    return torch.where(y.isnan(), torch.zeros_like(difference), difference)


def _whitened(arc: Arc, k: int, values: Tensor) -> Tensor:
    """Return values (B, M, N) of step k whitened by the noise of the measured components."""
    present = ~arc.rows[:, k].isnan()
    noise = arc.sensor.chol_r @ arc.sensor.chol_r.mT
    pairs = present.unsqueeze(-1) & present.unsqueeze(-2)
    chol = torch.linalg.cholesky(torch.where(pairs, noise, torch.diag_embed((~present).to(noise))))
    return torch.linalg.solve_triangular(chol, values, upper=False)
