"""Multiple shooting: learning of dynamics from segments of measurements with unknown initial states.

The initial states are eliminated: residuals are evaluated at the best initial state for the current
parameters (variable projection, Golub & Pereyra 1973; Jacobian as in Kaufman 1975). The result is a
least-squares problem only in the parameters, for any kind of measurement: a state, a position, a range.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from typing import ClassVar, cast

import torch
from torch import Tensor
from torch.func import vjp
from torch.nn.utils import parameters_to_vector

from ahnn.cores import each
from ahnn.dynamics import Dynamics, HasField, has_field
from ahnn.dynamics.derivatives import field_jacobian, parametrised
from ahnn.dynamics.recorded_flow import Increments
from ahnn.dynamics.variations import jacobians_of_steps
from ahnn.errors import UserError
from ahnn.measurements import Segment
from ahnn.measurements.smoothing import guess
from ahnn.shooting.initial_states import (
    HOPELESS,
    Fitted,
    Linearised,
    Trial,
    fit_starts,
    follow_starts,
    followed,
    linearised,
    refit,
)
from ahnn.shooting.normal_points import normal_points
from ahnn.shooting.path_sensitivities import Steps, adjoints, path, sensitivities, steps_between
from ahnn.shooting.robust import Robust, RobustName, loss_of
from ahnn.training.limited_segments import Limit, freedom, near
from ahnn.training.normal_equations import Equations, ResidualRows, accumulated

CELLS = 2.5e7
"""Size limit of the largest sensitivity tensor; larger batches are divided by segments."""
NUMBERS = 50
"""Number of values stored per state component in a backward pass through the field."""
UNMET = 1e4
"""Mean squared residual at which a validation abandons a trajectory, to save time."""
PATHS = 20
"""Approximate number of paths of a problem, for deciding whether to record the flow."""


@dataclass(frozen=True, eq=False)
class Shooting:
    """Residuals predicted - measured over K intervals from the best initial state, in standard deviations.

    Attributes:
        intervals: number K of intervals; None: full trajectories.
        robust: robust loss of residuals: none (squares), huber or student.
    """

    intervals: int | None
    robust: RobustName = "none"
    bends: ClassVar[bool] = True  # problems provide second derivatives of residuals

    def residuals(self, dynamics: Dynamics, batch: Segment) -> Tensor:
        """Return the weighted residuals of the segments that converged, shape (B, K + 1, M), with a graph.

        The initial states are fixed at their best fit: to first order the loss does not depend on them, so
        its gradient is the same as along the best initial states (envelope theorem).
        """
        problem = self.problem(dynamics, batch)
        states = path(dynamics.increment, problem.starts, problem.steps.lengths)[:, problem.steps.ends]
        residuals = problem.batch.residuals(states)
        fixed = residuals.detach()
        of_segments = problem.limit.weight(problem.robust.cost(fixed).sum((1, 2)))
        weight = problem.robust.weight(fixed) * of_segments[:, None, None]
        return residuals * weight.sqrt()

    def problem(self, dynamics: Dynamics, batch: Segment) -> ShootingProblem:
        """Return the residuals as a least-squares problem in the parameters of the dynamics."""
        return ShootingProblem(dynamics, batch, loss_of(self.robust, batch.instrument.freedom))

    def divided(self, batch: Segment) -> tuple[Segment, None]:
        """Return the entire batch for the step: initial states are refitted, and no check is needed."""
        return batch, None

    def validation(self, dynamics: Dynamics, batch: Segment) -> dict[str, Tensor]:
        """Return chi-square per degree of freedom, with `UNMET` for lost segments, and their fraction."""
        loss, degrees = loss_of(self.robust, batch.instrument.freedom), freedom(batch)
        problem = ShootingProblem(dynamics, batch, loss, UNMET)
        sums = torch.minimum(problem.fitted.sums, UNMET * degrees)
        return {"loss": sums.sum() / degrees.sum(), "lost": sums.new_tensor(problem.lost / len(sums))}


class ShootingProblem:
    """Least-squares problem of measurement segments in the parameters theta, shape (P,), of dynamics.

    Args:
        dynamics: dynamics with a field; initial states are first fitted at their current parameters.
        batch: measurement segments.
        robust: robust loss of residuals.
        hopeless: mean squared residual at which a segment is abandoned.
        starts: (B, D) approximate initial states; None derives them from measurements.
        quartered: whether to quarter the integrator steps between measurements.

    Attributes:
        fitted: all segments at their best initial states.
        kept: mask of converged segments, (B,) bool.
        batch, starts: converged segments, and their initial states (B, D).
        limit: cost limits of segments.
        steps: integrator steps between measurements.
        lost: number of segments that did not converge.
        count: degrees of freedom, without subtraction of parameters.
        precision: dtype of the products in the normal equations.

    Raises:
        UserError: dynamics without a field.
    """

    precision: ClassVar[torch.dtype] = torch.float32

    def __init__(
        self,
        dynamics: Dynamics,
        batch: Segment,
        robust: Robust,
        hopeless: float = HOPELESS,
        starts: Tensor | None = None,
        quartered: bool = False,
    ) -> None:
        if not has_field(dynamics):
            message = (
                "loss.stages: expected dynamics with a field, whose rates determine the steps; received "
                f"{type(dynamics).__name__}. Use model=ahnn or model=node"
            )
            raise UserError(message)
        self.robust, self.forcing = robust, field_jacobian(dynamics, self.precision)
        steps = steps_between(batch.times, batch.instrument.longest)
        steps = steps.quarters() if quartered else steps
        self._exact = Increments(dynamics, PATHS * steps.lengths.shape[1])
        self._jacobians = jacobians_of_steps(dynamics)
        trial = self.trial(parameters_to_vector(dynamics.parameters()).detach())
        self.fitted = self.fit(trial, starts, batch, steps, hopeless)
        self.kept = kept = near(self.fitted.sums, freedom(batch), hopeless)
        self.steps, self.batch, self.starts = steps.rows(kept), batch.rows(kept), self.fitted.starts[kept]
        self.limit = Limit.of(self.fitted.sums[kept], freedom(self.batch))
        self.lost, self.count = int((~kept).sum()), int(freedom(self.batch).sum())
        self._refitted: tuple[Tensor, Fitted] | None = None  # cached for the last parameters
        self._linear: tuple[Tensor, Fitted, Linearised] | None = None

    def fit(
        self, trial: Trial, starts: Tensor | None, batch: Segment, steps: Steps, hopeless: float
    ) -> Fitted:
        """Fit the initial states of all segments, from approximate ones (B, D) or from measurements."""
        if starts is None:
            return fit_starts(trial, guess(batch), batch, steps, hopeless)
        return follow_starts(trial, starts, batch, steps, hopeless)

    @property
    def cost(self) -> Tensor:
        """Sum of squared residuals at the current parameters, with each segment limited."""
        return self.limit.cost(self.fitted.sums[self.kept]).sum()

    def trial(self, theta: Tensor) -> Trial:
        """Return the flow with parameters theta, shape (P,)."""
        return Trial(partial(self._exact, theta), partial(self._jacobians, theta), self.robust)

    def _parts(self, parameters: int) -> Iterator[slice]:
        """Yield parts of the segments whose sensitivities fit into memory."""
        cells = (self.steps.lengths.shape[1] + 1) * self.starts.shape[-1] * parameters
        rows = max(1, int(CELLS // cells))
        return (slice(k, k + rows) for k in range(0, len(self.starts), rows))

    @torch.no_grad()
    def loss(self, theta: Tensor) -> Tensor:
        """Return the sum of squared residuals, each segment at its best initial state and limited."""
        if not len(self.starts):
            return theta.new_full((), torch.inf)
        return self.limit.cost(self.refitted(theta).sums).sum()

    def refitted(self, theta: Tensor) -> Fitted:
        """Refit the initial states of all segments for parameters theta, (P,)."""
        if self._refitted is None or self._refitted[0] is not theta:
            self._refitted = theta, refit(self.trial(theta), self.starts, self.batch, self.steps)
        return self._refitted[1]

    @torch.no_grad()
    def equations(self, theta: Tensor, sizes: Sequence[int]) -> Equations:
        """Return loss and normal equations without initial states; none if no segment converged."""
        if not len(self.starts):
            return Equations(theta.new_tensor(HOPELESS), 1, [])
        here, now = self._linearised(theta)

        def projected(part: slice) -> ResidualRows:
            return self._projected(theta, here.rows(part), now.rows(part), part)

        return accumulated(projected, self._parts(len(theta)), theta, self.count)

    def _linearised(self, theta: Tensor) -> tuple[Fitted, Linearised]:
        """Return all paths and their derivatives, in one batch: the number of steps dominates the cost."""
        if self._linear is None or self._linear[0] is not theta:
            trial = self.trial(theta)
            here = followed(trial, self.starts, self.batch, self.steps)
            self._linear = theta, here, linearised(trial, here.states, self.batch, self.steps)
        return self._linear[1:]

    def _projected(self, theta: Tensor, here: Fitted, now: Linearised, part: slice) -> ResidualRows:
        """Return residuals of segments and their Jacobian, without the effect of initial states.

        Initial states compensate most of the effect of parameters on a path: float32 would lose the rest.
        """
        ends, whitening = self.steps.ends, self.batch.rows(part).whitening
        if whitening is None and self.batch.instrument.bias_sd is None:
            now, ends = normal_points(now, ends)
        steps, limit = self.steps.rows(part)._replace(ends=ends), self.limit.rows(part)
        forcing = self.forcing(theta, here.states).to(theta)
        of_theta = now.of_state @ sensitivities(now.jacobians.to(theta), forcing, steps)
        of_theta = of_theta if whitening is None else whitening(of_theta)
        of_theta = self.with_more(of_theta, here, part).flatten(1, 2)
        basis = torch.linalg.qr(now.of_start.flatten(1, 2)).Q
        rows, weight = now.residuals.flatten(1), limit.weight(here.sums).sqrt()
        rows = rows - (basis @ (basis.mT @ rows.unsqueeze(-1))).squeeze(-1)
        of_theta = (of_theta - basis @ (basis.mT @ of_theta)) * weight[:, None, None]
        jacobian = of_theta.flatten(0, 1).to(self.precision)
        return ResidualRows(limit.cost(here.sums).sum(), (rows * weight[:, None]).flatten(), jacobian)

    def with_more(self, of_theta: Tensor, here: Fitted, part: slice) -> Tensor:
        """Append columns of further unknowns to derivatives of residuals (B, K + 1, M, P)."""
        return of_theta

    @torch.no_grad()
    def gradient(self, theta: Tensor) -> Tensor:
        """Return J^T r, shape (P,), by reverse mode in float64, without normal points or a rounded J."""
        here, now = self._linearised(theta)
        return self._pulled_back(theta, here, now, now.residuals.flatten(1))

    @torch.no_grad()
    def bend(self, theta: Tensor, step: Tensor, reach: float) -> Tensor:
        """Return J^T r_vv, as in `ahnn.training.acceleration.Bends`; initial states follow the step."""
        steps, segment, starts = self.steps, self.batch, self.starts
        here, now = self._linearised(theta)
        weight = self.robust.weight(segment.white_residuals(here.states[:, steps.ends])).sqrt()

        def rows(fraction: float, from_starts: Tensor) -> Tensor:
            trial = self.trial(theta + fraction * step)
            measured = path(trial.exact, from_starts, steps.lengths)[:, steps.ends]
            return (segment.white_residuals(measured) * weight).flatten(1)

        basis, triangle = torch.linalg.qr(now.of_start.flatten(1, 2))
        slope = (rows(reach, starts) - rows(-reach, starts)) / (2 * reach)
        moves = -torch.linalg.solve_triangular(triangle, basis.mT @ slope.unsqueeze(-1), upper=True)
        moves = reach * moves.squeeze(-1)
        second = rows(reach, starts + moves) - 2 * now.residuals.flatten(1) + rows(-reach, starts - moves)
        finite = second.isfinite().all(1, keepdim=True)  # a diverging path carries no information
        return self._pulled_back(theta, here, now, (second / reach**2).where(finite, 0.0))

    def _pulled_back(self, theta: Tensor, here: Fitted, now: Linearised, rows: Tensor) -> Tensor:
        """Return J^T of rows (B, R), shape (P,), by reverse mode along paths, without initial states."""
        basis = torch.linalg.qr(now.of_start.flatten(1, 2)).Q
        rows = rows - (basis @ (basis.mT @ rows.unsqueeze(-1))).squeeze(-1)
        rows = rows * self.limit.weight(here.sums)[:, None]
        rows, whitening = rows.view_as(now.residuals), self.batch.whitening
        rows = rows if whitening is None else whitening.transposed(rows)
        pulls = torch.einsum("bkm,bkmd->bkd", rows, now.of_state)
        pulls = adjoints(now.jacobians.to(here.states), pulls, self.steps)
        field = parametrised(self._exact.dynamics, cast(HasField, self._exact.dynamics).field, theta.dtype)

        def back(part: slice) -> Tensor:
            return vjp(lambda parameters: field(parameters, here.states[part]), theta)[1](pulls[part])[0]

        return torch.stack(each(back, self._parts(NUMBERS), theta.device)).sum(0)
