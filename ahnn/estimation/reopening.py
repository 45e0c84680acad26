"""Reopening of a gate: many consecutive rejections mean that the filter has lost its object.

The covariance of the start is added to the belief, times a factor that makes the measurement unsurprising:
its normalised innovation squared (NIS) is at most twice the number of its components. Positions and
velocities become uncertain in the proportion of the start, also in directions in which the belief had become
narrow; biases and parameters, which no manoeuvre changes, keep their covariance.
"""

from __future__ import annotations

from itertools import count
from typing import Any

import torch
from torch import Tensor
from torch.nn.functional import pad

from ahnn.estimation.belief import Belief
from ahnn.estimation.covariances import Covariance
from ahnn.estimation.estimator import Innovation
from ahnn.estimation.gate import Gate
from ahnn.estimation.linalg import tria
from ahnn.estimation.member_filter import MemberFilter
from ahnn.estimation.state import Kept
from ahnn.measurements import Measurement

USUAL = 2.0
"""NIS of a component at which a measurement is unsurprising."""
WIDEST = 1e16
"""Maximum factor on the covariance of the start: no measurement is 1e8 standard deviations away."""
TRIES = 20
"""Maximum number of factors; three or four suffice, since the NIS finally falls as one over the factor."""


def reopened(
    estimator: MemberFilter[Any],
    before: Kept,
    y: Tensor,
    model: Measurement,
    noise: Covariance,
    spread: Tensor,
) -> tuple[Kept, Innovation, Tensor]:
    """Return the states given a row each, from beliefs widened until the row is not surprising.

    Args:
        estimator: estimator with its gate.
        before: state of B members before the rows.
        y: (B, M) rows, NaN where a component is missing.
        model: measurement model of the rows.
        noise: R.
        spread: (B, d, d) factors of the covariances of the first d components at the start.

    Returns:
        The states, the innovations for the wider beliefs, and members that accepted their row, (B,) bool; all
        other members are meaningless.
    """
    # Rows that are still too far away are rejected, since some filters would fail on them.
    wary, factor = estimator.gated(Gate(0.999999)), torch.ones_like(before.log_likelihood)
    for tried in count(1):
        after, told = wary.update(widened(estimator, before, spread, factor), y, model, noise)
        ratio = told.nis / told.measured
        far = ratio > USUAL  # excludes failed members, whose NIS is NaN
        if tried == TRIES or not bool(far.any()):
            return after, told, after.alive & ~told.rejected & ~far & (told.measured > 0)
        factor = torch.where(far, factor * ratio, factor).clamp(max=WIDEST)
    raise AssertionError


def widened(estimator: MemberFilter[Any], state: Kept, spread: Tensor, factor: Tensor) -> Kept:
    """Return a state with `factor` (B,) times the covariance of the start added."""
    mean, chol = state.belief
    rows = factor.sqrt()[:, None, None] * spread.mT
    rows = torch.cat((chol.mT, pad(rows, (0, chol.shape[-1] - spread.shape[-1]))), dim=1)
    begun = estimator.start(Belief(mean, tria(rows)), float(state.time))
    kept = {"steps": state.steps, "repairs": state.repairs, "log_likelihood": state.log_likelihood}
    return begun._replace(**kept, failed_step=state.failed_step, status=state.status)
