"""Unknown starts of segments, fitted to their measurements with the dynamics held fixed.

Each segment is a least-squares problem of its own in D unknowns, solved by Levenberg-Marquardt with a damping
of its own; all of a batch are solved together. A start that is off explodes over a long segment: it is fitted
over growing spans first.
"""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from ahnn.measurements import Segment
from ahnn.shooting.paths import Increment, Steps, path, pointwise_jacobian, step_jacobians, transitions
from ahnn.shooting.robust import Robust

SHORTEST = 4
"""Intervals over which starts are fitted first."""
GROWTH = 3
"""Factor from one span to the next."""
HOPELESS = 100.0
"""Mean squared residual of a segment that is given up."""
ITERATIONS = 6
"""Steps on one span."""
SETTLED = 1e-3
"""Change of a segment's chi-square that is none."""
SMALLEST, LARGEST = 1e-9, 1e9
"""Range of the damping."""


class Trial(NamedTuple):
    """A flow that is held against measurements.

    Attributes:
        exact: increments in float64.
        rough: in float32, for derivatives. They shape a step; whether it is good, exact increments decide.
        robust: the loss of residuals in standard deviations.
    """

    exact: Increment
    rough: Increment
    robust: Robust


class Linearised(NamedTuple):
    """Residuals of segments, to first order in their starts.

    Attributes:
        states: (B, N + 1, D) along the path.
        jacobians: of its steps, (B, N, D, D).
        residuals: (B, K + 1, M) predicted - measured in standard deviations, 0 where nothing was measured.
        of_state: (B, K + 1, M, D) their derivative with respect to the state at their time.
        of_start: (B, K + 1, M, D) with respect to the start.
    """

    states: Tensor
    jacobians: Tensor
    residuals: Tensor
    of_state: Tensor
    of_start: Tensor


def linearised(trial: Trial, start: Tensor, segment: Segment, steps: Steps) -> Linearised:
    """Return the residuals of the paths from the starts (B, D), and their derivatives."""
    states = path(trial.exact, start, steps.lengths)
    jacobians = step_jacobians(trial.rough, states[:, :-1].float(), steps.lengths.float())
    measured = states[:, steps.ends]
    plain = segment.residuals(measured)
    of_state = pointwise_jacobian(segment.residuals, measured) * trial.robust.slope(plain).unsqueeze(-1)
    moved = transitions(jacobians.to(states))[:, steps.ends]
    return Linearised(states, jacobians, trial.robust.pseudo(plain), of_state, of_state @ moved)


def chi_square(trial: Trial, start: Tensor, segment: Segment, steps: Steps) -> Tensor:
    """Return the sum of squared residuals of each segment, shape (B,); inf for a path that is lost."""
    states = path(trial.exact, start, steps.lengths)[:, steps.ends]
    total = trial.robust.pseudo(segment.residuals(states)).square().sum((1, 2))
    return total.nan_to_num(nan=torch.inf, posinf=torch.inf)


@torch.no_grad()
def fit_starts(trial: Trial, start: Tensor, segment: Segment, steps: Steps) -> Tensor:
    """Return the starts (B, D) that fit the segments best, begun at `start`, over growing spans.

    A segment that does not meet its measurements over one span is not tried over longer ones.
    """
    intervals, start = len(steps.ends) - 1, start.clone()
    span, alive = min(SHORTEST, intervals), torch.arange(len(start))
    while True:
        part, grid = segment.rows(alive).first(span), steps.rows(alive).first(span)
        start[alive] = refine(trial, start[alive], part, grid, ITERATIONS)
        if span == intervals:
            return start
        met = chi_square(trial, start[alive], part, grid) <= HOPELESS * part.measured
        alive, span = alive[met], min(GROWTH * span, intervals)


@torch.no_grad()
def refine(trial: Trial, start: Tensor, segment: Segment, steps: Steps, iterations: int) -> Tensor:
    """Return starts (B, D) after at most so many Levenberg-Marquardt steps, each segment damped by itself."""
    damping = start.new_full((len(start),), 1e-3)
    for _ in range(iterations):
        now = linearised(trial, start, segment, steps)
        rows, design = now.residuals.flatten(1), now.of_start.flatten(1, 2)
        before = rows.square().sum(1).nan_to_num(nan=torch.inf, posinf=torch.inf)
        candidate = start + damped_moves(design, rows, damping)
        after = chi_square(trial, candidate, segment, steps)
        better = after <= before
        start = torch.where((better & after.isfinite()).unsqueeze(-1), candidate, start)
        damping = torch.where(better, damping / 10, damping * 10).clamp(SMALLEST, LARGEST)
        if bool(((before - after).abs() <= SETTLED).logical_or(~before.isfinite()).all()):
            break
    return start


def damped_moves(design: Tensor, rows: Tensor, damping: Tensor) -> Tensor:
    """Return Marquardt's steps (B, D) of problems with Jacobians (B, R, D) and residuals (B, R).

    A problem that is not finite, or has no measurement, does not move.
    """
    lost = ~(design.isfinite().all(-1).all(-1) & rows.isfinite().all(-1))
    design, rows = design.masked_fill(lost[:, None, None], 0), rows.masked_fill(lost[:, None], 0)
    scale = design.square().sum(1).sqrt()
    scale = torch.where(scale > 0, scale, torch.ones_like(scale))
    unit = design / scale.unsqueeze(1)
    matrix = unit.mT @ unit + torch.diag_embed(damping.unsqueeze(-1).expand_as(scale))
    moves = torch.linalg.solve_ex(matrix, -(unit.mT @ rows.unsqueeze(-1))).result.squeeze(-1)
    return moves.nan_to_num(0, 0, 0) / scale
