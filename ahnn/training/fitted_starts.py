"""Predictions of windows from their best-fitting starts, linearised about their samples.

A given state, for example from an analytical theory, need not be the state from which a flow predicts best.
Here the start of each window is fitted to the window's positions, and training minimises the residuals of the
fit. About exact samples x_k the deviation e of a prediction obeys, to first order,

    e_{k+1} = M_k e_k + d_k,    d_k = F(x_k) - x_{k+1},    M_k = F'(x_k),

with the flow F of one step: all steps are evaluated in one batch, and no path is integrated. The start e_0 is
eliminated, as in `ahnn.training.shooting`.
"""

from __future__ import annotations

import copy
from dataclasses import dataclass
from typing import cast

import torch
from torch import Tensor
from torch.nn.utils import parameters_to_vector, vector_to_parameters

from ahnn.arguments import checked
from ahnn.clock import reduced
from ahnn.cores import slices
from ahnn.dynamics import Dynamics, HasField, has_field
from ahnn.dynamics.derivatives import field_jacobian
from ahnn.dynamics.variations import jacobians_of_steps
from ahnn.errors import UserError
from ahnn.shooting.path_sensitivities import Steps, sensitivities, transitions
from ahnn.training.least_squares import LeastSquares
from ahnn.training.loss import Loss
from ahnn.types import Window

WIDE = torch.float64
"""Type of Jacobians: starts compensate most effects of parameters, and float32 would lose the rest."""
APART = 4
"""Number of steps between compared positions; those in between are redundant."""
TOGETHER = 4
"""Number of windows whose parameter derivatives are formed at once, to limit memory."""


@checked
@dataclass(frozen=True, eq=False)
class FittedStarts:
    """Errors of positions predicted over entire windows from best-fitting starts.

    Attributes:
        loss: residual units.
        window: number W of steps.
    """

    loss: Loss
    window: int

    def residuals(self, dynamics: Dynamics, batch: Window) -> Tensor:
        """Return the weighted residuals, shape (B, K n), of K positions; Jacobians have no graph."""
        about = AboutSamples(dynamics, batch.first(self.window), self.loss)
        return about.left(about.defects(dynamics.increment(about.x, about.dt)))

    def problem(self, dynamics: Dynamics, batch: Window) -> LeastSquares:
        """Return the residuals as a least-squares problem in the parameters of the dynamics."""
        about = AboutSamples(dynamics, batch.first(self.window), self.loss)
        rows = field_jacobian(cast(HasField, dynamics), WIDE)

        @torch.no_grad()
        def residuals(theta: Tensor) -> Tensor:
            # Jacobians are recomputed: errors of old ones, times deviations in km, would grow along an orbit.
            moved = copy.deepcopy(dynamics)
            vector_to_parameters(theta, moved.parameters())
            return self.residuals(moved, batch).flatten()

        def jacobian(theta: Tensor) -> Tensor:
            parts = slices(len(about.states), TOGETHER)
            return torch.cat([about.of_parameters(rows(theta, about.states[k]), k) for k in parts])

        return LeastSquares(residuals, jacobian)

    def divided(self, batch: Window) -> tuple[Window, None]:
        """Return the entire batch for the step: fitted starts need no check."""
        return batch, None

    @torch.no_grad()
    def validation(self, dynamics: Dynamics, batch: Window) -> dict[str, Tensor]:
        """Return the mean squared residual."""
        return {"loss": self.residuals(dynamics, batch).square().mean()}


class AboutSamples:
    """Paths of dynamics, linearised about the samples of windows.

    Args:
        dynamics: dynamics with a field.
        batch: windows of equal steps.
        loss: residual units.

    Attributes:
        states: (B, W + 1, D) samples.
        x, target: first state and true increment of every step, (B W, D) each.
        dt: length of the steps.

    Raises:
        UserError: dynamics without a field, or unequal steps.
    """

    def __init__(self, dynamics: Dynamics, batch: Window, loss: Loss) -> None:
        if not has_field(dynamics) or isinstance(batch.dt, Tensor):
            received = "steps that differ" if isinstance(batch.dt, Tensor) else type(dynamics).__name__
            message = (
                "loss.objective: fitted_starts expects dynamics with a field and equal steps; received "
                f"{received}. Use loss=recursive"
            )
            raise UserError(message)
        first = batch.start.unsqueeze(1)
        self.states = torch.cat((first, first + batch.increments.cumsum(1)), dim=1)
        self.x, self.target = self.states[:, :-1].flatten(0, 1), batch.increments.flatten(0, 1)
        self.dt, self.shape = batch.dt, batch.increments.shape
        lengths = batch.increments.new_full(self.shape[:2], batch.dt)
        ends = torch.arange(0, self.shape[1] + 1, APART)
        self.steps = Steps(lengths, ends)
        theta = parameters_to_vector(dynamics.parameters()).detach()
        self.jacobians = jacobians_of_steps(dynamics, WIDE)(theta, self.states[:, :-1], lengths)
        self.dof = self.shape[-1] // 2 - dynamics.clock
        self.weight = 1 / loss.unit[: self.dof].to(WIDE)
        of_start = reduced(transitions(self.jacobians)[:, ends, : self.dof], dynamics.clock)
        self.basis = torch.linalg.qr((of_start * self.weight[:, None]).flatten(1, 2)).Q

    def defects(self, increments: Tensor) -> Tensor:
        """Return d_k, shape (B, W, D), from predicted increments (B W, D)."""
        return (increments - self.target).view(self.shape)

    def left(self, defects: Tensor) -> Tensor:
        """Return the residuals of positions from the best starts, shape (B, K n), from d_k, (B, W, D)."""
        off = torch.zeros_like(defects[:, 0])
        path = [off]
        for step, defect in zip(self.jacobians.unbind(1), defects.unbind(1), strict=True):
            off = (step @ off.unsqueeze(-1)).squeeze(-1) + defect
            path.append(off)
        rows = torch.stack(path, dim=1)[:, self.steps.ends, : self.dof] * self.weight
        return self._without_starts(rows.flatten(1).unsqueeze(-1)).squeeze(-1)

    def of_parameters(self, forcing: Tensor, part: slice) -> Tensor:
        """Return derivatives of residuals of some windows, (N, P), from those of the field."""
        found = sensitivities(self.jacobians[part], forcing, self.steps.rows(part))[:, :, : self.dof]
        return self._without_starts((found * self.weight[:, None]).flatten(1, 2), part).flatten(0, 1)

    def _without_starts(self, rows: Tensor, part: slice = slice(None)) -> Tensor:
        basis = self.basis[part]
        return rows - basis @ (basis.mT @ rows)
