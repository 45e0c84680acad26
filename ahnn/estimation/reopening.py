"""Reopening of a gate after many consecutive rejections, which indicate that the filter has lost track.

The initial covariance, times a factor, is added to the covariance of the belief. The factor makes the
measurement unsurprising: its normalised innovation squared (NIS) is at most twice the number of its
components. Positions and velocities become uncertain in the same proportions as at the start, even in
directions in which the belief had become precise; biases and parameters, which no manoeuvre changes, keep
their covariance.
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
"""Largest NIS per component of an unsurprising measurement."""
WIDEST = 1e16
"""Maximum factor on the initial covariance: no measurement is 1e8 standard deviations away."""
TRIES = 20
"""Maximum number of factors tried; three or four suffice, since for large factors NIS ~ 1 / factor."""


def reopened(
    estimator: MemberFilter[Any],
    before: Kept,
    y: Tensor,
    model: Measurement,
    noise: Covariance,
    spread: Tensor,
) -> tuple[Kept, Innovation, Tensor]:
    """Condition each member on its row, with its belief widened until the row is unsurprising.

    Args:
        estimator: estimator with its gate.
        before: state of B members before the rows.
        y: (B, M) rows, NaN where a component is missing.
        model: measurement model of the rows.
        noise: R.
        spread: (B, d, d) factors of the initial covariances of the first d components.

    Returns:
        The states, the innovations for the wider beliefs, and a (B,) bool mask of members that accepted
        their row; the values of all other members are meaningless.
    """
    # Rows that are still too far away are rejected, since some filters would fail on them.
    wary, factor = estimator.gated(Gate(0.999999)), torch.ones_like(before.log_likelihood)
    for tried in count(1):
        after, innovation = wary.update(widened(estimator, before, spread, factor), y, model, noise)
        ratio = innovation.nis / innovation.measured
        far = ratio > USUAL  # excludes failed members, whose NIS is NaN
        if tried == TRIES or not bool(far.any()):
            return after, innovation, after.alive & ~innovation.rejected & ~far & (innovation.measured > 0)
        factor = torch.where(far, factor * ratio, factor).clamp(max=WIDEST)
    raise AssertionError


def widened(estimator: MemberFilter[Any], state: Kept, spread: Tensor, factor: Tensor) -> Kept:
    """Return a state whose covariance is increased by `factor` (B,) times the initial covariance."""
    mean, chol = state.belief
    rows = factor.sqrt()[:, None, None] * spread.mT
    rows = torch.cat((chol.mT, pad(rows, (0, chol.shape[-1] - spread.shape[-1]))), dim=1)
    begun = estimator.start(Belief(mean, tria(rows)), float(state.time))
    kept = {"steps": state.steps, "repairs": state.repairs, "log_likelihood": state.log_likelihood}
    return begun._replace(**kept, failed_step=state.failed_step, status=state.status)
