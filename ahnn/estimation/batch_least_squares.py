"""Batch least squares: the initial state of an arc that best fits all measurements and a prior.

The classical estimator of orbit determination (Tapley, Schutz & Born 2004, section 4.6), with an exact flow:
the only unknown is the initial state, residuals are normalised by their standard deviations, and Gauss-Newton
steps, damped individually for each member, fit spans of increasing length. The covariance follows from the
problem linearised at the solution and is propagated along the path: it accounts for measurement noise and
prior, but not for errors of the flow.
"""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from ahnn.estimation.arc_least_squares import Arc, Fit, followed
from ahnn.estimation.argument_checks import check_belief, checked_rows, checked_sensor
from ahnn.estimation.belief import Belief, Status, choose, leading
from ahnn.estimation.linalg import tria
from ahnn.estimation.state import initial_state
from ahnn.estimation.step_noise import StepGrid
from ahnn.measurements.base import Measurement
from ahnn.numbers import Numbers
from ahnn.shooting.initial_states import GROWTH, SHORTEST, damped_moves
from ahnn.types import Flow

ROUGHLY, ITERATIONS = 3, 20
"""Maximum number of iterations on a growing span, and on the complete arc."""
SETTLED = 1e-7
"""Relative change of the cost below which the iteration has converged."""
CAREFUL, EAGER = 1e-3, 1e-6
"""Initial damping on a growing span, and on the complete arc."""
SMALLEST, LARGEST = 1e-12, 1e9
"""Range of the damping."""


class BatchResult(NamedTuple):
    """Result of `batch_least_squares`.

    Attributes:
        initial: belief about the initial state.
        means: (B, T, D) means along the path; NaN for a diverged member.
        chols: (B, T, D, D) lower factors.
        cost: (B,) squared residuals of measurements and prior, in standard deviations: chi-square with as
            many degrees of freedom as measured values, if the flow is exact.
        measured: (B, T) int64, number of measured components.
        status: (B,) int64, see `Status`.
        settled: (B,) bool, whether the iteration converged.
    """

    initial: Belief
    means: Tensor
    chols: Tensor
    cost: Tensor
    measured: Tensor
    status: Tensor
    settled: Tensor

    def of_states(self, size: int) -> BatchResult:
        """Return the marginals of the leading components, given by the leading blocks."""
        return self._replace(
            initial=leading(self.initial, size),
            means=self.means[..., :size],
            chols=self.chols[..., :size, :size],
        )


@torch.no_grad()
def batch_least_squares(
    flow: Flow,
    belief: Belief,
    measurements: Numbers,
    measurement: Measurement,
    measurement_noise: Numbers,
    dt: Numbers,
    *,
    start_time: float = 0.0,
) -> BatchResult:
    """Estimate the initial states that best fit measurements and prior, and their paths.

    Args:
        flow: the process model, assumed exact.
        belief: prior of the initial state, see `initial_belief`.
        measurements: (B, T, M), NaN where a component is missing.
        measurement: measurement model.
        measurement_noise: R, (M, M) or (B, M, M), positive definite.
        dt: length of every step, or (T,) lengths.
        start_time: time of the belief.

    Raises:
        ValueError: an invalid argument, with the same messages as filters.
    """
    check_belief(belief)
    sensor = checked_sensor(measurement, measurement_noise, belief, None)
    shape = (len(belief.mean), "T", len(measurement.names))
    rows = checked_rows(measurements, "measurements", shape, belief.mean.device)
    grid = StepGrid.of(dt, rows.shape[1], initial_state(belief, start_time).time)
    measured = (~rows.isnan()).any(-1).any(0).nonzero().flatten().tolist()
    arc = Arc(flow, grid, rows, measured, sensor, belief)
    start, span = belief.mean, SHORTEST
    while span < len(measured):
        start = _refined(arc.first(span), start, ROUGHLY, CAREFUL)[0].states[:, 0]
        span *= GROWTH
    fit, settled = _refined(arc, start, ITERATIONS, EAGER)
    return _result(arc, fit, settled)


def _refined(arc: Arc, start: Tensor, iterations: int, first: float) -> tuple[Fit, Tensor]:
    """Iterate at most `iterations` times, with damping per member; return fit and converged members."""
    fit, damping = followed(arc, start), start.new_full((len(start),), first)
    settled = ~fit.sums.isfinite()
    for _ in range(iterations):
        trial = followed(arc, fit.states[:, 0] + damped_moves(fit.design, fit.residuals, damping))
        better = trial.sums <= fit.sums
        settled = (fit.sums - trial.sums).abs() <= SETTLED * fit.sums.clamp(min=1.0)
        fit = Fit(*(_where(better, new, old) for new, old in zip(trial, fit, strict=True)))
        damping = torch.where(better, damping / 10, damping * 10).clamp(SMALLEST, LARGEST)
        if bool((settled | ~fit.sums.isfinite()).all()):
            break
    return fit, settled


def _result(arc: Arc, fit: Fit, settled: Tensor) -> BatchResult:
    """Return beliefs along the entire arc, including after its last measurement."""
    whole = followed(arc._replace(measured=[len(arc.grid.lengths) - 1]), fit.states[:, 0])
    parts = (fit.sums[:, None, None], fit.design, whole.states, whole.moved.flatten(2))
    sound = torch.stack([part.isfinite().all(-1).all(-1) for part in parts]).all(0)
    unit = torch.eye(whole.states.shape[-1]).to(whole.states).expand(len(sound), -1, -1)
    # The covariance is the inverse of the normal matrix, which has a triangular square root.
    triangle = tria(_where(sound, fit.design, torch.ones_like(fit.design)))
    root = torch.linalg.solve_triangular(triangle, unit, upper=False).nan_to_num()
    chols = tria((whole.moved.nan_to_num() @ root.mT.unsqueeze(1)).mT.flatten(0, 1))
    chols = chols.unflatten(0, whole.states.shape[:2])
    nothing = chols.new_full((), torch.nan)
    return BatchResult(
        initial=choose(sound, Belief(whole.states[:, 0], chols[:, 0]), arc.prior),
        means=_where(sound, whole.states, nothing)[:, 1:],
        chols=_where(sound, chols, nothing)[:, 1:],
        cost=fit.sums,
        measured=(~arc.rows.isnan()).sum(-1),
        status=torch.where(sound, int(Status.OK), int(Status.NOT_FINITE)),
        settled=settled & sound,
    )


def _where(condition: Tensor, yes: Tensor, no: Tensor) -> Tensor:
    """Select values member by member."""
    return torch.where(condition.reshape(-1, *[1] * (yes.ndim - 1)), yes, no)
