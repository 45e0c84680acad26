"""Geodesic acceleration: second-order corrections of Gauss-Newton steps.

Network residuals are nonlinear along a Gauss-Newton step v, and damping limits the step accordingly. The
acceleration a solves the same damped equations for the second derivative of the residuals along v,

    (J^T J + damping D) a = -J^T r_vv,

and v + a / 2 is valid over a longer distance (Transtrum & Sethna 2012, arXiv:1201.5885). It costs a few
evaluations of the residuals, and no Jacobian.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol, runtime_checkable

from torch import Tensor

from ahnn.training.normal_equations import Block, damped_step, metric

LONGEST = 0.75
"""Maximum length of the acceleration relative to the step; beyond it two terms are insufficient."""
REACH = 0.1
"""Displacement of the finite difference for the second derivative, as a fraction of the step."""


@runtime_checkable
class Bends(Protocol):
    """Problem that provides the second derivative of its residuals along a step."""

    def bend(self, theta: Tensor, step: Tensor, reach: float) -> Tensor:
        """Return J^T r_vv, (P,), at theta for the step v, by differences over the fraction `reach` of it."""
        ...


def accelerated(
    problem: Bends, theta: Tensor, blocks: Sequence[Block], step: Tensor, damping: float
) -> Tensor | None:
    """Return v + a / 2 for a damped step v from theta, shape (P,); None if the step is too long."""
    pull = problem.bend(theta, step, REACH)
    turned = [block._replace(gradient=pull[block.columns]) for block in blocks]
    turn = damped_step(turned, damping, theta)
    if turn is not None and _length(turn, blocks) <= LONGEST * _length(step, blocks):
        return step + turn / 2
    return None


def _length(step: Tensor, blocks: Sequence[Block]) -> float:
    """Return the length of a step in the metric D of the damping."""
    squares = (metric(block) @ step[block.columns].square() for block in blocks)
    return sum(float(square) for square in squares) ** 0.5
