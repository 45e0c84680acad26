"""Fit of unknown initial states of segments to measurements, with fixed dynamics.

Each segment is a separate least-squares problem in D unknowns, solved by Levenberg-Marquardt with individual
damping; a batch is solved simultaneously. The path from an inaccurate initial state diverges over a long
segment, so the state is first fitted over growing spans.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import torch
from torch import Tensor

from ahnn.cores import each, slices
from ahnn.jacobians import pointwise_jacobian
from ahnn.measurements import Segment
from ahnn.shooting.path_sensitivities import Increment, Steps, path, transitions
from ahnn.shooting.robust import ROBUST, Robust

SHORTEST = 4
"""Minimum number of intervals of the first span."""
GROWTH, SLOW_GROWTH = 4, 2
"""Growth factors of spans, in a first fit and in the refit of a segment that has lost its path."""
HOPELESS = 1e9
"""Mean squared residual at which a segment is abandoned; the cost of poorly fitting ones is only limited."""
ROUGHLY, ITERATIONS = 3, 8
"""Numbers of iterations on a growing span and on the complete one."""
LOST = 25.0
"""Mean squared residual above which trained dynamics do not fit a segment."""
WORSE = 3.0
"""Mean squared residual, relative to that of the best segment, above which a fit may have lost its path."""
SETTLED = 1e-3
"""Change of a segment's chi-square below which the fit has converged."""
SMALLEST, LARGEST = 1e-9, 1e9
"""Range of the damping."""
WARY, SURE = 1e-5, 1e-7
"""Initial damping for a guessed initial state, and for one fitted before a parameter step.

The effect of a shift along an orbit grows with time; that of other directions may be only 1e-5 as large.
"""
REFITS = 2
"""Number of refitting steps after a parameter step, with the previous derivatives."""
FOLLOWING = 4
"""Maximum number of steps with new derivatives, after the long final step of the training."""
ROWS = 100
"""Number of paths up to which a batch is not divided between two cores."""


class Trial(NamedTuple):
    """Flow that is compared with measurements.

    Attributes:
        exact: increments in float64.
        jacobians: (states (B, N, D), lengths (B, N)) -> Jacobians of the steps, (B, N, D, D). They only
            determine step directions and may be in float32; exact increments decide acceptance.
        robust: robust loss of normalised residuals.
    """

    exact: Increment
    jacobians: Callable[[Tensor, Tensor], Tensor]
    robust: Robust


class Linearised(NamedTuple):
    """Residuals of segments, linearised in their initial states.

    Attributes:
        jacobians: Jacobians of the path's steps, (B, N, D, D).
        residuals: (B, K + 1, M) predicted - measured in standard deviations, whitened where their noise is
            coloured, times the square root of their weights.
        of_state: (B, K + 1, M, D) their derivative with respect to the state at the same time; if residuals
            are whitened, the derivative before whitening.
        of_start: (B, K + 1, M, D) derivative with respect to the initial state.
    """

    jacobians: Tensor
    residuals: Tensor
    of_state: Tensor
    of_start: Tensor

    def rows(self, part: slice) -> Linearised:
        """Return selected segments."""
        return Linearised(*(values[part] for values in self))


class Fitted(NamedTuple):
    """Segments with fitted initial states.

    Attributes:
        states: (B, N + 1, D) along the path, initial state first; NaN where abandoned.
        sums: (B,) twice the robust loss, or the sum of squared residuals; inf for a diverged path.
    """

    states: Tensor
    sums: Tensor

    @property
    def starts(self) -> Tensor:
        """Fitted initial states, (B, D)."""
        return self.states[:, 0]

    def rows(self, part: slice | Tensor) -> Fitted:
        """Return selected segments."""
        return Fitted(self.states[part], self.sums[part])


def linearised(trial: Trial, states: Tensor, segment: Segment, steps: Steps) -> Linearised:
    """Return the residuals of paths (B, N + 1, D), and their derivatives."""
    jacobians = trial.jacobians(states[:, :-1], steps.lengths)
    measured = states[:, steps.ends]
    plain, whitening = segment.residuals(measured), segment.whitening
    of_state = pointwise_jacobian(segment.residuals, measured)
    moved = transitions(jacobians.to(states))[:, steps.ends]
    if whitening is not None:
        white, of_start = whitening(plain), whitening(of_state @ moved)
        weight = trial.robust.weight(white).sqrt()
        return Linearised(jacobians, white * weight, of_state, of_start * weight.unsqueeze(-1))
    weight = trial.robust.weight(plain).sqrt()
    of_state = of_state * weight.unsqueeze(-1)
    return Linearised(jacobians, plain * weight, of_state, of_state @ moved)


def followed(trial: Trial, start: Tensor, segment: Segment, steps: Steps) -> Fitted:
    """Propagate initial states (B, D) and evaluate their fit."""
    halves = slices(len(start), max(ROWS, -(-len(start) // 2)))
    states = torch.cat(
        each(lambda part: path(trial.exact, start[part], steps.lengths[part]), halves, start.device)
    )
    sums = trial.robust.cost(segment.white_residuals(states[:, steps.ends])).sum((1, 2))
    return Fitted(states, sums.nan_to_num(nan=torch.inf, posinf=torch.inf))


@torch.no_grad()
def fit_starts(
    trial: Trial,
    start: Tensor,
    segment: Segment,
    steps: Steps,
    hopeless: float = HOPELESS,
    growth: int = GROWTH,
) -> Fitted:
    """Fit each segment from `start`, shape (B, D), over spans that grow by a factor.

    A segment whose mean squared residual exceeds `hopeless` on one span is not fitted on longer ones. An
    outlier among the first samples spoils the initial values, from which a redescending loss could not
    recover; a convex loss is therefore used first.
    """
    intervals, start = len(steps.ends) - 1, start.clone()
    name = trial.robust.approach
    first = trial if name is None else trial._replace(robust=ROBUST[name])
    alive = torch.arange(len(start), device=start.device)
    for span in growing(intervals, growth):
        part, grid = segment.rows(alive).first(span), steps.rows(alive).first(span)
        fitted = refine(first, start[alive], part, grid, ROUGHLY)
        start[alive] = fitted.starts
        alive = alive[fitted.sums <= hopeless * part.measured]
    states = start.new_full((len(start), steps.lengths.shape[1] + 1, start.shape[1]), torch.nan)
    sums = start.new_full((len(start),), torch.inf)
    part, grid = segment.rows(alive), steps.rows(alive)
    if name is not None:
        start[alive] = refine(first, start[alive], part, grid).starts
    fitted = refine(trial, start[alive], part, grid)
    states[:, 0], states[alive], sums[alive] = start, *fitted
    return Fitted(states, sums)


def follow_starts(
    trial: Trial, start: Tensor, segment: Segment, steps: Steps, hopeless: float = HOPELESS
) -> Fitted:
    """Fit each segment from initial states (B, D) that were fitted with similar dynamics.

    On a chaotic path a small change of the dynamics moves the end of the path beyond the linear range. A
    segment that fits much worse than the best one is fitted again over growing spans.
    """
    fitted = refine(trial, start, segment, steps, FOLLOWING, SURE)
    return regained(trial, fitted, start, segment, steps, hopeless)


@torch.no_grad()
def regained(
    trial: Trial, fitted: Fitted, start: Tensor, segment: Segment, steps: Steps, hopeless: float = HOPELESS
) -> Fitted:
    """Refit segments that fit much worse than the best one, from `start` (B, D) over slowly growing spans."""
    if not len(start):
        return fitted
    squares = fitted.sums / segment.measured.clamp(min=1)
    off = (squares > WORSE * squares.min().clamp(1.0, LOST)).nonzero().squeeze(1)
    if len(off):
        again = fit_starts(trial, start[off], segment.rows(off), steps.rows(off), hopeless, SLOW_GROWTH)
        better = again.sums < fitted.sums[off]
        fitted.states[off[better]], fitted.sums[off[better]] = again.rows(better)
    return fitted


def growing(intervals: int, growth: int = GROWTH) -> list[int]:
    """Return the growing spans used before the complete one."""
    spans = []
    while (intervals := -(-intervals // growth)) >= SHORTEST:
        spans.append(intervals)
    return spans[::-1]


@torch.no_grad()
def refine(
    trial: Trial,
    start: Tensor,
    segment: Segment,
    steps: Steps,
    iterations: int = ITERATIONS,
    damping: float = WARY,
) -> Fitted:
    """Refine the fit by a limited number of Levenberg-Marquardt steps with individual damping."""
    fitted = followed(trial, start, segment, steps)
    dampings, moving = start.new_full((len(start),), damping), fitted.sums.isfinite().nonzero().squeeze(1)
    for _ in range(iterations):
        if not len(moving):
            break
        part, grid, before = segment.rows(moving), steps.rows(moving), fitted.rows(moving)
        now = linearised(trial, before.states, part, grid)
        moves = damped_moves(now.of_start.flatten(1, 2), now.residuals.flatten(1), dampings[moving])
        after = followed(trial, before.starts + moves, part, grid)
        better = after.sums <= before.sums
        fitted.states[moving[better]], fitted.sums[moving[better]] = after.rows(better)
        factor = torch.where(better, 0.03, 10.0)
        dampings[moving] = (dampings[moving] * factor).clamp(SMALLEST, LARGEST)
        moving = moving[(before.sums - after.sums).abs() > SETTLED]
    return fitted


@torch.no_grad()
def refit(trial: Trial, start: Tensor, segment: Segment, steps: Steps) -> Fitted:
    """Refit from initial states that were optimal before a parameter step.

    They are close to the new optimum, so the second step reuses the derivatives of the first.
    """
    fitted = followed(trial, start, segment, steps)
    design = linearised(trial, fitted.states, segment, steps).of_start.flatten(1, 2)
    damping = start.new_full((len(start),), SURE)
    for _ in range(REFITS):
        residuals = segment.white_residuals(fitted.states[:, steps.ends])
        rows = (residuals * trial.robust.weight(residuals).sqrt()).flatten(1)
        after = followed(trial, fitted.starts + damped_moves(design, rows, damping), segment, steps)
        better = after.sums <= fitted.sums
        states = torch.where(better[:, None, None], after.states, fitted.states)
        fitted = Fitted(states, torch.where(better, after.sums, fitted.sums))
    return fitted


def damped_moves(design: Tensor, rows: Tensor, damping: Tensor) -> Tensor:
    """Return Marquardt steps (B, D) of problems with Jacobians (B, R, D) and residuals (B, R).

    Problems with non-finite values or without measurements get zero steps.
    """
    lost = ~(design.isfinite().all(-1).all(-1) & rows.isfinite().all(-1))
    design, rows = design.masked_fill(lost[:, None, None], 0), rows.masked_fill(lost[:, None], 0)
    scale = design.square().sum(1).sqrt()
    scale = torch.where(scale > 0, scale, torch.ones_like(scale))
    unit = design / scale.unsqueeze(1)
    matrix = unit.mT @ unit + torch.diag_embed(damping.unsqueeze(-1).expand_as(scale))
    moves = torch.linalg.solve_ex(matrix, -(unit.mT @ rows.unsqueeze(-1))).result.squeeze(-1)
    return moves.nan_to_num(0, 0, 0) / scale
