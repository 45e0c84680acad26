"""Unknown starts of segments, fitted to their measurements with the dynamics held fixed.

Each segment is a least-squares problem of its own in D unknowns, solved by Levenberg-Marquardt with a damping
of its own; all of a batch are solved together. A start that is off explodes over a long segment: it is fitted
over growing spans first.
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
"""Intervals over which starts are fitted first, at least."""
GROWTH = 4
"""Factor from one span to the next."""
HOPELESS = 1e9
"""Mean squared residual of a segment that is given up; what fits badly is limited, and not left out."""
ROUGHLY, ITERATIONS = 3, 8
"""Steps on a span that is still to grow, and on the last one."""
LOST = 25.0
"""Mean squared residual of a segment that trained dynamics do not explain."""
SETTLED = 1e-3
"""Change of a segment's chi-square that is none."""
SMALLEST, LARGEST = 1e-9, 1e9
"""Range of the damping."""
WARY, SURE = 1e-5, 1e-7
"""First damping of a start that is a guess, and that of one that was fitted before the parameters moved.

A shift along an orbit grows with time and hides the other directions of a start: their share may be 1e-5.
"""
REFITS = 2
"""Steps that move the starts after the parameters moved, with derivatives of before."""
FOLLOWING = 4
"""Steps with derivatives of their own, at most, after a last step of a training, which is long."""
ROWS = 100
"""Paths that are followed together at least, though two cores could share them."""


class Trial(NamedTuple):
    """A flow that is held against measurements.

    Attributes:
        exact: increments in float64.
        jacobians: of steps, (B, N, D, D), at states (B, N, D) over lengths (B, N). They shape a move of the
            starts and may be in float32; whether it is good, exact increments decide.
        robust: the loss of residuals in standard deviations.
    """

    exact: Increment
    jacobians: Callable[[Tensor, Tensor], Tensor]
    robust: Robust


class Linearised(NamedTuple):
    """Residuals of segments, to first order in their starts.

    Attributes:
        jacobians: of the steps of the path, (B, N, D, D).
        residuals: (B, K + 1, M) predicted - measured in standard deviations, whitened where their noise is
            coloured, times the root of their weights.
        of_state: (B, K + 1, M, D) their derivative with respect to the state at their time; where they are
            whitened, that of what they were before.
        of_start: (B, K + 1, M, D) with respect to the start.
    """

    jacobians: Tensor
    residuals: Tensor
    of_state: Tensor
    of_start: Tensor

    def rows(self, part: slice) -> Linearised:
        """Return some of the segments."""
        return Linearised(*(values[part] for values in self))


class Fitted(NamedTuple):
    """Segments from the starts that fit them best.

    Attributes:
        states: (B, N + 1, D) along the path, the start first; NaN where it was given up.
        sums: (B,) twice the robust loss, the squared residuals; inf for a path that is lost.
    """

    states: Tensor
    sums: Tensor

    @property
    def starts(self) -> Tensor:
        """(B, D) the first states."""
        return self.states[:, 0]

    def rows(self, part: slice | Tensor) -> Fitted:
        """Return some of the segments."""
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
    """Return the paths from the starts (B, D) and how well they fit."""
    halves = slices(len(start), max(ROWS, -(-len(start) // 2)))
    states = torch.cat(
        each(lambda part: path(trial.exact, start[part], steps.lengths[part]), halves, start.device)
    )
    sums = trial.robust.cost(segment.white_residuals(states[:, steps.ends])).sum((1, 2))
    return Fitted(states, sums.nan_to_num(nan=torch.inf, posinf=torch.inf))


@torch.no_grad()
def fit_starts(
    trial: Trial, start: Tensor, segment: Segment, steps: Steps, hopeless: float = HOPELESS
) -> Fitted:
    """Return the fit of each segment, begun at `start`, shape (B, D), over growing spans.

    A segment that does not meet its measurements over one span, within a mean squared residual of `hopeless`,
    is not tried over longer ones. An outlier among the first samples spoils where a fit begins: a loss that
    forgets what is far off would stay there, and follows a convex one.
    """
    intervals, start = len(steps.ends) - 1, start.clone()
    name = trial.robust.approach
    first = trial if name is None else trial._replace(robust=ROBUST[name])
    alive = torch.arange(len(start))
    for span in growing(intervals):
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


def growing(intervals: int) -> list[int]:
    """Return the spans over which starts are fitted before all of the intervals."""
    spans = []
    while (intervals := -(-intervals // GROWTH)) >= SHORTEST:
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
    """Return the fit after at most so many Levenberg-Marquardt steps, each segment damped by itself."""
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
    """Return the fit from starts that were the best ones before the parameters moved.

    They are near: the derivatives at the first of two steps serve the second, too.
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
